"""Integration of a compiled system over time: what was given is read and checked, steps are taken, a solution made.

The way down: `integrate` makes a `Stepper`, a method on a system (method.py), and `Steps` (steps.py, adaptive.py),
which `rollout` compiles (rollout.py). A step of `RKMK` (rkmk.py) is one loop over stages in a chart (charts.py).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import instance, real_array
from ..errors import InputError
from ..expr import Inputs
from ..groups import Group
from ..jax_inside import is_traced, is_tracing
from ..scalar.array_primitive import on_any_mesh
from ..system.dynamics import Dynamics, need_compiled
from ..system.inputs import is_finite, need_held, precision
from .adaptive import AdaptiveSteps
from .charts import Ambient
from .controls import ByName, OfTime, Signals, controls_of
from .events import watch_of
from .failures import failure, numbers
from .interpolant import Between
from .meter import asked_for, metered
from .method import Method, Stepper
from .projected import need_start_on_manifold, projected
from .rkmk import RKMK
from .rollout import Rollout, rollout
from .rows import Stops, filled, limits_of
from .run import Result
from .solution import Crossings, Dense, Solution, Stats
from .step_control import StepControl
from .steps import FixedSteps, Steps, ended_well
from .tableaus import DOP853, RK4
from .times import check_saves, direction_of, fixed_steps, span_of
from .tolerances import tolerances_of
from .unreached import nan_unless


def integrate(
    dynamics: Dynamics,
    x0: Mapping[str, Any],
    *,
    t0: Any = 0.0,
    t1: Any,
    dt: Any = None,
    steps: int | None = None,
    rtol: Any = None,
    atol: Any = None,
    method: Method | None = None,
    control: StepControl | None = None,
    jumps: Any = None,
    u: Any = None,
    params: Mapping[str, Any] | None = None,
    save_at: Any = None,
    between: Between = Between.STEP,
    dense: bool = False,
    event: Any = None,
    max_crossings: Any = None,
    throw: bool = True,
    progress: Any = None,
) -> Solution:
    """Integrate a system from x0 at t0 to t1, with fixed steps or with as long ones as tolerances allow.

    Every state stays in its group, and on the manifold that the system's corrections bring it back to. The loop is
    compiled once for the dynamics, the method and the number of saved times: another dt, t1, tolerance, start, u or
    params does not compile again. Where something is traced (inside jit, grad, jacfwd or vmap) checks that need numbers
    are left out: look at `Solution.result`. Derivatives of any order, forward and in reverse, with respect to x0, u,
    params, t0, t1, save_at and the times of tables are those of the steps taken, in memory that grows with the square
    root of their number, with save_at or dense in proportion to the number of steps there may be; with fixed steps a
    traced t0 or t1 needs `steps` in place of `dt`. Where jumps of two tables coincide, only derivatives that move both
    alike are right.

    Args:
        x0: the start, a dict by state name. Its precision is that of the whole integration.
        t0, t1: start and end in s; with t1 < t0 it goes backward in time, and save_at falls.
        dt: fixed steps: their length in s; (t1 - t0) / dt is rounded to whole steps and dt adjusted. With rtol: the
            first step to try; chosen if left out.
        steps: the number of fixed steps, instead of dt.
        rtol, atol: steps are chosen so that the error of each is at most atol + rtol * size, as a root mean square over
            the tangent. Rotations are measured in rad, with size 1; positions and other states in their unit, with
            their own size or the scale the state declares. atol is a number, or a dict by state name of numbers, arrays
            of the tangent's shape, or for poses pairs (rotation, position); as rtol if left out.
        method: an object like `RKMK(tableau)`. Left out: RKMK(RK4) with fixed steps, with tolerances
            RKMK(DOP853, Ambient()), which the report advises.
        control: how steps follow from errors, a `StepControl`, and how many there may be.
        jumps: sorted times at which u, or the system itself, jumps; steps end there. Tables bring
            their own.
        u: the controls: a dict of arrays, which are held, or of tables (`ZeroOrderHold`, `FirstOrderHold`); or a
            traceable function of t that returns the dict and is called at stage times. A function is part of the
            compiled program: another one compiles again, and what it closes over is read when it is compiled.
        params: parameter values; missing ones take the Parameter's own.
        save_at: sorted times inside [t0, t1]. Between steps the state is one shorter step of the same method from the
            step's start, as accurate as the method. Left out: the end alone.
        between: with tolerances, `tx.Between.POLYNOMIAL` has saved times cost no steps: the state is on a polynomial
            through the slopes of its step, of order 6 with DOP853, 5 with DORMAND_PRINCE8, 4 with DORMAND_PRINCE5 and
            TSIT5, 3 with BOGACKI_SHAMPINE3, in its group. Derivatives are those of the shorter steps.
        dense: keep the start of every step, so that `Solution.evaluate` gives the state at any time. With fixed steps
            their number is then part of the compiled program.
        event: an `Event`, or a list of them: the integration ends at the first root of any condition, with
            `Result.EVENT`, which is no failure; `Solution.event` is its number. With save_at the last row is then where
            it ended, besides the saved times before it. Those with terminal=False do not end it: `Solution.crossings`
            has them. Derivatives of the times and the states there are those of the implicit function theorem.
        max_crossings: how many crossings `Solution.crossings` has room for, all events together, in the order of their
            times. At the first without room the integration ends, with `Result.MAX_CROSSINGS`. 128 if left out.
        throw: raise when the integration ends early. Otherwise the part before the failure is returned, with `result`.
        progress: True for a line that shows how far it is, as `tx.trajectory.Progress` writes it; or a function called
            with the time reached in s and the share of the way from t0 to t1, every hundredth of fixed steps, every 256
            steps that are chosen. One other program is compiled for it; nothing is told where something is traced.

    Returns:
        `Solution(ts, xs, stats, result)`, saved times on the leading axis. Where something is traced, states that were
        not reached are NaN.

    Raises:
        InputError: what a call of `dynamics` raises; values that are not finite; a matrix that is no rotation; times,
            steps or tolerances that make no sense; a quantity of `tx.units` that is not a time.
        ModelError: a system that is not compiled; a method that cannot integrate the system, or has no error estimate.
        IntegrationError: the integration ended early. Names the time, the state and the likely cause.
    """
    plan = planned(
        dynamics,
        x0,
        t0=t0,
        t1=t1,
        dt=dt,
        steps=steps,
        rtol=rtol,
        atol=atol,
        method=method,
        control=control,
        jumps=jumps,
        u=u,
        params=params,
        save_at=save_at,
        between=between,
        dense=dense,
        event=event,
        max_crossings=max_crossings,
    )
    _flag("throw", throw)
    stepper, taken = plan.stepper, plan.steps
    told = None if progress is None else asked_for(progress)
    if told is None or plan.traced or is_tracing():
        found = rollout(taken, stepper, plan.x)
    else:
        with metered(told) as meter:
            found = rollout(dataclasses.replace(taken, meter=meter), stepper, plan.x)
    if is_traced((t0, t1, save_at)):
        times = (plan.t0, jnp.asarray(t1, plan.t0.dtype), plan.ts)
        found = _inside(found, *(jnp.asarray(stepper.clock(t)) for t in times))
    return solution_of(stepper, taken, found, plan.ts, save_at is None, throw)


class Plan(NamedTuple):
    """An integration that was checked, and what takes it."""

    stepper: Stepper
    steps: AdaptiveSteps | FixedSteps
    x: dict[str, Any]  # the prepared start
    t0: Any
    ts: Any  # (n,) the saved times, or the end
    traced: bool  # whether any of it is


def planned(
    dynamics: Any,
    x0: Any,
    *,
    t0: Any = 0.0,
    t1: Any,
    dt: Any = None,
    steps: Any = None,
    rtol: Any = None,
    atol: Any = None,
    method: Any = None,
    control: Any = None,
    jumps: Any = None,
    u: Any = None,
    params: Any = None,
    save_at: Any = None,
    between: Any = Between.STEP,
    dense: Any = False,
    event: Any = None,
    max_crossings: Any = None,
) -> Plan:
    """The arguments of `integrate`, read and checked. Raises what it raises before anything is integrated."""
    need_compiled("integrate", dynamics)
    adaptive = rtol is not None or atol is not None
    if method is None:
        method = RKMK(DOP853, Ambient()) if adaptive else RKMK(RK4)
    instance("method", method, Method, "an object like tx.RKMK(tx.tableaus.RK4)", InputError)
    if dynamics.system.corrections:
        method = projected(method)
    method.check(dynamics)
    _flag("dense", dense)
    instance("between", between, Between, "tx.Between.STEP or tx.Between.POLYNOMIAL", InputError)
    instance("control", control, StepControl | None, "tx.StepControl(...)", InputError)
    span = span_of(t0, t1, dt)
    controls = controls_of(u)
    places = ("t0", "x0", "u(t)" if isinstance(controls, OfTime) else "u", "params")
    now = _controls_now(dynamics, controls, t0, precision(x0, params))
    inputs = dynamics._functions.prepare(t0, x0, now, params, names=places, on_host=True)
    _check_start(dynamics, inputs, places)
    if dynamics.system.corrections:
        need_start_on_manifold(dynamics, inputs)
    if span is not None:
        need_held("t1", np.asarray(span[1]), inputs.dtype)
        if isinstance(controls, ByName):
            controls.check_span(min(span), max(span))
    signals, x, dtype = controls.prepared(inputs.u, inputs.dtype), dict(inputs.x), inputs.dtype
    if event is None and max_crossings is not None:
        raise InputError(
            "max_crossings is for events that do not end the integration, but event is left out.\n"
            "  fix: leave it out too, or event=tx.Event(condition, terminal=False)"
        )
    watch, watched = (None, None) if event is None else watch_of(dynamics, event, inputs, signals, max_crossings)
    traced = is_traced((signals, inputs.u, inputs.params, x, t0, t1, dt, rtol, atol, jumps, save_at, watched))
    if traced and isinstance(signals, OfTime):
        signals = signals.opened(jnp.asarray(inputs.t))
    direction = direction_of(t0, t1, dtype)
    stepper = Stepper(
        dynamics, method, signals, dict(inputs.params), within=True, inward=jumps is not None, direction=direction
    )
    # From here on times are those of the clock of the loop over steps, which goes forward.
    start, end, span = _on_clock(direction, t0, t1, span, dtype)
    saves, count = save_at, np.asarray(0)
    if save_at is not None:
        known = check_saves(save_at, None if span is None else (float(t0), float(t1)))
        count = np.asarray(len(save_at))
        saves = (jnp if is_traced((direction, save_at)) else np).asarray(save_at)
        # In the precision they came in, which says how exact they are.
        saves = saves if saves.dtype.kind == "f" else saves.astype(dtype)
        saves = direction.astype(saves.dtype) * saves
        if known and not traced and not is_tracing():
            # A polynomial is asked for as far as the time has come: never for what fills up the rows.
            beyond = np.inf if between is Between.POLYNOMIAL else end
            saves = filled(saves, beyond, sum(value.size for value in x.values()))
    limits = limits_of(start, end, jumps, signals, direction)
    taken: AdaptiveSteps | FixedSteps
    if adaptive:
        if steps is not None:
            raise InputError("steps is for fixed steps, but rtol or atol is given.\n  fix: leave one of them out")
        _ = method.error_order  # a method without an error estimate says so here
        if between is Between.POLYNOMIAL:
            method.need_polynomial()
        stops = Stops.given(limits, start, saves, count)
        if dt is not None:
            need_held("dt", real_array("dt", dt), dtype)
        first = (jnp if is_traced(dt) else np).asarray(0.0 if dt is None else dt, dtype)
        tolerances = tolerances_of(dynamics, rtol, atol, dtype)
        taken = AdaptiveSteps(start, first, stops, tolerances, control or StepControl(), dense, between, watch)
    else:
        polynomial = between if between is Between.POLYNOMIAL else None
        for name, value in (("control", control), ("between", polynomial)):
            if value is not None:
                raise InputError(
                    f"{name} is for steps chosen by tolerances: give rtol and atol in place of dt or steps"
                )
        taken = fixed_steps(
            start, end, span, dt, steps, saves, count, dtype, bounded=traced, dense=dense, watch=watch, limits=limits
        )
    times = [t1] if save_at is None else save_at
    ts = (jnp if is_traced(times) else np).asarray(times, dtype)
    return Plan(stepper, taken, x, inputs.t, ts, traced)


def _on_clock(direction: Any, t0: Any, t1: Any, span: Any, dtype: Any) -> tuple[Any, Any, tuple[float, float] | None]:
    """Start and end on the clock of the loop over steps, and as plain numbers where they are known."""
    array: Any = np if span else jnp
    start, end = (direction * array.asarray(t, dtype) for t in (t0, t1))
    return start, end, span and (float(direction) * span[0], float(direction) * span[1])


def _flag(name: str, value: Any) -> None:
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} must be True or False, got {value!r}")


def _controls_now(dynamics: Dynamics, controls: Signals, t0: Any, dtype: Any) -> Mapping[str, Any]:
    """The controls at t0, to check names and shapes with. A function that was checked is not called again."""
    if isinstance(controls, ByName):
        return controls.sample(t0)
    plain = not controls.inputs and jax.tree_util.all_leaves([controls.function])
    if is_tracing() or not plain:
        return controls.sample(jnp.asarray(t0, dtype))
    loops, key = dynamics._functions.loops, (_controls_now, controls.function, np.dtype(dtype))
    return loops.get(key, lambda: controls.sample(jnp.asarray(t0, dtype)))


def _check_start(dynamics: Dynamics, inputs: Inputs, places: Sequence[str]) -> None:
    """What is known of the prepared start must be finite, rotations and poses in their groups. Raises InputError."""
    for place, values in zip(places[1:], (inputs.x, inputs.u, inputs.params), strict=True):
        for name, value in values.items():
            if not is_finite(value):
                raise InputError(f"{place}[{name!r}] expects finite numbers, got {np.asarray(value)}")
    for name, group in dynamics.group.factors.items():
        need_element(name, group, inputs.x[name])


def need_element(name: str, group: Group, value: Any) -> None:
    """Raise InputError where the start of a state is known and no element of its group."""
    if group.flat or is_traced(value):
        return
    defect = group.known_defect(np.asarray(value))
    tolerance = 1e-6
    if defect > tolerance:  # what is known of the type takes long to find
        tolerance = max(tolerance, 1e3 * float(jnp.finfo(value.dtype).eps))
    if defect > tolerance:
        raise InputError(
            f"x0[{name!r}] is no element of {group.name}: off by {defect:.3g}, where {tolerance:.0e} is allowed"
            + (
                " (the rotation's R'R - I, and the last row of a pose).\n"
                "  fix: build poses with tx.pose(...), or take the nearest element with "
                f"tx.{group.name}.normalize(g)"
                if group.rigid
                else ".\n  fix: take the nearest element, that which normalize of the group gives"
            )
        )


def _inside(found: Rollout, start: jax.Array, end: jax.Array, ts: jax.Array) -> Rollout:
    """NON_FINITE for traced times that would be refused if they were known, and NaN for the states there."""
    room = 1e-6 * (end - start) + 8.0 * float(jnp.finfo(ts.dtype).eps) * jnp.maximum(jnp.abs(start), jnp.abs(end))
    ordered = (start <= end) & (ts[:-1] <= ts[1:]).all()
    inside = ordered & (ts >= start - room) & (ts <= end + room)
    code = found.outcome.code
    code = jnp.where(ended_well(code) & ~inside.all(), Result.NON_FINITE.value, code)
    return found._replace(xs=nan_unless(inside, found.xs), outcome=found.outcome._replace(code=code))


def _and_end(array: Any, ts: Any, xs: Any, t: Any, end: Any) -> tuple[Any, Any]:
    """Times and states by name, and the end behind them."""
    joined = {name: array.concatenate([value, array.asarray(end[name])[None]]) for name, value in xs.items()}
    return array.append(ts, t), joined


def solution_of(stepper: Stepper, steps: Steps, found: Rollout, ts: Any, end_only: bool, throw: bool) -> Solution:
    """What the user gets; where numbers are known a failure raises, or leaves the good part."""
    outcome, xs, known = found.outcome, found.xs, not is_traced(found.outcome)
    watching = steps.watch is not None and any(steps.watch.terminal)
    code, tried, accepted, evaluations, _, _ = outcome
    if known:
        tried, accepted, evaluations = int(tried), int(accepted), int(evaluations)
    stats = Stats(tried, accepted, tried - accepted, evaluations)
    result = Result(int(code)) if known else code
    if known and throw and not ended_well(result):
        raise failure(*numbers((stepper, steps, outcome, found.end or xs)))
    t_end = stepper.clock(outcome.t)
    if not known:
        t_end = nan_unless(ended_well(outcome.code), t_end)
    if end_only:
        if not known:
            xs = nan_unless(ended_well(outcome.code), xs)
        if known:
            ts = ts if result is Result.SUCCESS else np.asarray(t_end)[None]
        elif watching:
            ts = jnp.where(outcome.code == Result.SUCCESS.value, ts[-1], t_end)[None]
    else:
        # Known rows are cut and joined by NumPy: JAX would compile that for each number of them.
        unknown = is_traced((found, ts))
        array: Any = jnp if unknown else np
        kept = len(ts)
        if known and result is not Result.SUCCESS:
            kept = int(np.cumprod(np.asarray(found.reached)[:kept]).sum())
        ts, xs = ts[:kept], {name: array.asarray(value)[:kept] for name, value in xs.items()}
        if watching:
            end = found.end or {}
            if not known:
                end = nan_unless(ended_well(outcome.code), end)
            ts, xs = on_any_mesh(functools.partial(_and_end, array), ts, xs, t_end, end)
        xs = xs if unknown else jax.device_put(xs)
    dense = None if found.trail is None else Dense(stepper, found.trail)
    return Solution(
        ts if isinstance(ts, jax.Array) else jax.device_put(ts),
        xs,
        stats,
        result,
        dense,
        found.event,
        stepper,
        found.at_start,
        None if found.crossings is None else Crossings.of(found.crossings),
    )
