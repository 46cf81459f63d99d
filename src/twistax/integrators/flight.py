"""A whole flight as one function of its inputs: fast forward, differentiable both ways."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..lowering.dynamics import Arrays
from ..lowering.small_call import small_call
from .charts.whole import Blocks
from .checkpointed import take_steps
from .course import Course, Flown, Outcome, Part, Trail
from .event_end import Meeting, cut_at, locate, refined, saved_before
from .finite import all_finite
from .result import Result
from .step_again import advance_again
from .stepper import Stepper

__all__ = ["Flight", "fly"]


class Flight(NamedTuple):
    """Where a flight came to.

    Attributes:
        xs: the states at the saved times, leading axis n, not a number where the flight did not come so far; without
            saved times empty.
        end: the state it reached.
        reached: (n,) whether the flight came so far.
        outcome: how the steps went, those of saved times included in the evaluations.
        trail: the starts of all steps, where the course keeps them.
        event: the number of the event that ended it, -1 for none; None where the course watches for none.
    """

    xs: Arrays
    end: Arrays
    reached: jax.Array
    outcome: Outcome
    trail: Trail | None
    event: jax.Array | None


@jax.jit
def fly(course: Course, stepper: Stepper, x: Arrays) -> Flight:
    """Fly a course from the state x.

    The loop over steps is compiled as one small function where that is known to work. Its derivatives, of any order and
    both ways, are those of the same steps taken again with bounded memory: the lengths that an adaptive course chose
    are kept, as shares of the way between its limits, so that derivatives with respect to all times are right.
    """
    return _flight(course, stepper, x)


@jax.custom_jvp
def _flight(course: Course, stepper: Stepper, x: Arrays) -> Flight:
    # As a whole where it fits, else its loops: what stands outside costs as much as a short flight.
    return _batched_alike(small_call(_whole, course, stepper, x), (course, stepper, x))


def _batched_alike(flight: Flight, inputs: Any) -> Flight:
    """The same flight, all of it batched where one of the inputs is.

    JAX expects the batch axes of a function in those of its derivative too, but looks at the function alone.
    """
    firsts = [leaf.reshape(-1)[0] for leaf in jax.tree.leaves(jax.lax.stop_gradient(inputs)) if leaf.size]
    never = functools.reduce(jnp.logical_or, [first != first for first in firsts]) & False
    return jax.tree.map(lambda a: jnp.where(never, jnp.zeros_like(a), a), flight)


def _whole(course: Course, stepper: Stepper, x: Arrays) -> Flight:
    flown = course.run(stepper, stepper.stored.enter(x), record=False)
    meeting = None if course.watch is None else small_call(locate, stepper, course.watch, flown)
    parts = None if flown.saved is None else course.parts(None, flown.saved)
    flown, parts = _met(course, stepper, flown, parts, meeting)
    if flown.saved is None or parts is None:
        return _ended(stepper, flown, x, meeting)
    ys = small_call(_save, stepper, flown.saved.y, parts)
    return _saved(stepper, flown, ys, parts, x, meeting)


def _met(
    course: Course, stepper: Stepper, flown: Flown, parts: Part | None, meeting: Meeting | None
) -> tuple[Flown, Part | None]:
    """The flight up to the event, where it met one."""
    if meeting is None:
        return flown, parts
    halted, flown = flown, cut_at(stepper, flown, meeting)
    if flown.saved is None or parts is None:
        return flown, parts
    saved, parts = saved_before(flown.saved, parts, course.saved_times, halted, meeting)
    return flown._replace(saved=saved), parts


def _save(stepper: Stepper, ys: Blocks, parts: Part) -> Blocks:
    """The states at the ends of parts of steps, one after the other."""

    def save(_: None, entry: tuple[Blocks, Part]) -> tuple[None, Blocks]:
        y, part = entry
        return None, jax.lax.cond(part.h > 0.0, lambda y: stepper.advance(part.t, y, part.h), lambda y: y, y)

    return jax.lax.scan(save, None, (ys, parts))[1]


def _differentiated(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Flight, Flight]:
    course, stepper, x = jax.lax.stop_gradient(primals)
    flown = course.run(stepper, stepper.stored.enter(x), record=True)
    known = None if course.watch is None else locate(stepper, course.watch, flown)
    leaves, structure = jax.tree.flatten(primals)
    slopes = jax.tree.leaves(tangents, is_leaf=_is_symbolic)
    moving = [i for i, slope in enumerate(slopes) if not _is_symbolic(slope)]

    def again(values: list[Any]) -> Flight:
        course, stepper, x = jax.tree.unflatten(structure, _with(leaves, moving, values))
        return _batched_alike(_again(course, stepper, x, flown, known), primals)

    return jax.jvp(again, ([leaves[i] for i in moving],), ([slopes[i] for i in moving],))


_flight.defjvp(_differentiated, symbolic_zeros=True)


def _is_symbolic(slope: Any) -> bool:
    return isinstance(slope, jax.custom_derivatives.SymbolicZero)


def _with(leaves: list[Any], places: list[int], values: list[Any]) -> list[Any]:
    found = list(leaves)
    for place, value in zip(places, values, strict=True):
        found[place] = value
    return found


def _again(course: Course, stepper: Stepper, x: Arrays, flown: Flown, known: Meeting | None) -> Flight:
    """A flight by taking its steps again."""

    def step(y: Blocks, part: Part) -> Blocks:
        return advance_again(stepper, part.t, y, part.h)

    start = stepper.stored.enter(x)
    recorded = course.dense or flown.saved is not None
    steps = flown.outcome.accepted
    all_parts = course.steps_of(flown.path)
    # Of length zero beyond the count: lanes of a batch that are done would fail again, and 0 inf is not a number.
    taken = all_parts._replace(h=jnp.where(jnp.arange(course.bound) < steps, all_parts.h, 0.0))
    end, every = take_steps(step, start, taken, steps, course.bound, recorded)
    flown = flown._replace(end=end, trail=course.trail(flown.path, steps, every) if course.dense else None)
    meeting = None
    if known is not None:
        begins = jnp.where(known.met, all_parts.t[jnp.minimum(steps, course.bound - 1)], known.t)
        meeting = refined(stepper, course.watch, end, flown.outcome.h, known._replace(t=begins))
    parts = None if flown.saved is None else course.parts(flown.path, flown.saved)
    flown, parts = _met(course, stepper, flown, parts, meeting)
    saved = flown.saved
    if saved is None or parts is None:
        return _ended(stepper, flown, x, meeting)
    # Beyond a failure a step is of no length: one that overflows would spoil the derivatives of those before.
    parts = parts._replace(h=jnp.where(saved.reached, parts.h, 0.0))
    starts = jax.tree.map(lambda a: a[saved.steps], every)
    ys = jax.vmap(lambda part, y: advance_again(stepper, part.t, y, part.h))(parts, starts)
    return _saved(stepper, flown, ys, parts, x, meeting)


def _ended(stepper: Stepper, flown: Flown, x: Arrays, meeting: Meeting | None) -> Flight:
    end = _or_start(stepper.stored.value(flown.end), flown.outcome.accepted == 0, x)
    return Flight({}, end, jnp.zeros(0, bool), flown.outcome, flown.trail, _number(meeting))


def _number(meeting: Meeting | None) -> jax.Array | None:
    return None if meeting is None else meeting.which


def _saved(stepper: Stepper, flown: Flown, ys: Blocks, parts: Part, x: Arrays, meeting: Meeting | None) -> Flight:
    stored, saved = stepper.stored, flown.saved
    assert saved is not None  # flights without saved times end elsewhere
    at_start = (saved.steps == 0) & (jax.lax.stop_gradient(parts.h) <= 0.0)
    reached = saved.reached & jax.vmap(all_finite)(ys)
    xs = _or_start(jax.vmap(stored.value)(ys), at_start, x)
    xs = jax.tree.map(lambda a: jnp.where(_wide(reached, a), a, jnp.nan), xs)
    outcome = flown.outcome
    counts = (parts.h > 0.0).sum() * stepper.method.evaluations_of(stepper.dynamics)
    lost = (outcome.code == Result.SUCCESS.value) & ~reached.all()
    outcome = outcome._replace(
        evaluations=outcome.evaluations + counts, code=jnp.where(lost, Result.NON_FINITE.value, outcome.code)
    )
    end = _or_start(stored.value(flown.end), outcome.accepted == 0, x)
    return Flight(xs, end, reached, outcome, flown.trail, _number(meeting))


def _or_start(values: Arrays, still: jax.Array, x: Arrays) -> Arrays:
    """The values, but the start as it was given, to the last bit, where no step was taken; derivatives stay."""
    found = {}
    for name, value in values.items():
        given = jnp.broadcast_to(jax.lax.stop_gradient(x[name]), value.shape)
        start = given + (value - jax.lax.stop_gradient(value))
        found[name] = jnp.where(_wide(still, value), start, value)
    return found


def _wide(flags: jax.Array, like: jax.Array) -> jax.Array:
    return flags.reshape(flags.shape + (1,) * (like.ndim - flags.ndim))
