"""A rollout as one function of its inputs, differentiable in forward and reverse mode."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import batched_branches_transpose, is_traced
from ...scalar.small_call import small_call
from ...system.dynamics import Arrays
from ..charts.coordinates import Blocks
from ..events.crossings import crossing_rows
from ..events.event_end import Meeting, cut_at, refined, refined_rows, saved_before, to_event
from ..method import Stepper, jitted
from .checkpointed import take_steps
from .kernels import Packed, advance_again, has_shared_kernel, opened, scan_again, shared_kernel
from .loop import Steps, all_finite, first_rows
from .outcome import LoopOutcome, Result, Run, Saved, StepPart
from .unreached import nan_unless, zero_of


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class RolloutResult:
    """The result of the loop over steps."""

    #: The states at the saved times, leading axis n, NaN where the steps did not reach them; without any `end`.
    xs: Any
    end: Any  # the last state; None: that of the only row
    reached: Any  # (n,) whether the steps reached each saved time; None without saved times
    outcome: Any  # a `LoopOutcome`; its evaluations include those of saved times
    trail: Any  # for dense output
    event: Any  # the number of the event that ended it, -1 for none; None without events
    at_start: Any = None  # (m,) whether each condition was zero or past it at the start
    crossings: Any = None  # of events that do not end it, where there are any


def rollout(steps: Steps, stepper: Stepper, x: dict[str, Any]) -> RolloutResult:
    """Take all steps from the state x, compiled as one small function if this is supported.

    Its derivatives, of any order, in forward and reverse mode, repeat the same steps with bounded memory. The lengths
    of adaptive steps remain constant fractions of the time between limits, so that derivatives with respect to all
    times are correct.
    """
    return unpacked(jitted(packed_rollout, stepper, steps, x))


def packed_rollout() -> Callable[[Stepper, Steps, Arrays], tuple[Any, ...]]:
    """Makes a rollout whose result is a tuple of few arrays, for `unpacked`: JAX takes 2 us for each array."""
    rollout = differentiable()

    def packed(stepper: Stepper, steps: Steps, x: Arrays) -> tuple[Any, ...]:
        r = rollout(stepper, steps, x)
        counts = jnp.stack([r.outcome.code, r.outcome.tried, r.outcome.accepted, r.outcome.evaluations])
        times = jnp.stack([r.outcome.t, r.outcome.h])
        end = None if r.reached is None else r.end
        return r.xs, end, r.reached, (counts, times), r.trail, r.event, r.at_start, r.crossings

    return packed


def unpacked(values: tuple[Any, ...]) -> RolloutResult:
    """The result of a `packed_rollout`, with its outcome as NumPy numbers if these are known."""
    xs, end, reached, outcome, *rest = values
    array: Any = jnp if is_traced(outcome) else np
    counts, times = map(array.asarray, outcome)
    return RolloutResult(xs, end, reached, LoopOutcome(*counts, *times), *rest)


def differentiable() -> Callable[[Stepper, Steps, Arrays], RolloutResult]:
    @jax.custom_jvp
    def taken(steps: Steps, stepper: Stepper, x: Arrays) -> RolloutResult:
        # All of it as one small function, if possible: operations outside cost as much as a short rollout.
        return _batched_alike(small_call(_rolled_out, steps, stepper, x), (steps, stepper, x))

    def slopes(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[RolloutResult, RolloutResult]:
        return _differentiated(primals, tangents)

    taken.defjvp(slopes, symbolic_zeros=True)
    return lambda stepper, steps, x: taken(steps, stepper, x)


def _batched_alike(result: RolloutResult, inputs: Any) -> RolloutResult:
    """The result, batched if an input is: JAX expects a function and its derivative to have the same batch axes."""
    firsts = [leaf.reshape(-1)[0] for leaf in jax.tree.leaves(jax.lax.stop_gradient(inputs)) if leaf.size]
    never = functools.reduce(jnp.logical_or, [first != first for first in firsts]) & False
    return jax.tree.map(lambda a: jnp.where(never, jnp.zeros_like(a), a), result)


def ended_well(code: Any) -> Any:
    """Whether codes, numbers of a `Result`, are no failures."""
    return (code == Result.SUCCESS.value) | (code == Result.EVENT.value)


def _rolled_out(steps: Steps, stepper: Stepper, x: Arrays) -> RolloutResult:
    # Without the path, saved times start from the states that the loop kept.
    run = dataclasses.replace(steps.run(stepper, stepper.stored.enter(x), record=False), path=None)
    meeting, moved = None, None
    if run.event_state is not None:
        meeting = Meeting.of(run)
        moved = jax.tree.map(functools.partial(jnp.where, meeting.met), run.event_state.y, opened(run.end))

    if run.saved is None:
        result = small_call(_to_saved_times, steps, stepper, x, run, meeting, moved)
    elif steps.finds_rows and meeting is None:
        return _with_rows(steps, stepper, x, run)
    else:

        def to_saves(saved: Saved, parts: StepPart) -> Blocks:
            first = jax.tree.map(lambda a: a[0], (saved.y, parts))
            if has_shared_kernel(_advanced, None, stepper, *first):
                return jax.vmap(lambda y, part: shared_kernel(_advanced, None, stepper, y, part))(saved.y, parts)
            return small_call(_one_by_one, stepper, saved.y, parts, saved.requested.sum())

        result = _to_saved_times(steps, stepper, x, run, meeting, moved, to_saves)
    return _with_conditions(stepper, run, result, functools.partial(small_call, crossing_rows))


def _with_conditions(stepper: Stepper, run: Run, result: RolloutResult, rows: Any = crossing_rows) -> RolloutResult:
    """The result with the crossings and the conditions that were met at the start."""
    if run.event_state is None:
        return result
    crossed = run.event_state.crossed
    crossings = None if crossed is None else rows(stepper, crossed)
    return dataclasses.replace(result, at_start=run.event_state.met, crossings=crossings)


def _with_rows(steps: Steps, stepper: Stepper, x: Arrays, run: Run) -> RolloutResult:
    """The result with the saved states of the loop.

    A kernel converts them: XLA runs a program of a thousand operations on another thread, which takes 10 us.
    """
    result = small_call(_to_saved_times, steps, stepper, x, dataclasses.replace(run, saved=None), None, None)
    saved, outcome = run.saved, result.outcome
    assert saved is not None

    def row(y: Blocks, t: jax.Array) -> tuple[jax.Array, jax.Array, Arrays]:
        return shared_kernel(_row, None, stepper, x, Packed.of(y), t, steps.t0, outcome.t)

    reached, not_finite, xs = jax.vmap(row)(saved.y, saved.t)
    not_finite = (outcome.code == Result.SUCCESS.value) & not_finite.any()
    code = jnp.where(not_finite, _lost(stepper), outcome.code)
    return dataclasses.replace(result, xs=xs, reached=reached, outcome=dataclasses.replace(outcome, code=code))


def _lost(stepper: Stepper) -> int:
    """The `Result` where the steps reached a saved time, but the shorter step to it has no finite end."""
    return (Result.NEWTON_FAILED if stepper.method.solves else Result.NON_FINITE).value


def _row(
    _: None, stepper: Stepper, x: Arrays, y: Packed, t: jax.Array, t0: jax.Array, end: jax.Array
) -> tuple[jax.Array, jax.Array, Arrays]:
    """Whether a saved time was reached; whether its state is not finite although the steps got there; its values."""
    within = t <= end
    reached = within & all_finite(y.flat)
    values = _or_start(stepper.stored.value(y.open()), t <= t0, x)
    return reached, within & ~reached, jax.tree.map(lambda a: jnp.where(reached, a, jnp.nan), values)


def _advanced(_: None, stepper: Stepper, y: Blocks, part: StepPart) -> Blocks:
    """The state at the end of a part of a step."""
    return jax.tree.map(lambda new, old: jnp.where(part.h > 0.0, new, old), stepper.advance(part.t, y, part.h), y)


def _one_by_one(stepper: Stepper, ys: Blocks, parts: StepPart, count: jax.Array) -> Blocks:
    """The states at the ends of the first `count` parts of steps, one after the other.

    As one small function, where there is no kernel that takes all of them at once.
    """

    def save(_: None, entry: tuple[Blocks, StepPart]) -> tuple[None, Blocks]:
        y, part = entry
        return None, jax.lax.cond(part.h > 0.0, lambda y: stepper.advance(part.t, y, part.h), lambda y: y, y)

    return first_rows(save, None, (ys, parts), count, jax.tree.map(lambda a: a[0], ys))[1]


def _to_saved_times(
    steps: Steps,
    stepper: Stepper,
    x: Arrays,
    run: Run,
    meeting: Meeting | None,
    moved: Any,
    advance_all: Callable[[Saved, StepPart], Blocks] | None = None,
) -> RolloutResult:
    """The states at the saved times and at the event, from the states before them."""
    parts = None if run.saved is None else steps.parts(run.path, run.saved)
    saved, moved, end = run.saved, opened(moved), opened(run.end)
    run = dataclasses.replace(run, end=end)
    if meeting is not None and moved is not None:
        halted, run, end = run, cut_at(moved, run, meeting), moved
        if saved is not None and parts is not None:
            saved, parts = saved_before(saved, parts, steps.saved_times, halted, meeting)
    stored, outcome = stepper.stored, run.outcome
    end = _or_start(stored.value(end), outcome.accepted == 0, x)
    event = None if meeting is None else meeting.event
    if saved is None or parts is None or advance_all is None:
        return RolloutResult({name: value[None] for name, value in end.items()}, end, None, outcome, run.trail, event)
    # Steps beyond a failure have length zero: an overflow there would spoil the derivatives of earlier rows.
    parts = dataclasses.replace(parts, h=jnp.where(saved.reached, parts.h, 0.0))
    ys = advance_all(saved, parts)
    reached = saved.reached & jax.vmap(all_finite)(ys)
    at_start = (saved.steps == 0) & (jax.lax.stop_gradient(parts.h) <= 0.0)
    xs = _or_start(jax.vmap(stored.value)(ys), at_start, x)
    xs = jax.tree.map(lambda a: jnp.where(wide(reached, a), a, jnp.nan), xs)
    counts = (parts.h > 0.0).sum() * stepper.method.evaluations_of(stepper.dynamics)
    not_finite = (outcome.code == Result.SUCCESS.value) & (saved.requested & ~reached).any()
    code = jnp.where(not_finite, _lost(stepper), outcome.code)
    outcome = dataclasses.replace(outcome, evaluations=outcome.evaluations + counts, code=code)
    return RolloutResult(xs, end, reached, outcome, run.trail, event)


def _or_start(values: Arrays, still: jax.Array, x: Arrays) -> Arrays:
    """The values, with the exact start where no step was taken; derivatives are those of the values."""
    result = {}
    for name, value in values.items():
        known = jnp.broadcast_to(jax.lax.stop_gradient(x[name]), value.shape)
        start = known + (value - jax.lax.stop_gradient(value))
        result[name] = jnp.where(wide(still, value), start, value)
    return result


def wide(flags: jax.Array, like: jax.Array) -> jax.Array:
    """Flags of rows, reshaped to broadcast against an array of rows."""
    return flags.reshape(flags.shape + (1,) * (like.ndim - flags.ndim))


# ---- derivatives --------------------------------------------------------------------------------------------------


def _differentiated(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[RolloutResult, RolloutResult]:
    steps, stepper, x = jax.lax.stop_gradient(primals)
    run = steps.run(stepper, stepper.stored.enter(x), record=True)
    known = None if run.event_state is None else Meeting.of(run)
    leaves, structure = jax.tree.flatten(primals)
    slopes = jax.tree.leaves(tangents, is_leaf=_is_symbolic)
    moving = [i for i, slope in enumerate(slopes) if not _is_symbolic(slope)]

    def again(values: list[Any]) -> RolloutResult:
        inputs = list(leaves)
        for i, value in zip(moving, values, strict=True):
            inputs[i] = value
        steps, stepper, x = jax.tree.unflatten(structure, inputs)
        return _batched_alike(_taken_again(steps, stepper, x, run, known), primals)

    result, slope = jax.jvp(again, ([leaves[i] for i in moving],), ([slopes[i] for i in moving],))
    ends_at_event = steps.events is not None and any(steps.events.terminal)
    return result, _not_of_failures(result, slope, [slopes[i] for i in moving], ends_at_event)


def _not_of_failures(
    result: RolloutResult, slope: RolloutResult, moved: list[Any], ends_at_event: bool
) -> RolloutResult:
    """The derivative of a rollout by all inputs that vary; NaN if it did not reach its end."""
    good = ended_well(result.outcome.code)
    nothing = zero_of(moved)  # NaN also for inputs that no step has read

    def spoiled(good: jax.Array, tree: Any) -> Any:
        return nan_unless(good, jax.tree.map(lambda a: a + nothing.astype(a.dtype), tree))

    xs = spoiled(good if result.reached is None else result.reached, slope.xs)
    end = None if slope.end is None else spoiled(good, slope.end)
    crossings = slope.crossings
    if crossings is not None and result.crossings is not None:
        ts, states = spoiled(result.crossings.which >= 0, (crossings.ts, crossings.xs))
        crossings = dataclasses.replace(crossings, ts=ts, xs=states)
    outcome = slope.outcome
    if ends_at_event:  # other ends are fixed, and stay known outside of `jit`
        outcome = dataclasses.replace(outcome, t=spoiled(good, outcome.t))
    return dataclasses.replace(slope, xs=xs, end=end, outcome=outcome, crossings=crossings)


def _is_symbolic(slope: Any) -> bool:
    return isinstance(slope, jax.custom_derivatives.SymbolicZero)


def _taken_again(steps: Steps, stepper: Stepper, x: Arrays, run: Run, known: Meeting | None) -> RolloutResult:
    """The steps of a run taken again, in a differentiable form."""

    def step(y: Blocks, part: StepPart) -> Blocks:
        return advance_again(stepper, part.t, y, part.h)

    count, all_parts = run.outcome.accepted, steps.steps_of(run.path)
    # Steps beyond the count have length zero, at the start, where tables of controls have values: finished members of a
    # batch would fail there, and 0 inf is NaN.
    within = jnp.arange(steps.bound) < count
    taken = StepPart(jnp.where(within, all_parts.t, all_parts.t[:1]), jnp.where(within, all_parts.h, 0.0))
    crossed = None if run.event_state is None else run.event_state.crossed
    recorded = steps.dense or run.saved is not None or crossed is not None
    start, together = stepper.stored.enter(x), functools.partial(scan_again, stepper)
    end, every = take_steps(step, start, taken, count, steps.bound, recorded, together)
    run = dataclasses.replace(run, end=end, trail=steps.trail(run.path, count, every) if steps.dense else None)
    meeting = None
    if known is not None:
        begins = jnp.where(known.met, all_parts.t[jnp.minimum(count, steps.bound - 1)], known.t)
        meeting = refined(stepper, steps.events, end, run.outcome.h, dataclasses.replace(known, t=begins))

    def advance_all(starts: Blocks, parts: StepPart) -> Blocks:
        if stepper.method.solves and not batched_branches_transpose():
            return jax.lax.map(lambda entry: step(*entry), (starts, parts))
        return jax.vmap(step)(starts, parts)

    if crossed is not None and run.event_state is not None:
        # The starts of the steps with crossings, as taken again; rows without a crossing have length zero.
        there = crossed.which >= 0
        k = jnp.where(there, crossed.steps, 0)
        crossed = dataclasses.replace(
            crossed, t=all_parts.t[k], y=jax.tree.map(lambda a: a[k], every), s=jnp.where(there, crossed.s, 0.0)
        )
        crossed = refined_rows(stepper, steps.events, crossed)
        crossed = dataclasses.replace(crossed, y=advance_all(crossed.y, StepPart(crossed.t, crossed.s)))
        run = dataclasses.replace(run, event_state=dataclasses.replace(run.event_state, crossed=crossed))

    def to_saves(saved: Saved, parts: StepPart) -> Blocks:
        return advance_all(jax.tree.map(lambda a: a[saved.steps], every), parts)

    moved = None if meeting is None else to_event(functools.partial(advance_again, stepper), end, meeting)
    result = _to_saved_times(steps, stepper, x, run, meeting, moved, to_saves)
    return _with_conditions(stepper, run, result)
