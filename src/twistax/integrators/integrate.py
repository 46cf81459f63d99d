"""Integration of a compiled system over time.

`integrate` converts its options into a `Plan` (options.py): a `Stepper`, that is a method with a system (method.py),
and `Steps` (loop/), which `rollout` compiles (loop/rollout.py). A step of `RKMK` (methods/rkmk.py) is one loop over
stages in a chart (charts/).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import is_traced, is_tracing
from ..progress import watched
from ..scalar.array_primitive import on_any_mesh
from ..system.dynamics import Dynamics
from .loop.failures import failure, numbers
from .loop.loop import Steps
from .loop.outcome import Result
from .loop.progress_callback import ProgressCallback, callback_of, calling_back
from .loop.rollout import RolloutResult, ended_well, rollout
from .loop.unreached import nan_unless
from .method import Stepper
from .options import Options, need_flag, plan_of, with_options
from .results.solution import Crossings, Dense, Solution, Stats


@with_options(Options)
def integrate(dynamics: Dynamics, x0: Mapping[str, Any], options: Options) -> Solution:
    """Integrate a system from x0 at t0 to t1, with fixed steps or with steps chosen by tolerances.

    Every state stays in its group, and on the manifold to which the corrections of the system project it. The loop is
    compiled once for the dynamics, the method and the number of saved times: another dt, t1, tolerance, initial state,
    u or params does not recompile. If an argument is traced (inside jit, grad, jacfwd or vmap), checks that need
    numbers are skipped: check `Solution.result`.

    Derivatives of any order, forward and reverse, with respect to x0, u, params, t0, t1, save_at and the times of
    tables are those of the discrete steps. Their memory grows with the square root of the number of steps; with save_at
    or dense it grows with the maximal number of steps. With fixed steps a traced t0 or t1 needs `steps` in place of
    `dt`. If jumps of two tables coincide, derivatives are correct only for changes that move both jumps equally.

    Args:
        x0: the initial state, a dict by state name. Its precision is that of the whole integration.
        t0, t1: start and end in s; with t1 < t0 the integration is backward in time, and save_at decreases.
        dt: fixed steps: their length in s; (t1 - t0) / dt is rounded to whole steps and dt adjusted. With rtol: the
            first step size, which is estimated by default.
        steps: the number of fixed steps, instead of dt.
        rtol, atol: tolerances: the local error is at most atol + rtol * size, as a root mean square over
            the tangent. Rotations are measured in rad, with size 1; positions and other states in their unit, with
            their own size or the scale the state declares. atol is a number, or a dict by state name of numbers, arrays
            of the tangent's shape, or for poses pairs (rotation, position); the default is rtol.
        method: an object like `RKMK(tableau)`. The default is RKMK(RK4) with fixed steps, and with tolerances
            RKMK(DOP853, Ambient()), which the report recommends.
        control: a `StepControl`, the step size controller and the maximal number of steps.
        jumps: sorted times at which u, or the system itself, is discontinuous; steps end there. The times of tables are
            included automatically.
        u: the controls: a dict of constant arrays or of tables (`ZeroOrderHold`, `FirstOrderHold`); or a traceable
            function of t that returns the dict and is evaluated at stage times. A function becomes part of the compiled
            program: another function recompiles, and the values in its closure are read at compile time.
        params: parameter values; missing ones take their default.
        save_at: sorted times inside [t0, t1]. A state between steps is computed by one shorter step of the same method
            from the step's start, so it is as accurate as the method. By default only the final state is saved.
        between: with tolerances, `tx.Between.POLYNOMIAL` interpolates saved times without additional steps: the state
            is on a polynomial through the stage derivatives of its step, of order 6 with DOP853, 5 with
            DORMAND_PRINCE8, 4 with DORMAND_PRINCE5 and TSIT5, 3 with BOGACKI_SHAMPINE3, in its group. Derivatives are
            those of the shorter steps.
        dense: store the start of every step, so that `Solution.evaluate` returns the state at any time. With fixed
            steps their number is then part of the compiled program.
        event: an `Event`, or a list of events: the integration ends at the first root of any condition, with
            `Result.EVENT`, which is not a failure; `Solution.event` is the index of the event. With save_at the last
            row is the state at the event, after the saved times before it. Events with terminal=False do not end it:
            `Solution.crossings` has them. The times and the states of events are differentiable by the implicit
            function theorem.
        max_crossings: capacity of `Solution.crossings` for all events together, sorted by
            time. At the first crossing beyond it the integration ends with `Result.MAX_CROSSINGS`. 128 by default.
        throw: whether to raise an error if the integration fails. Otherwise the part before the failure is returned,
            with `result`.
        progress: True for a progress line in the form of `tx.trajectory.Progress`; or a function that is called with
            the time reached in s and the completed fraction of the span from t0 to t1, after every hundredth of fixed
            steps, or every 256 adaptive steps. It compiles a separate program; nothing is shown if arguments are
            traced. By default a line with the elapsed seconds appears after two seconds, on a terminal; False shows
            nothing.

    Returns:
        `Solution(ts, xs, stats, result)`, with saved times on the leading axis. If arguments are traced, states that
        were not reached are NaN.

    Raises:
        InputError: the errors of a call of `dynamics`; values that are not finite; a matrix that is not a rotation;
            invalid times, steps or tolerances; a quantity of `tx.units` that is not a time.
        ModelError: a system that is not compiled; a method that cannot integrate the system, or has no error estimate.
        IntegrationError: the integration failed. The message names the time, the state and the likely cause.

    Example: `tx.integrate(dynamics, {"x": 1.0, "v": 0.0}, t1=10.0, rtol=1e-8, u={"F": 0.5}).xs["x"]`
    """
    return integrated(dynamics, x0, options)


def integrated(dynamics: Dynamics, x0: Mapping[str, Any], options: Options) -> Solution:
    """`integrate` with its options as a record."""
    callback = None if options.progress is None else callback_of(options.progress)
    with watched("integrate", options.progress if callback is None else False):
        return _integrated(dynamics, x0, options, callback)


def _integrated(
    dynamics: Dynamics, x0: Mapping[str, Any], options: Options, callback: ProgressCallback | None
) -> Solution:
    plan = plan_of(dynamics, x0, options)
    need_flag("throw", options.throw)
    stepper, steps = plan.stepper, plan.steps
    if callback is None or plan.traced or is_tracing():
        result = rollout(steps, stepper, plan.x)
    else:
        with calling_back(callback) as progress_calls:
            result = rollout(dataclasses.replace(steps, progress_calls=progress_calls), stepper, plan.x)
    if is_traced((options.t0, options.t1, options.save_at)):
        times = (plan.t0, jnp.asarray(options.t1, plan.t0.dtype), plan.ts)
        result = _inside(result, *(jnp.asarray(stepper.clock(t)) for t in times))
    return solution_of(stepper, steps, result, plan.ts, options.save_at is None, options.throw)


def _inside(result: RolloutResult, start: jax.Array, end: jax.Array, ts: jax.Array) -> RolloutResult:
    """The result for traced times: NON_FINITE and NaN for invalid times, which raise an error if they are known."""
    room = 1e-6 * (end - start) + 8.0 * float(jnp.finfo(ts.dtype).eps) * jnp.maximum(jnp.abs(start), jnp.abs(end))
    ordered = (start <= end) & (ts[:-1] <= ts[1:]).all()
    inside = ordered & (ts >= start - room) & (ts <= end + room)
    code = result.outcome.code
    code = jnp.where(ended_well(code) & ~inside.all(), Result.NON_FINITE.value, code)
    return dataclasses.replace(
        result, xs=nan_unless(inside, result.xs), outcome=dataclasses.replace(result.outcome, code=code)
    )


def _and_end(array: Any, ts: Any, xs: Any, t: Any, end: Any) -> tuple[Any, Any]:
    """Times and states with the end appended."""
    joined = {name: array.concatenate([value, array.asarray(end[name])[None]]) for name, value in xs.items()}
    return array.append(ts, t), joined


def solution_of(
    stepper: Stepper, steps: Steps, rolled: RolloutResult, ts: Any, end_only: bool, throw: bool
) -> Solution:
    """The `Solution` of a rollout. For known numbers, a failure raises an error, or the part before it is returned."""
    outcome, xs, known = rolled.outcome, rolled.xs, not is_traced(rolled.outcome)
    watching = steps.events is not None and any(steps.events.terminal)
    code, tried, accepted, evaluations = outcome.code, outcome.tried, outcome.accepted, outcome.evaluations
    if known:
        tried, accepted, evaluations = int(tried), int(accepted), int(evaluations)
    stats = Stats(tried, accepted, tried - accepted, evaluations)
    result = Result(int(code)) if known else code
    if known and throw and not ended_well(result):
        raise failure(*numbers((stepper, steps, outcome, rolled.end or xs)))
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
        # NumPy cuts and joins known rows: JAX would compile that for each number of rows.
        unknown = is_traced((rolled, ts))
        array: Any = jnp if unknown else np
        kept = len(ts)
        if known and result is not Result.SUCCESS:
            kept = int(np.cumprod(np.asarray(rolled.reached)[:kept]).sum())
        ts, xs = ts[:kept], {name: array.asarray(value)[:kept] for name, value in xs.items()}
        if watching:
            end = rolled.end or {}
            if not known:
                end = nan_unless(ended_well(outcome.code), end)
            ts, xs = on_any_mesh(functools.partial(_and_end, array), ts, xs, t_end, end)
        xs = xs if unknown else jax.device_put(xs)
    dense = None if rolled.trail is None else Dense(stepper, rolled.trail)
    return Solution(
        ts if isinstance(ts, jax.Array) else jax.device_put(ts),
        xs,
        stats,
        result,
        dense,
        rolled.event,
        stepper,
        rolled.at_start,
        None if rolled.crossings is None else Crossings.of(rolled.crossings),
    )
