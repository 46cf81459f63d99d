"""Where within a step the conditions of an integration become zero, and what becomes of it then."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .bracket import Bracket, Extremum, near_zero
from .charts import Blocks
from .events import Advance, Watch
from .kernels import beside
from .method import Stepper
from .rows import put
from .run import Crossed, Part, Result, Run, Saved, Trail, Watched

#: Places within a step at which a method without a polynomial is looked at, by shorter steps.
_FEW = 3


class Stride(NamedTuple):
    """A step that was taken."""

    steps: Any  # the accepted steps before; None where no crossing is written
    t: jax.Array
    h: jax.Array
    y: Any  # the stored state where it begins
    end: Any  # and where it ends
    inside: Any  # its slopes; None where the method has no polynomial


class _Job(NamedTuple):
    """What is looked for between two neighbouring places: an extremum past zero, then the roots before and after it;
    or a root.
    """

    item: jax.Array  # of the pair and the condition; beyond all of them where nothing is left
    looks: jax.Array  # whether it is an extremum
    sign: jax.Array  # of the condition where the part begins
    low: jax.Array  # where a part with a root begins and ends
    high: jax.Array
    rest: jax.Array  # where the part after it ends, with another root; negative: there is none
    widened: jax.Array  # -1, 1: it is what lies beside a part, before or after it; 0: a part
    extremum: Extremum
    bracket: Bracket

    @property
    def place(self) -> jax.Array:
        """Where the condition is to be evaluated."""
        return jnp.where(self.looks, self.extremum.place, self.bracket.place)


class _Ends(NamedTuple):
    """Of what is known of the conditions that which ends the search, as in `Watched`."""

    met: jax.Array
    which: jax.Array
    s: jax.Array
    full: jax.Array


class _Root(NamedTuple):
    """A root of a condition, as in `Crossed`."""

    crosses: jax.Array  # whether it is there, of an event that does not end the integration
    number: jax.Array
    s: jax.Array
    rises: jax.Array


def watched_along(
    watch: Watch, advance: Advance, stepper: Stepper, stride: Stride, known: Watched, taken: Any, ends: Any
) -> Watched:
    """What is known of the conditions after a step.

    Args:
        taken: whether the step counts.
        ends: whether it is the first step, and whether it is the last one.
    """
    t, h, y = stride.t, stride.h, stride.y
    inside, cost = stride.inside, 0
    if inside is None:

        def at(share: jax.Array) -> jax.Array:
            moved = advance(t, y, share * h)
            return beside(Watch.values, watch, stepper, t, h, t + share * h, moved)

        inside = jax.lax.map(at, jnp.asarray(np.arange(1, _FEW + 1) / (_FEW + 1), h.dtype))
        cost = _FEW * stepper.method.evaluations_of(stepper.dynamics)
    values, after, busy = beside(Watch.seen, watch, stepper, t, h, y, stride.end, inside, known.values, ends)
    known = known._replace(evaluations=known.evaluations + cost)

    def search(now: tuple[jax.Array, Watched]) -> tuple[jax.Array, Watched]:
        return jnp.zeros_like(busy), _Search(watch, advance, stepper, stride, values).run(now[1])

    # A loop, not a branch: of a batch it runs only while one of its members needs it.
    _, known = jax.lax.while_loop(lambda now: now[0], search, (busy & taken, known))
    return known._replace(values=jnp.where(taken, after, known.values))


class _Search:
    """The search for all crossings in a step whose values (k + 1, m) are known, by parts of the step taken again.

    One loop, which takes a part of the step in each pass: a compiled step is large.
    """

    def __init__(self, watch: Watch, advance: Any, stepper: Stepper, stride: Stride, values: jax.Array) -> None:
        self.watch, self.advance, self.stepper, self.stride, self.values = watch, advance, stepper, stride, values
        self.pairs, self.width = len(values) - 1, values.shape[1]
        self.spacing = stride.h / self.pairs
        t, h = stride.t, stride.h
        self.finest = float(jnp.finfo(t.dtype).eps) * jnp.maximum(jnp.abs(t), jnp.abs(t + h))
        self.suspects, self.tips = near_zero(values)
        self.flags = (watch.hits(values) | self.suspects).reshape(-1)
        # Of each item its pair and its condition, and of what stands for none those of the last pair: kernels do not
        # divide whole numbers.
        pairs, numbers = np.divmod(np.arange(self.flags.size + 1), self.width)
        self.rows, self.numbers = jnp.asarray(np.minimum(pairs, self.pairs - 1)), jnp.asarray(numbers)
        self.senses = jnp.asarray(np.asarray(watch.senses, values.dtype))

    def run(self, known: Watched) -> Watched:
        """With what is crossed, in order, up to an event that ends the integration."""
        before = None if known.crossed is None else known.crossed.used
        begun = known._replace(s=jnp.full_like(known.s, jnp.inf))
        start = self._job(self._after(jnp.zeros((), int) - 1), *self._pair(self._after(jnp.zeros((), int) - 1)))
        _, found = jax.lax.while_loop(lambda now: now[0].item < self.flags.size, self._one, (start, begun))
        if found.crossed is not None and before is not None:
            # What is crossed after the integration has ended is not.
            rows = found.crossed
            late = (jnp.arange(len(rows.which)) >= before) & ((rows.s > found.s) | (found.full & ~found.met))
            found = found._replace(crossed=rows._replace(which=jnp.where(late, -1, rows.which)))
        return found._replace(s=jnp.where(found.met, found.s, 0.0), full=found.full & ~found.met)

    def _after(self, index: jax.Array) -> jax.Array:
        """The next of the pairs and conditions that may have a crossing."""
        every = jnp.arange(self.flags.size)
        return jnp.where(self.flags & (every > index), every, self.flags.size).min()

    def _pair(self, index: jax.Array) -> tuple[jax.Array, ...]:
        """Of a pair and a condition: whether to look for an extremum, the sign where it begins, both ends, no rest."""
        row, number = self.rows[index], self.numbers[index]
        low, high = self._at(row), self._at(row + 1)
        return self.suspects[row, number], jnp.sign(self.values[row, number]), low, high, -jnp.ones_like(high)

    def _at(self, row: jax.Array) -> jax.Array:
        """Where a place is, by its row."""
        return jnp.where(row >= self.pairs, self.stride.h, row.astype(self.spacing.dtype) * self.spacing)

    def _job(
        self, index: jax.Array, looks: jax.Array, sign: jax.Array, low: jax.Array, high: jax.Array, rest: jax.Array
    ) -> _Job:
        row, number = self.rows[index], self.numbers[index]
        ends = self.values[row, number], self.values[row + 1, number]
        place, none = self._at(row) + self.tips[row, number] * self.spacing, jnp.zeros((), int)
        extremum = Extremum((low, ends[0]), (place, ends[0]), (high, ends[1]), place, none > 0, none)
        bracket = Bracket.between(low, high, sign, -sign, self.finest)
        return _Job(index, looks, sign, low, high, rest, none, extremum, bracket)

    def _one(self, now: tuple[_Job, Watched]) -> tuple[_Job, Watched]:
        """After a part of the step was taken."""
        (job, known), stride = now, self.stride
        moved = self.advance(stride.t, stride.y, job.place)
        room = jnp.asarray(True) if known.crossed is None else known.crossed.used < len(known.crossed.which)
        ends = _Ends(known.met, known.which, known.s, known.full)
        given = (stride.t, stride.h, self.values, job, ends, room, moved)
        # Hundreds of scalars: as part of the loop they take XLA longer than all else.
        job, ends, root = beside(_after_part, self.watch, self.stepper, *given)
        cost = self.stepper.method.evaluations_of(self.stepper.dynamics)
        known = known._replace(evaluations=known.evaluations + cost, **ends._asdict())
        if known.crossed is None:
            return job, known
        none = jnp.zeros((), int)
        row = Crossed(stride.steps, stride.t, stride.h, stride.y, root.s, root.number, root.rises, none)
        return job, known._replace(crossed=known.crossed.with_one(row, root.crosses)[0])

    def after(self, job: _Job, ends: _Ends, room: jax.Array, moved: Any) -> tuple[_Job, _Ends, _Root]:
        """What is looked for next, after a part of the step was taken, and a root, where it is there.

        Args:
            room: whether there is room for a crossing.
        """
        t, h = self.stride.t, self.stride.h
        number = self.numbers[job.item]
        value = self.watch.values(self.stepper, t, h, t + job.place, moved)[number]
        job = job._replace(extremum=job.extremum.narrowed(value), bracket=job.bracket.narrowed(value))

        # A bracket that closed on an end whose sign a polynomial told: the step itself may cross zero just outside.
        low, high = (end(job.bracket.a[0], job.bracket.b[0]) for end in (jnp.minimum, jnp.maximum))
        at_low, at_high = (low <= job.low) & (job.low > 0.0), (high >= job.high) & (job.high < h)
        # Beside a part, where it closed on the end next to that, the root is there.
        lost = (at_low & (job.widened <= 0)) | (at_high & (job.widened >= 0))
        widens = ~job.looks & job.bracket.done & lost & (job.widened == 0)
        done = jnp.where(job.looks, job.extremum.done, job.bracket.done & ~widens)
        ends, root = self._with_root(ends, room, job, done & ~job.looks & ~lost)

        # Up to an extremum the condition goes the way that its sign says, then back.
        tip, wanted = job.extremum.middle[0], self.senses[number]
        first, second = job.sign * wanted <= 0.0, job.sign * wanted >= 0.0
        found = job.looks & job.extremum.past
        half, follows = 0.5 * self.spacing, self._after(job.item)
        follows = jnp.where(
            ends.full | (ends.met & (self.rows[follows] > self.rows[job.item])), self.flags.size, follows
        )
        none = -jnp.ones_like(h)
        parts = [
            (widens, (job.item, job.looks, job.sign, *self._beside(job, at_low, half), job.rest)),
            (found & first, (job.item, ~found, job.sign, job.low, tip, jnp.where(second, job.high, none))),
            (found & second, (job.item, ~found, -job.sign, tip, job.high, none)),
            (~job.looks & (job.rest > job.high), (job.item, job.looks, -job.sign, job.high, job.rest, none)),
        ]
        chosen: Any = (follows, *self._pair(follows))
        for condition, part in reversed(parts):
            chosen = tuple(jnp.where(condition, a, b) for a, b in zip(part, chosen, strict=True))
        another = self._job(*chosen)._replace(widened=jnp.where(widens, jnp.where(at_low, -1, 1), 0))
        return jax.tree.map(lambda a, b: jnp.where(done | widens, a, b), another, job), ends, root

    def _beside(self, job: _Job, at_low: jax.Array, half: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The half of a pair next to a part."""
        low = jnp.where(at_low, jnp.maximum(job.low - half, 0.0), job.high)
        return low, jnp.where(at_low, job.low, jnp.minimum(job.high + half, self.stride.h))

    def _with_root(self, ends: _Ends, room: jax.Array, job: _Job, there: jax.Array) -> tuple[_Ends, _Root]:
        """With a root, where it is there."""
        number, s = self.numbers[job.item], job.bracket.root
        terminal = jnp.asarray(np.array(self.watch.terminal))[number]
        stops, crosses = there & terminal, there & ~terminal
        sooner = stops & (s < ends.s)
        which, first = jnp.where(sooner, number, ends.which), jnp.where(sooner, s, ends.s)
        return _Ends(ends.met | stops, which, first, ends.full | (crosses & ~room)), _Root(
            crosses, number, s, job.sign < 0.0
        )


def halted_code(watched: Watched, code: jax.Array) -> jax.Array:
    """The number of the result, where the conditions halt the integration."""
    code = jnp.where(watched.full, Result.MAX_CROSSINGS.value, code)
    return jnp.where(watched.met, Result.EVENT.value, code)


def _after_part(
    watch: Watch,
    stepper: Stepper,
    t: jax.Array,
    h: jax.Array,
    values: jax.Array,
    job: _Job,
    ends: _Ends,
    room: jax.Array,
    moved: Any,
) -> tuple[_Job, _Ends, _Root]:
    stride = Stride(None, t, h, None, None, None)
    return _Search(watch, None, stepper, stride, values).after(job, ends, room, moved)


# ---- after the loop ------------------------------------------------------------------------------------------------


class Meeting(NamedTuple):
    """Where an integration meets an event that ends it."""

    met: jax.Array  # whether it does
    which: jax.Array  # the number of the event; -1 for none
    s: jax.Array  # how far into the step from where the loop halted; zero for none
    t: jax.Array  # the start of that step

    @classmethod
    def of(cls, run: Run) -> Meeting:
        """That of a loop that halted before its step."""
        seen = run.watched
        assert seen is not None
        met = run.outcome.code == Result.EVENT.value
        return cls(met, jnp.where(met, seen.which, -1), jnp.where(met, seen.s, 0.0), run.outcome.t)


def refined(stepper: Stepper, watch: Watch, y: Blocks, h: jax.Array, meeting: Meeting) -> Meeting:
    """The same meeting, whose root moves as the condition does with all inputs: by the implicit function theorem."""
    which = jnp.maximum(meeting.which, 0)

    # At the start of the integration it stays.
    moves = meeting.met & (jax.lax.stop_gradient(meeting.s) > 0.0)

    def value(s: jax.Array) -> jax.Array:
        values = watch.values(stepper, meeting.t, h, meeting.t + s, stepper.advance(meeting.t, y, s))
        return jnp.where(moves, values[which], s)

    root = jax.lax.custom_root(
        value,
        jax.lax.stop_gradient(meeting.s),
        lambda function, known: known,
        lambda slope, change: change / slope(jnp.ones_like(change)),
    )
    return meeting._replace(s=root)


def to_event(advance: Advance, run: Run, meeting: Meeting) -> Any:
    """The state at the event, or where the loop came to its end."""
    on = meeting.met & (jax.lax.stop_gradient(meeting.s) > 0.0)
    return jax.lax.cond(on, lambda y: advance(meeting.t, y, meeting.s), lambda y: y, run.end)


def cut_at(moved: Blocks, run: Run, meeting: Meeting) -> Run:
    """A run that halted before a step, taken on to the event within it, where the state is `moved`."""
    met, s, outcome = meeting.met, meeting.s, run.outcome
    one = (met & (jax.lax.stop_gradient(s) > 0.0)).astype(outcome.accepted.dtype)
    t = jnp.where(met, meeting.t + s, outcome.t)
    trail = run.trail
    if trail is not None:
        last = trail.steps + one
        trail = Trail(trail.t.at[last].set(jnp.where(met, t, trail.t[last])), put(trail.y, last, moved), last)
    outcome = outcome._replace(t=t, tried=outcome.tried + one, accepted=outcome.accepted + one)
    return run._replace(end=moved, outcome=outcome, trail=trail)


def saved_before(saved: Saved, parts: Part, ts: jax.Array, run: Run, meeting: Meeting) -> tuple[Saved, Part]:
    """Saved times in the last step taken from its start, those after the event not reached; the run is as it halted."""
    within = meeting.met & (ts > meeting.t) & (ts <= meeting.t + meeting.s)
    reached = jnp.where(meeting.met, saved.asked & (ts <= meeting.t + meeting.s), saved.reached)

    def pick(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(within.reshape(within.shape + (1,) * new.ndim), new[None], old)

    ys = jax.tree.map(pick, run.end, saved.y)
    steps = pick(run.outcome.accepted, saved.steps)
    h = jnp.where(within, ts - meeting.t, jnp.where(reached, parts.h, 0.0))
    saved = Saved(steps, pick(meeting.t, saved.t), ys, reached, saved.asked)
    return saved, Part(pick(meeting.t, parts.t), h)


class CrossingRows(NamedTuple):
    """Crossings in the order of their times, rows (n, ...): NaN beyond the count."""

    ts: jax.Array  # in s
    xs: Any  # the states by name
    which: jax.Array  # the numbers of the events, -1 beyond the count
    directions: jax.Array  # 1 where the condition rises, else -1; 0 beyond the count
    used: jax.Array  # the count


def refined_rows(stepper: Stepper, watch: Watch, crossed: Crossed) -> Crossed:
    """Crossings whose times move as their conditions do with all inputs, from the states where their steps begin."""

    def one(row: Crossed) -> jax.Array:
        meeting = Meeting(row.which >= 0, row.which, row.s, row.t)
        return refined(stepper, watch, row.y, row.h, meeting).s

    s = jax.lax.map(one, crossed._replace(used=()))
    return crossed._replace(s=s)


def crossing_rows(stepper: Stepper, crossed: Crossed, ys: Blocks) -> CrossingRows:
    """What users get of crossings, at which the stored states are ys."""
    there = crossed.which >= 0
    ts = jnp.where(there, crossed.t + crossed.s, jnp.nan)
    xs = jax.vmap(stepper.stored.value)(ys)
    xs = {k: jnp.where(there.reshape(there.shape + (1,) * (v.ndim - 1)), v, jnp.nan) for k, v in xs.items()}
    order = jnp.argsort(jax.lax.stop_gradient(ts), stable=True)
    directions = jnp.where(there, jnp.where(crossed.rises, 1, -1), 0)
    rows = jax.tree.map(lambda a: a[order], (stepper.clock(ts), xs, crossed.which, directions))
    ts, xs, which, directions = rows
    return CrossingRows(ts, xs, which, directions, there.sum())
