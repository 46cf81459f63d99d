"""The search of a step for roots of event conditions."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...scalar.small_call import small_call, stored_once
from ..loop.kernels import Packed, in_one, opened, shared_kernel
from ..loop.outcome import EventState, Halt, Result
from ..method import Stepper
from .conditions import Advance, EventConditions
from .crossings import CrossingTable, Row, row_of, state_of
from .root_finding import Bracket, ExtremumSearch, near_zero

#: Places within a step at which the conditions are evaluated by shorter steps, for methods without a polynomial.
_FEW = 3


class AcceptedStep(NamedTuple):
    """An accepted step."""

    steps: jax.Array  # the accepted steps before
    t: jax.Array
    h: jax.Array
    y: Packed  # the stored state where it begins
    end: Packed  # and where it ends
    inside: Any  # its slopes; None where the method has no polynomial


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Job:
    """A search between two neighbouring places, for a root, or for an extremum beyond zero and then both roots."""

    item: Any  # the number of the pair and the condition; larger than all of them where nothing is left
    looks: Any  # whether it is a search for an extremum
    visits: Any  # whether the root is known, and the next step leads there
    sign: Any  # of the condition at the start of the part
    low: Any  # the start and the end of the part with a root
    high: Any
    rest: Any  # the end of the next part, with another root; negative: there is none
    widened: Any  # 0: a part; -1, 1: the interval just before, or just after, a part
    extremum: Any
    bracket: Any

    @property
    def place(self) -> jax.Array:
        """The place at which the condition is to be evaluated next."""
        root = jnp.where(self.visits, self.bracket.root, self.bracket.place)
        return jnp.where(self.looks, self.extremum.place, root)


class _Samples(NamedTuple):
    """The conditions along a step, at k + 1 equidistant places, and the possible crossings between them."""

    values: jax.Array  # (k + 1, m)
    suspects: jax.Array  # (k, m) whether a condition may reach zero and turn back between two places
    tips: jax.Array  # (k, m) the place of its extremum then, as a share
    flags: jax.Array  # (k m,) whether there may be a crossing

    @classmethod
    def of(cls, events: EventConditions, values: jax.Array) -> _Samples:
        suspects, tips = near_zero(values)
        return cls(values, suspects, tips, (events.hits(values) | suspects).reshape(-1))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _PackedJob:
    """A job, packed for a loop."""

    job: Any  # packed
    place: Any  # the next place of evaluation
    left: Any  # whether the search goes on


class _Root(NamedTuple):
    """Whether the last place is a root, and of which condition."""

    stops: jax.Array  # whether it is a root of an event that ends the integration
    crosses: jax.Array  # whether it is a root of one that does not
    which: jax.Array
    rises: jax.Array


class _Halted(NamedTuple):
    """The earliest known place where the loop over steps halts, with the packed state there."""

    halt: Halt
    y: jax.Array

    def or_earlier(self, here: jax.Array, result: Result, which: jax.Array, s: jax.Array, y: jax.Array) -> _Halted:
        """The earlier one of this and another halt, if there is one; at the same time an event comes first."""
        code = jnp.full_like(which, result.value)
        same = (s == self.halt.s) & (code < self.halt.code)
        sooner = here & ((s < self.halt.s) | same)
        other = _Halted(Halt(code, which, s), y)
        halted: _Halted = jax.tree.map(lambda a, b: jnp.where(sooner, a, b), other, self)
        return halted


def find_crossings(
    events: EventConditions,
    advance: Advance,
    stepper: Stepper,
    accepted_step: AcceptedStep,
    known: EventState,
    taken: Any,
    ends: Any,
) -> EventState:
    """The state of the events after a step.

    Args:
        taken: whether the step counts.
        ends: whether it is the first step, and whether it is the last one.
    """
    t, h, y = accepted_step.t, accepted_step.h, accepted_step.y
    inside, cost = accepted_step.inside, stepper.method.evaluations_of(stepper.dynamics)
    if inside is None:

        def at(share: jax.Array) -> jax.Array:
            moved = advance(share * h)
            return shared_kernel(EventConditions.values, events, stepper, t, h, t + share * h, moved)

        inside = jax.lax.map(at, jnp.asarray(np.arange(1, _FEW + 1) / (_FEW + 1), h.dtype))
        known = dataclasses.replace(known, evaluations=known.evaluations + _FEW * cost)
    states = y, accepted_step.end, inside
    samples, after, first = shared_kernel(_first, events, stepper, t, h, states, known.values, ends)
    before = None if known.crossed is None else known.crossed.used

    def goes_on(now: tuple[_PackedJob, EventState]) -> jax.Array:
        return now[0].left

    def one(now: tuple[_PackedJob, EventState]) -> tuple[_PackedJob, EventState]:
        task, known = now
        known = dataclasses.replace(known, evaluations=known.evaluations + cost)
        halted = _Halted(known.halt, known.y)
        # Hundreds of scalars: inside of the loop they take XLA longer to compile than all else.
        inputs = (samples, task, halted), (accepted_step.steps, y), advance(task.place)
        following, halted, row, crosses = shared_kernel(_next, events, stepper, t, h, *inputs)
        if known.crossed is not None:
            nothing = known.crossed, row, jnp.asarray(False)
            crossed, left_out, full = jax.lax.cond(
                crosses, lambda: small_call(CrossingTable.with_one, known.crossed, row, before), lambda: nothing
            )
            known = dataclasses.replace(known, crossed=crossed)
            halted = halted.or_earlier(full, Result.MAX_CROSSINGS, *state_of(left_out))
        return following, dataclasses.replace(known, halt=halted.halt, y=halted.y)

    # A loop, not a branch: in a batch it runs only while a member needs it.
    start = dataclasses.replace(first, left=first.left & taken), known
    _, known = jax.lax.while_loop(goes_on, one, start)
    return dataclasses.replace(known, values=jnp.where(taken, after, known.values))


def halted_code(halt: Halt, code: jax.Array) -> jax.Array:
    """The number of the result if the conditions halt the integration."""
    return jnp.where(halt.code != Result.SUCCESS.value, halt.code, code)


def _first(
    events: EventConditions, stepper: Stepper, t: jax.Array, h: jax.Array, states: Any, old: jax.Array, ends: Any
) -> tuple[_Samples, jax.Array, _PackedJob]:
    """The conditions along a step and at its end, as for `EventConditions.seen`, and the first search."""
    values, after = events.seen(stepper, t, h, states, old, ends)
    samples = stored_once(_Samples.of(events, values))
    return samples, after, _Search(events, t, h, samples).first()


def _next(
    events: EventConditions,
    stepper: Stepper,
    t: jax.Array,
    h: jax.Array,
    search: tuple[_Samples, _PackedJob, _Halted],
    start: tuple[jax.Array, Packed],
    moved: Packed,
) -> tuple[_PackedJob, _Halted, Row | None, jax.Array]:
    """The next search after the step to the place of a task was taken, and where the loop halts.

    Args:
        start: the accepted steps before, and the state where the step begins.
    Returns:
        Also the row of a crossing, where there are any, and whether it is there.
    """
    (samples, task, halted), (steps, y) = search, start
    place = task.place
    moved = Packed(jnp.where(place > 0.0, moved.flat, y.flat), moved.read)
    values = events.values(stepper, t, h, t + place, moved)
    following, root = _Search(events, t, h, samples).after(opened(task.job), values, halted.halt.s)
    if any(events.terminal):
        halted = halted.or_earlier(root.stops, Result.EVENT, root.which, place, moved.flat)
    row = None if all(events.terminal) else row_of(steps, t, h, place, moved.flat, root.which, root.rises)
    return following, halted, row, root.crosses


class _Search:
    """The search for all crossings in a step, by shorter steps from its start.

    One loop takes one shorter step in each pass, because a compiled step is large.
    """

    def __init__(self, events: EventConditions, t: jax.Array, h: jax.Array, samples: _Samples) -> None:
        self.events, self.h = events, h
        self.values, self.suspects, self.tips, self.flags = samples
        self.pairs, self.width = self.tips.shape
        self.spacing = h / self.pairs
        self.finest = float(jnp.finfo(t.dtype).eps) * jnp.maximum(jnp.abs(t), jnp.abs(t + h))
        # The pair and the condition of each item, as tables: kernels do not divide integers. The item after all others,
        # which stands for none, has those of the last pair.
        pairs, numbers = np.divmod(np.arange(self.flags.size + 1), self.width)
        self.rows, self.numbers = jnp.asarray(np.minimum(pairs, self.pairs - 1)), jnp.asarray(numbers)
        self.senses = jnp.asarray(np.asarray(events.senses, h.dtype))

    def first(self) -> _PackedJob:
        index = self._next_item(jnp.zeros((), int) - 1)
        return self._task(self._job(index, *self._pair(index)))

    def _task(self, job: _Job) -> _PackedJob:
        return _PackedJob(in_one(job, self.h.dtype), job.place, job.item < self.flags.size)

    def _next_item(self, index: jax.Array) -> jax.Array:
        """The next pair of places and condition that may have a crossing."""
        every = jnp.arange(self.flags.size)
        return jnp.where(self.flags & (every > index), every, self.flags.size).min()

    def _pair(self, index: jax.Array) -> tuple[jax.Array, ...]:
        """Of a pair and a condition: whether to seek an extremum, the sign at its start, both ends, no next part."""
        row, number = self.rows[index], self.numbers[index]
        low, high = self._at(row), self._at(row + 1)
        return self.suspects[row, number], jnp.sign(self.values[row, number]), low, high, -jnp.ones_like(high)

    def _at(self, row: jax.Array) -> jax.Array:
        """The place of a row, as a time since the start of the step."""
        return jnp.where(row >= self.pairs, self.h, row.astype(self.spacing.dtype) * self.spacing)

    def _job(
        self, index: jax.Array, looks: jax.Array, sign: jax.Array, low: jax.Array, high: jax.Array, rest: jax.Array
    ) -> _Job:
        row, number = self.rows[index], self.numbers[index]
        ends = self.values[row, number], self.values[row + 1, number]
        place, none = self._at(row) + self.tips[row, number] * self.spacing, jnp.zeros((), int)
        extremum = ExtremumSearch((low, ends[0]), (place, ends[0]), (high, ends[1]), place, none > 0, none)
        bracket = Bracket.between(low, high, sign, -sign, self.finest)
        return _Job(index, looks, none > 0, sign, low, high, rest, none, extremum, bracket)

    def after(self, job: _Job, values: jax.Array, end: jax.Array) -> tuple[_PackedJob, _Root]:
        """The next search, from the values of all conditions at the place of a job, and the root there.

        Args:
            end: the earliest known end of the integration, as a time since the start of the step.
        """
        h, number = self.h, self.numbers[job.item]
        place, value = stored_once((job.place, values[number]))
        job = stored_once(
            dataclasses.replace(job, extremum=job.extremum.narrowed(value), bracket=job.bracket.narrowed(value))
        )

        # The bracket closed on an end whose sign is that of the polynomial: the step may cross zero just outside.
        low, high = (end(job.bracket.a[0], job.bracket.b[0]) for end in (jnp.minimum, jnp.maximum))
        at_low, at_high = (low <= job.low) & (job.low > 0.0), (high >= job.high) & (job.high < h)
        # In the interval next to a part, a bracket that closed on their common end has the root.
        missed = (at_low & (job.widened <= 0)) | (at_high & (job.widened >= 0))
        closed = ~job.looks & ~job.visits & job.bracket.done
        widens = closed & missed & (job.widened == 0)
        # The state at the root is known if the last step led there.
        visits = closed & ~missed & (job.bracket.root != place)
        done = job.visits | jnp.where(job.looks, job.extremum.done, closed & ~widens & ~visits)
        here = job.visits | (closed & ~missed & ~visits)
        terminal = jnp.asarray(np.array(self.events.terminal))[number]
        done, widens, visits, here = stored_once((done, widens, visits, here))
        root = _Root(here & terminal, here & ~terminal, number, job.sign < 0.0)

        # The condition moves in the direction of its sign up to an extremum, then back.
        tip, wanted = job.extremum.middle[0], self.senses[number]
        first, second = job.sign * wanted <= 0.0, job.sign * wanted >= 0.0
        extremum_found = job.looks & job.extremum.past
        half, follows = 0.5 * self.spacing, self._next_item(job.item)
        # Pairs after the end of the integration are skipped.
        over = self._at(self.rows[follows]) >= jnp.where(root.stops, jnp.minimum(end, place), end)
        follows = stored_once(jnp.where(over, self.flags.size, follows))
        none = -jnp.ones_like(h)
        parts = [
            (widens, (job.item, job.looks, job.sign, *self._next_to(job, at_low, half), job.rest)),
            (
                extremum_found & first,
                (job.item, ~extremum_found, job.sign, job.low, tip, jnp.where(second, job.high, none)),
            ),
            (extremum_found & second, (job.item, ~extremum_found, -job.sign, tip, job.high, none)),
            (~job.looks & (job.rest > job.high), (job.item, job.looks, -job.sign, job.high, job.rest, none)),
        ]
        chosen: Any = (follows, *self._pair(follows))
        for condition, part in reversed(parts):
            chosen = tuple(jnp.where(condition, a, b) for a, b in zip(part, chosen, strict=True))
        widened = jnp.where(widens, jnp.where(at_low, -1, 1), 0)
        another = dataclasses.replace(self._job(*stored_once(chosen)), widened=widened)
        job = jax.tree.map(
            lambda a, b: jnp.where(done | widens, a, b), another, dataclasses.replace(job, visits=visits)
        )
        return self._task(job), root

    def _next_to(self, job: _Job, at_low: jax.Array, half: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The half of a pair next to a part."""
        low = jnp.where(at_low, jnp.maximum(job.low - half, 0.0), job.high)
        return low, jnp.where(at_low, job.low, jnp.minimum(job.high + half, self.h))
