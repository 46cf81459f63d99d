"""Integration of a compiled system over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from ..lowering.inputs import is_finite, precision
from .adaptive import AdaptiveCourse, Stops
from .checks import check_start
from .controls import OfTime, Signals, controls_of
from .course import Course
from .dense import Dense
from .events import watch_of
from .failures import failure
from .fixed import FixedCourse
from .flight import Flight, fly
from .grid import check_saves, make_grid, place_saves, span_of
from .method import Method
from .result import Result
from .rkmk import RKMK
from .solution import Solution, Stats
from .step_control import StepControl
from .stepper import Stepper
from .tableaus import RK4, TSIT5
from .tolerances import tolerances_of

__all__ = ["integrate"]


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
    dense: bool = False,
    event: Any = None,
    throw: bool = True,
) -> Solution:
    """Fly a system from x0 at t0 to t1, with fixed steps or with as long ones as tolerances allow.

    Every state stays in its group. The flight is compiled once for the dynamics, the method and the number of saved
    times: another dt, t1, tolerance, start, u or params does not compile again. Where something is traced (inside jit,
    grad, jacfwd or vmap) checks that need numbers are left out: look at `Solution.result`. Derivatives of any order,
    forward and in reverse, with respect to x0, u, params, t0, t1, save_at and the times of tables are those of the
    steps taken, in memory that grows with the square root of their number, with save_at or dense in proportion to the
    number of steps there may be; with fixed steps a traced t0 or t1 needs `steps` in place of `dt`. Where jumps of two
    tables coincide, only derivatives that move both alike are right.

    Args:
        x0: the start, a dict by state name. Its precision is that of the whole flight.
        t0, t1: start and end in s, t1 >= t0.
        dt: fixed steps: their length in s; (t1 - t0) / dt is rounded to whole steps and dt adjusted. With rtol: the
            first step to try; chosen if left out.
        steps: the number of fixed steps, instead of dt.
        rtol, atol: steps are chosen so that the error of each is at most atol + rtol * size, as a root mean square over
            the tangent. Rotations are measured in rad, with size 1; positions and other states in their unit, with
            their own size or the scale the state declares. atol is a number, or a dict by state name of numbers, arrays
            of the tangent's shape, or for poses pairs (rotation, position); as rtol if left out.
        method: an object like `RKMK(tableau)`. Left out: RKMK(RK4) with fixed steps, RKMK(TSIT5) with tolerances.
        control: how steps follow from errors, a `StepControl`, and how many there may be.
        jumps: sorted times at which u, or the system itself, jumps; steps chosen by tolerances end there. Tables bring
            their own.
        u: the controls: a dict of arrays, which are held, or of tables (`ZeroOrderHold`, `FirstOrderHold`); or a
            traceable function of t that returns the dict and is called at stage times. A function is part of the
            compiled program: another one compiles again, and what it closes over is read when it is compiled.
        params: parameter values; missing ones take the Parameter's own.
        save_at: sorted times inside [t0, t1]. Between steps the state is one shorter step of the same method from the
            step's start, as accurate as the method. Left out: the end alone.
        dense: keep the start of every step, so that `Solution.evaluate` gives the state at any time. With fixed steps
            their number is then part of the compiled program.
        event: an `Event`, or a list of them: the flight ends at the first root of any condition, with
            `Result.EVENT`, which is no failure; `Solution.event` is its number. With save_at the last row is then where
            the flight ended, besides the saved times before it. Derivatives of the time and the state there are those
            of the implicit function theorem.
        throw: raise when the flight ends early. Otherwise the part before the failure is returned, with `result`.

    Returns:
        `Solution(ts, xs, stats, result)`, saved times on the leading axis. Where something is traced, states that were
        not reached are not a number.

    Raises:
        InputError: what `Dynamics.prepare` raises; values that are not finite; a rotation that is none; times, steps or
            tolerances that make no sense.
        ModelError: a method that cannot fly the system, or has no error estimate.
        IntegrationError: the flight ended early. Names the time, the state and the likely cause.
    """
    adaptive = rtol is not None or atol is not None
    if method is None:
        method = RKMK(TSIT5) if adaptive else RKMK(RK4)
    if not isinstance(method, Method):
        raise InputError(f"method must be an object like tx.RKMK(tx.tableaus.RK4), got {method!r}")
    method.check(dynamics)
    controls = controls_of(u)
    inputs = dynamics._functions.prepare(t0, x0, controls.sample(jnp.asarray(t0, precision(x0, params))), params)
    check_start(dynamics, inputs)
    signals = controls.prepared(inputs.u, inputs.dtype)
    x, dtype = dict(inputs.x), inputs.dtype
    traced = is_traced((signals, inputs.u, inputs.params, x, t0, t1, dt, rtol, atol, jumps, save_at))
    watch, watched_values = watch_of(dynamics, event, inputs, signals)
    traced = traced or is_traced(watched_values)
    if traced and isinstance(signals, OfTime):
        signals = signals.opened(inputs.t)
    stepper = Stepper(dynamics, method, signals, dict(inputs.params), inward=jumps is not None)
    if adaptive:
        if steps is not None:
            raise InputError("steps is for fixed steps, but rtol or atol is given.\n  fix: leave one of them out")
        _ = method.error_order  # a method without an error estimate says so here
        span = span_of(t0, t1, dt)
        course: Course = AdaptiveCourse(
            t0=inputs.t,
            first=jnp.asarray(0.0 if dt is None else dt, dtype),
            stops=_stops(signals, jumps, inputs.t, jnp.asarray(t1, dtype), save_at, span),
            tolerances=tolerances_of(dynamics, rtol, atol, dtype),
            control=control or StepControl(),
            dense=dense,
            watch=watch,
        )
        ts = jnp.asarray([t1] if save_at is None else save_at, dtype)
    else:
        for name, value in (("jumps", jumps), ("control", control)):
            if value is not None:
                raise InputError(
                    f"{name} is for steps chosen by tolerances: give rtol and atol in place of dt or steps"
                )
        grid = make_grid(t0, t1, dt, steps, dtype)
        saves = place_saves(save_at, grid, dtype)
        course = FixedCourse.of(grid, saves, bounded=traced or dense, dense=dense, watch=watch)
        ts = grid.t1[None] if saves is None else saves.ts
    flight = fly(course, stepper, x)
    return _solution(stepper, course, flight, ts, save_at is None, throw)


def _stops(
    signals: Signals, jumps: Any, t0: jax.Array, t1: jax.Array, save_at: Any, span: tuple[float, float] | None
) -> Stops:
    """The stops of an adaptive flight: saved times, and jumps and the end as limits."""
    if save_at is not None:
        check_saves(save_at, span)
    if jumps is not None and (np.ndim(jumps) != 1 or not is_finite(jumps)):
        raise InputError(f"jumps expects finite times with shape (n,), got {jumps!r}")
    known = [*signals.jumps, *([] if jumps is None else [jnp.asarray(jumps)])]
    # Not jnp.clip, whose derivative is halved where a time is exactly an end. A jump there moves with the end.
    inside = [jnp.where(ts <= t0, t0, jnp.where(ts >= t1, t1, ts)) for ts in (ts.astype(t0.dtype) for ts in known)]
    limits = jnp.append(jnp.sort(jnp.concatenate(inside)), t1) if inside else t1[None]
    if save_at is None:
        return Stops.of(limits, None)
    saves = jnp.asarray(save_at, t0.dtype)
    return Stops.of(limits, jnp.where(saves < t0, t0, jnp.where(saves > t1, t1, saves)))


def _solution(stepper: Stepper, course: Course, flight: Flight, ts: jax.Array, end_only: bool, throw: bool) -> Solution:
    """What the user gets; where numbers are known a failure raises, or leaves the good part."""
    outcome, watching = flight.outcome, course.watch is not None
    dense = None if flight.trail is None else Dense(stepper, flight.trail)
    stats = Stats(outcome.tried, outcome.accepted, outcome.tried - outcome.accepted, outcome.evaluations)
    end = {name: value[None] for name, value in flight.end.items()}
    halted = jnp.where(outcome.code == Result.EVENT.value, outcome.t, ts[-1])[None] if watching and end_only else None
    if is_traced(outcome):
        if end_only:
            return Solution(ts if halted is None else halted, end, stats, outcome.code, dense, flight.event)
        xs = flight.xs
        if watching:
            ts, xs = jnp.append(ts, outcome.t), _joined(xs, end)
        return Solution(ts, xs, stats, outcome.code, dense, flight.event)
    stats = Stats(*(int(count) for count in (stats.steps, stats.accepted, stats.rejected, stats.rhs_evaluations)))
    result = Result(int(outcome.code))
    good = result in (Result.SUCCESS, Result.EVENT)
    if throw and not good:
        raise failure(stepper, course, outcome, flight.end)
    if end_only:
        return Solution(ts if result is Result.SUCCESS else outcome.t[None], end, stats, result, dense, flight.event)
    kept = len(ts) if result is Result.SUCCESS else int(np.cumprod(flight.reached).sum())
    ts, xs = ts[:kept], {name: value[:kept] for name, value in flight.xs.items()}
    if watching:
        ts, xs = jnp.append(ts, outcome.t), _joined(xs, end)
    return Solution(ts, xs, stats, result, dense, flight.event)


def _joined(xs: Arrays, end: Arrays) -> Arrays:
    """The saved states and the end."""
    return {name: jnp.concatenate([value, end[name]]) for name, value in xs.items()}
