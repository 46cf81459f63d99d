"""A whole rollout as one function of its inputs: fast forward, differentiable both ways."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import any_of_batch, batched_branches_transpose, is_traced
from ..scalar.small_call import small_call
from ..system.dynamics import Arrays
from .charts import Blocks
from .crossings import CrossingRows, crossing_rows
from .kernels import Packed, advance_again, beside, opened
from .meeting import Meeting, cut_at, refined, refined_rows, saved_before, to_event
from .method import Stepper, jitted
from .rows import first_rows
from .run import Outcome, Part, Result, Run, Saved, Trail
from .steps import Steps, all_finite, ended_well
from .unreached import nan_unless, nothing_of


class Rollout(NamedTuple):
    """Where the steps led."""

    #: The states at the saved times, leading axis n, NaN where the steps did not come so far; without any `end`.
    xs: Arrays
    end: Arrays | None  # the state they reached; None: that of the only row
    reached: jax.Array | None  # (n,) whether they came so far; None without saved times
    outcome: Any  # how they went, an `Outcome`, those of saved times included in the evaluations
    trail: Trail | None  # where it is kept
    event: jax.Array | None  # the number of the event that ended it, -1 for none; None where none is watched for
    at_start: jax.Array | None = None  # (m,) whether each condition was zero or past it at the start
    crossings: CrossingRows | None = None  # of events that do not end it, where there are any


def rollout(steps: Steps, stepper: Stepper, x: dict[str, Any]) -> Rollout:
    """Take all steps from the state x, compiled as one small function where that is known to work.

    Its derivatives, of any order and both ways, are those of the same steps taken again with bounded memory: lengths
    that were chosen by tolerances are kept, as shares of the way between limits, so that derivatives with respect to
    all times are right.
    """
    return handed_over(jitted(in_few_arrays, stepper, steps, x))


def in_few_arrays() -> Callable[[Stepper, Steps, Arrays], Rollout]:
    """What makes a rollout for `handed_over`: JAX takes 2 us for each array of a result."""
    whole = differentiable()

    def packed(stepper: Stepper, steps: Steps, x: Arrays) -> Rollout:
        found = whole(stepper, steps, x)
        *counts, t, h = found.outcome
        end = None if found.reached is None else found.end
        return found._replace(end=end, outcome=(jnp.stack(counts), jnp.stack([t, h])))

    return packed


def handed_over(found: Rollout) -> Rollout:
    """With its outcome, in numbers of NumPy where they are known."""
    array: Any = jnp if is_traced(found.outcome) else np
    counts, times = map(array.asarray, found.outcome)
    return found._replace(outcome=Outcome(*counts, *times))


def differentiable() -> Callable[[Stepper, Steps, Arrays], Rollout]:
    @jax.custom_jvp
    def taken(steps: Steps, stepper: Stepper, x: Arrays) -> Rollout:
        # As a whole where it fits, else its loops: what stands outside costs as much as a short rollout.
        return _batched_alike(small_call(_whole, steps, stepper, x), (steps, stepper, x))

    def along(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Rollout, Rollout]:
        return _differentiated(primals, tangents)

    taken.defjvp(along, symbolic_zeros=True)
    return lambda stepper, steps, x: taken(steps, stepper, x)


def _batched_alike(found: Rollout, inputs: Any) -> Rollout:
    """The same, batched where one of the inputs is: JAX expects the batch axes of a function in its derivative too."""
    firsts = [leaf.reshape(-1)[0] for leaf in jax.tree.leaves(jax.lax.stop_gradient(inputs)) if leaf.size]
    never = functools.reduce(jnp.logical_or, [first != first for first in firsts]) & False
    return jax.tree.map(lambda a: jnp.where(never, jnp.zeros_like(a), a), found)


def _whole(steps: Steps, stepper: Stepper, x: Arrays) -> Rollout:
    # Without a path saved times lie as the loop left them.
    run = steps.run(stepper, stepper.stored.enter(x), record=False)._replace(path=None)
    meeting, moved = None, None
    if run.watched is not None:
        meeting = Meeting.of(run)
        moved = jax.tree.map(functools.partial(jnp.where, meeting.met), run.watched.y, opened(run.end))

    if run.saved is None:
        found = small_call(_to_saved_times, steps, stepper, x, run, meeting, moved)
    elif steps.finds_rows and meeting is None:
        return _with_rows(steps, stepper, x, run)
    else:

        def to_saves(saved: Saved, parts: Part) -> Blocks:
            return small_call(_one_by_one, stepper, saved.y, parts, saved.asked.sum())

        found = _to_saved_times(steps, stepper, x, run, meeting, moved, to_saves)
    return _with_conditions(stepper, run, found, functools.partial(small_call, crossing_rows))


def _with_conditions(stepper: Stepper, run: Run, found: Rollout, rows: Any = crossing_rows) -> Rollout:
    """With what is known of the conditions; `rows` makes those of crossings."""
    if run.watched is None:
        return found
    crossed = run.watched.crossed
    crossings = None if crossed is None else rows(stepper, crossed)
    return found._replace(at_start=run.watched.held, crossings=crossings)


def _with_rows(steps: Steps, stepper: Stepper, x: Arrays, run: Run) -> Rollout:
    """With the saved states that the loop over steps found.

    A kernel reads them: where XLA itself counts a thousand operations it runs the whole on another thread, which takes
    10 us.
    """
    found = small_call(_to_saved_times, steps, stepper, x, run._replace(saved=None), None, None)
    saved, outcome = run.saved, found.outcome
    assert saved is not None

    def row(y: Blocks, t: jax.Array) -> tuple[jax.Array, jax.Array, Arrays]:
        return beside(_row, None, stepper, x, Packed.of(y), t, steps.t0, outcome.t)

    reached, lost, xs = jax.vmap(row)(saved.y, saved.t)
    lost = (outcome.code == Result.SUCCESS.value) & lost.any()
    code = jnp.where(lost, Result.NON_FINITE.value, outcome.code)
    return found._replace(xs=xs, reached=reached, outcome=outcome._replace(code=code))


def _row(
    _: None, stepper: Stepper, x: Arrays, y: Packed, t: jax.Array, t0: jax.Array, end: jax.Array
) -> tuple[jax.Array, jax.Array, Arrays]:
    """Whether a saved time was reached, whether it was lost though the steps came so far, and the values there."""
    within = t <= end
    reached = within & all_finite(y.flat)
    values = _or_start(stepper.stored.value(y.open()), t <= t0, x)
    return reached, within & ~reached, jax.tree.map(lambda a: jnp.where(reached, a, jnp.nan), values)


def _one_by_one(stepper: Stepper, ys: Blocks, parts: Part, count: jax.Array) -> Blocks:
    """The states at the ends of the first `count` parts of steps, one after the other.

    As one small function: in a loop of XLA a kernel for each takes longer to call than to run.
    """

    def save(_: None, entry: tuple[Blocks, Part]) -> tuple[None, Blocks]:
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
    advance_all: Callable[[Saved, Part], Blocks] | None = None,
) -> Rollout:
    """From the states before the saved times, and before an event, on to them."""
    parts = None if run.saved is None else steps.parts(run.path, run.saved)
    saved, moved, end = run.saved, opened(moved), opened(run.end)
    run = run._replace(end=end)
    if meeting is not None and moved is not None:
        halted, run, end = run, cut_at(moved, run, meeting), moved
        if saved is not None and parts is not None:
            saved, parts = saved_before(saved, parts, steps.saved_times, halted, meeting)
    stored, outcome = stepper.stored, run.outcome
    end = _or_start(stored.value(end), outcome.accepted == 0, x)
    event = None if meeting is None else meeting.event
    if saved is None or parts is None or advance_all is None:
        return Rollout({name: value[None] for name, value in end.items()}, end, None, outcome, run.trail, event)
    # Beyond a failure a step is of no length: one that overflows would spoil the derivatives of those before.
    parts = parts._replace(h=jnp.where(saved.reached, parts.h, 0.0))
    ys = advance_all(saved, parts)
    reached = saved.reached & jax.vmap(all_finite)(ys)
    at_start = (saved.steps == 0) & (jax.lax.stop_gradient(parts.h) <= 0.0)
    xs = _or_start(jax.vmap(stored.value)(ys), at_start, x)
    xs = jax.tree.map(lambda a: jnp.where(wide(reached, a), a, jnp.nan), xs)
    counts = (parts.h > 0.0).sum() * stepper.method.evaluations_of(stepper.dynamics)
    lost = (outcome.code == Result.SUCCESS.value) & (saved.asked & ~reached).any()
    code = jnp.where(lost, Result.NON_FINITE.value, outcome.code)
    outcome = outcome._replace(evaluations=outcome.evaluations + counts, code=code)
    return Rollout(xs, end, reached, outcome, run.trail, event)


def _or_start(values: Arrays, still: jax.Array, x: Arrays) -> Arrays:
    """The values, but the start as it was given, to the last bit, where no step was taken; derivatives stay."""
    found = {}
    for name, value in values.items():
        given = jnp.broadcast_to(jax.lax.stop_gradient(x[name]), value.shape)
        start = given + (value - jax.lax.stop_gradient(value))
        found[name] = jnp.where(wide(still, value), start, value)
    return found


def wide(flags: jax.Array, like: jax.Array) -> jax.Array:
    """Flags of rows, with as many axes as what they are of."""
    return flags.reshape(flags.shape + (1,) * (like.ndim - flags.ndim))


# ---- derivatives --------------------------------------------------------------------------------------------------


def _differentiated(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Rollout, Rollout]:
    steps, stepper, x = jax.lax.stop_gradient(primals)
    run = steps.run(stepper, stepper.stored.enter(x), record=True)
    known = None if run.watched is None else Meeting.of(run)
    leaves, structure = jax.tree.flatten(primals)
    slopes = jax.tree.leaves(tangents, is_leaf=_is_symbolic)
    moving = [i for i, slope in enumerate(slopes) if not _is_symbolic(slope)]

    def again(values: list[Any]) -> Rollout:
        given = list(leaves)
        for i, value in zip(moving, values, strict=True):
            given[i] = value
        steps, stepper, x = jax.tree.unflatten(structure, given)
        return _batched_alike(_again(steps, stepper, x, run, known), primals)

    found, slope = jax.jvp(again, ([leaves[i] for i in moving],), ([slopes[i] for i in moving],))
    ends_at_event = steps.watch is not None and any(steps.watch.terminal)
    return found, _not_of_failures(found, slope, [slopes[i] for i in moving], ends_at_event)


def _not_of_failures(found: Rollout, slope: Rollout, moved: list[Any], ends_at_event: bool) -> Rollout:
    """The derivative of a rollout, NaN where it did not come so far, with respect to everything that is moved."""
    good = ended_well(found.outcome.code)
    nothing = nothing_of(moved)  # what no step has read yet counts too

    def spoiled(good: jax.Array, tree: Any) -> Any:
        return nan_unless(good, jax.tree.map(lambda a: a + nothing.astype(a.dtype), tree))

    xs = spoiled(good if found.reached is None else found.reached, slope.xs)
    end = None if slope.end is None else spoiled(good, slope.end)
    crossings = slope.crossings
    if crossings is not None and found.crossings is not None:
        ts, states = spoiled(found.crossings.which >= 0, (crossings.ts, crossings.xs))
        crossings = crossings._replace(ts=ts, xs=states)
    outcome = slope.outcome
    if ends_at_event:  # other ends do not move, and stay known outside of `jit`
        outcome = outcome._replace(t=spoiled(good, outcome.t))
    return slope._replace(xs=xs, end=end, outcome=outcome, crossings=crossings)


def _is_symbolic(slope: Any) -> bool:
    return isinstance(slope, jax.custom_derivatives.SymbolicZero)


def _again(steps: Steps, stepper: Stepper, x: Arrays, run: Run, known: Meeting | None) -> Rollout:
    """The same rollout, by taking its steps again."""

    def step(y: Blocks, part: Part) -> Blocks:
        return advance_again(stepper, part.t, y, part.h)

    count, all_parts = run.outcome.accepted, steps.steps_of(run.path)
    # Of length zero beyond the count: lanes of a batch that are done would fail again, and 0 inf is NaN.
    taken = all_parts._replace(h=jnp.where(jnp.arange(steps.bound) < count, all_parts.h, 0.0))
    crossed = None if run.watched is None else run.watched.crossed
    recorded = steps.dense or run.saved is not None or crossed is not None
    end, every = take_steps(step, stepper.stored.enter(x), taken, count, steps.bound, recorded)
    run = run._replace(end=end, trail=steps.trail(run.path, count, every) if steps.dense else None)
    meeting = None
    if known is not None:
        begins = jnp.where(known.met, all_parts.t[jnp.minimum(count, steps.bound - 1)], known.t)
        meeting = refined(stepper, steps.watch, end, run.outcome.h, known._replace(t=begins))

    def advance_all(starts: Blocks, parts: Part) -> Blocks:
        if stepper.method.solves and not batched_branches_transpose():
            return jax.lax.map(lambda each: step(*each), (starts, parts))
        return jax.vmap(step)(starts, parts)

    if crossed is not None and run.watched is not None:
        # The steps that they lie in, as they were taken again; rows without a crossing are of no length.
        there = crossed.which >= 0
        k = jnp.where(there, crossed.steps, 0)
        crossed = crossed._replace(
            t=all_parts.t[k], y=jax.tree.map(lambda a: a[k], every), s=jnp.where(there, crossed.s, 0.0)
        )
        crossed = refined_rows(stepper, steps.watch, crossed)
        crossed = crossed._replace(y=advance_all(crossed.y, Part(crossed.t, crossed.s)))
        run = run._replace(watched=run.watched._replace(crossed=crossed))

    def to_saves(saved: Saved, parts: Part) -> Blocks:
        return advance_all(jax.tree.map(lambda a: a[saved.steps], every), parts)

    moved = None if meeting is None else to_event(functools.partial(advance_again, stepper), end, meeting)
    found = _to_saved_times(steps, stepper, x, run, meeting, moved, to_saves)
    return _with_conditions(stepper, run, found)


# ---- a loop of steps that can be differentiated both ways, in little memory ----------------------------------------

#: Steps in a block: what lies between is computed again on the way back, so that only states are kept.
_BLOCK = 16
#: Blocks are nested where there would be more of them than this.
_NEST = 64


def take_steps(
    step: Callable[[Any, Any], Any], y: Any, each: Any, count: jax.Array, bound: int, record: bool
) -> tuple[Any, Any]:
    """y after the first `count` of the steps y -> step(y, each[k]), k = 0, 1, ..., bound - 1.

    Traceable, and differentiable forward and in reverse to any order. On the way back only the states at the starts of
    blocks are kept: for n steps about 16 + 2 (n/16)^(1/2) states, at the cost of two more passes forward. What a step
    closes over is copied for every block, so it should be small. Blocks beyond the count are passed over, also for a
    whole batch at once under vmap. `record`: also return the values before each step, and after the last one, on a
    leading axis of bound + 1; entries beyond the count repeat the end.
    """

    def one(y: Any, entry: tuple[jax.Array, Any]) -> tuple[Any, Any]:
        k, own = entry

        def taken(y: Any) -> Any:
            return jax.tree.map(lambda new, old: jnp.where(k < count, new, old), step(y, own), y)

        return jax.lax.cond(any_of_batch(k < count), taken, lambda y: y, y), y if record else None

    def block_of(level: Any) -> Any:
        """Runs of a level, computed again on the way back, and passed over where the count is reached."""

        @jax.checkpoint
        def run(y: Any, entries: tuple[jax.Array, Any]) -> tuple[Any, Any]:
            return jax.lax.scan(level, y, entries)

        def block(y: Any, entries: tuple[jax.Array, Any]) -> tuple[Any, Any]:
            shapes = jax.eval_shape(run, y, entries)[1]
            first = entries[0].reshape(-1)[0]

            def passed(y: Any) -> tuple[Any, Any]:
                return y, shapes and jax.tree.map(lambda a, like: jnp.broadcast_to(a, like.shape), y, shapes)

            return jax.lax.cond(any_of_batch(first < count), lambda y: run(y, entries), passed, y)

        return block

    sizes = _sizes(bound)
    span = math.prod(sizes)

    def padded(a: jax.Array) -> jax.Array:
        return jnp.concatenate([a, jnp.broadcast_to(a[-1], (span - len(a), *a.shape[1:]))])

    entries = (jnp.arange(span), jax.tree.map(padded, each))
    entries = jax.tree.map(lambda a: a.reshape(*sizes, *a.shape[1:]), entries)
    level: Any = one
    for _ in sizes[1:]:
        level = block_of(level)
    end, before = jax.lax.scan(level, y, entries)
    if not record:
        return end, None
    steps = jax.tree.map(lambda a: a.reshape(span, *a.shape[len(sizes) :])[:bound], before)
    return end, jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), steps, end)


def _sizes(bound: int) -> list[int]:
    """Sizes of the nested blocks, outermost first, whose product is at least the bound."""
    if bound <= _BLOCK:
        return [max(bound, 1)]
    rest = math.ceil(bound / _BLOCK)
    if rest <= _NEST:
        return [rest, _BLOCK]
    outer = math.ceil(math.sqrt(rest))
    return [outer, math.ceil(rest / outer), _BLOCK]
