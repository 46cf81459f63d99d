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

    steps: jax.Array  # the accepted steps before
    t: jax.Array
    h: jax.Array
    y: Any  # the stored state where it begins
    end: Any  # and where it ends
    inside: Any  # its slopes; None where the method has no polynomial


class _Slots(NamedTuple):
    """Parts of a step in which a condition crosses zero: two to a pair of neighbouring places, m conditions each."""

    low: jax.Array  # (2 k, m) where each part begins
    high: jax.Array  # and ends
    sign: jax.Array  # of the condition where it begins
    pending: jax.Array  # whether it is still to be looked for


class _Job(NamedTuple):
    """What is looked for: an extremum past zero, or a root."""

    active: jax.Array
    looks: jax.Array  # whether it is an extremum
    row: jax.Array  # of the pair of places, or of the part of the step
    number: jax.Array  # of the condition
    sign: jax.Array  # of the condition where it begins
    extremum: Extremum
    low: jax.Array  # of a root where the part begins and ends
    high: jax.Array
    widened: jax.Array
    bracket: Bracket

    @property
    def place(self) -> jax.Array:
        """Where the condition is to be evaluated."""
        return jnp.where(self.looks, self.extremum.place, self.bracket.place)


class _State(NamedTuple):
    suspects: jax.Array  # (k, m) pairs of places that may have an extremum past zero between them
    slots: _Slots
    job: _Job
    known: Watched


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

    def __init__(self, watch: Watch, advance: Advance, stepper: Stepper, stride: Stride, values: jax.Array) -> None:
        self.watch, self.advance, self.stepper, self.stride, self.values = watch, advance, stepper, stride, values
        self.pairs, self.width = len(values) - 1, values.shape[1]
        self.spacing = stride.h / self.pairs
        t, h = stride.t, stride.h
        self.finest = float(jnp.finfo(t.dtype).eps) * jnp.maximum(jnp.abs(t), jnp.abs(t + h))

    def run(self, known: Watched) -> Watched:
        """With what is crossed, in order, up to an event that ends the integration."""
        before = None if known.crossed is None else known.crossed.count
        begun = known._replace(s=jnp.full_like(known.s, jnp.inf))
        start = self._next(_State(near_zero(self.values)[0], self._parts(), self._no_job(), begun))
        found = jax.lax.while_loop(lambda now: now.job.active, self._one, start).known
        if found.crossed is not None:
            # What is crossed after the integration has ended is not.
            rows = found.crossed
            late = (jnp.arange(len(rows.which)) >= before) & ((rows.s > found.s) | (found.full & ~found.met))
            found = found._replace(crossed=rows._replace(which=jnp.where(late, -1, rows.which)))
        return found._replace(s=jnp.where(found.met, found.s, 0.0), full=found.full & ~found.met)

    def _at(self, row: jax.Array) -> jax.Array:
        """Where a place is, by its row."""
        return jnp.where(row >= self.pairs, self.stride.h, row.astype(self.spacing.dtype) * self.spacing)

    def _parts(self) -> _Slots:
        """The pairs of places with a crossing, each as the first of two parts."""
        rows = jnp.arange(self.pairs)
        low, high = (jnp.broadcast_to(self._at(each)[:, None], (self.pairs, self.width)) for each in (rows, rows + 1))
        sign, hits = jnp.sign(self.values[:-1]), self.watch.hits(self.values)
        both = (low, high), (high, high), (sign, -sign), (hits, jnp.zeros_like(hits))
        return _Slots(*(jnp.stack(pair, 1).reshape(2 * self.pairs, self.width) for pair in both))

    def _no_job(self) -> _Job:
        number, none = jnp.zeros_like(self.stride.h), jnp.zeros((), int)
        off, place = none > 0, (number, number)
        extremum = Extremum(place, place, place, number, off, none)
        return _Job(off, off, none, none, number, extremum, number, number, off, self._bracket(number, number, number))

    def _bracket(self, low: jax.Array, high: jax.Array, sign: jax.Array) -> Bracket:
        """That of a root between two places, where the values have a sign and the other one."""
        return Bracket.between(low, high, sign, -sign, self.finest)

    def _next(self, now: _State) -> _State:
        """With another job: the first of the extrema, then the first of the parts."""
        suspects, slots = now.suspects, now.slots
        looks = suspects.any()
        (row, number), (slot, other) = (self._first(each) for each in (suspects, slots.pending))
        place = self._at(row) + near_zero(self.values)[1][row, number] * self.spacing
        ends = (self._at(row), self.values[row, number]), (self._at(row + 1), self.values[row + 1, number])
        none = jnp.zeros((), int)
        extremum = Extremum(ends[0], (place, ends[0][1]), ends[1], place, none > 0, none)
        low, high, sign = slots.low[slot, other], slots.high[slot, other], slots.sign[slot, other]
        job = _Job(
            looks | slots.pending.any(),
            looks,
            jnp.where(looks, row, slot),
            jnp.where(looks, number, other),
            jnp.where(looks, jnp.sign(ends[0][1]), sign),
            extremum,
            low,
            high,
            none > 0,
            self._bracket(low, high, sign),
        )
        return now._replace(job=job)

    def _first(self, flags: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Row and column of the first flag, row by row; of the first entry where there is none."""
        count = flags.size
        index = jnp.where(flags.reshape(-1), jnp.arange(count), count).min() % count
        return index // self.width, index % self.width

    def _one(self, now: _State) -> _State:
        """After a part of the step was taken."""
        job, stride = now.job, self.stride
        moved = self.advance(stride.t, stride.y, job.place)
        given = (stride.t, stride.h, moved, job.number, stride.t + job.place)
        value = beside(_one_value, self.watch, self.stepper, *given)
        cost = self.stepper.method.evaluations_of(self.stepper.dynamics)
        now = now._replace(known=now.known._replace(evaluations=now.known.evaluations + cost))
        job = job._replace(extremum=job.extremum.narrowed(value), bracket=job.bracket.narrowed(value))
        job, there = self._widened(job)
        done = jnp.where(job.looks, job.extremum.done, job.bracket.done)
        looked = self._next(self._with_extremum(now, job))
        met = self._next(self._with_root(now, job, there))

        def pick(a: Any, b: Any, c: Any) -> Any:
            return jax.tree.map(lambda a, b, c: jnp.where(done, jnp.where(job.looks, a, b), c), a, b, c)

        return pick(looked, met, now._replace(job=job))

    def _widened(self, job: _Job) -> tuple[_Job, jax.Array]:
        """A bracket that closed on an end whose sign a polynomial told; and whether its root is there.

        The step itself may cross zero just outside of the part: beside it once more.
        """
        h, half = self.stride.h, 0.5 * self.spacing
        low, high = (jnp_of(job.bracket.a[0], job.bracket.b[0]) for jnp_of in (jnp.minimum, jnp.maximum))
        at_low, at_high = (low <= job.low) & (job.low > 0.0), (high >= job.high) & (job.high < h)
        lost = job.bracket.done & (at_low | at_high)
        again = lost & ~job.widened & ~job.looks
        begin = jnp.where(at_low, jnp.maximum(job.low - half, 0.0), job.high)
        end = jnp.where(at_low, job.low, jnp.minimum(job.high + half, h))
        wider = job._replace(
            low=begin, high=end, widened=again | job.widened, bracket=self._bracket(begin, end, job.sign)
        )
        return jax.tree.map(lambda a, b: jnp.where(again, a, b), wider, job), ~lost

    def _with_extremum(self, now: _State, job: _Job) -> _State:
        """With a part up to an extremum past zero and one after it, where the directions are wanted."""
        slots, row, number = now.slots, job.row, job.number
        past, tip = job.extremum.past, job.extremum.middle[0]
        wanted = jnp.asarray(np.asarray(self.watch.senses, self.values.dtype))[number]
        high = jnp.where(past, tip, slots.high[2 * row, number])
        low = jnp.where(past, tip, slots.low[2 * row + 1, number])
        first = slots.pending[2 * row, number] | (past & (job.sign * wanted <= 0.0))
        second = past & (job.sign * wanted >= 0.0)
        pending = slots.pending.at[2 * row, number].set(first).at[2 * row + 1, number].set(second)
        slots = slots._replace(
            high=slots.high.at[2 * row, number].set(high),
            low=slots.low.at[2 * row + 1, number].set(low),
            pending=pending,
        )
        return now._replace(slots=slots, suspects=now.suspects.at[row, number].set(False))

    def _with_root(self, now: _State, job: _Job, there: jax.Array) -> _State:
        """With a root, where it is there."""
        known, stride, number, root = now.known, self.stride, job.number, job.bracket.root
        terminal = jnp.asarray(np.array(self.watch.terminal))[number]
        ends = there & terminal
        sooner = ends & (root < known.s)
        known = known._replace(
            met=known.met | ends,
            which=jnp.where(sooner, number, known.which),
            s=jnp.where(sooner, root, known.s),
        )
        if known.crossed is not None:
            none = jnp.zeros((), int)
            own = Crossed(stride.steps, stride.t, stride.h, stride.y, root, number, job.sign < 0.0, none)
            crossed, full = known.crossed.with_one(own, there & ~terminal)
            known = known._replace(crossed=crossed, full=known.full | full)
        # Other conditions may be zero in the same part, and sooner.
        later = jnp.arange(2 * self.pairs)[:, None] > job.row
        pending = now.slots.pending.at[job.row, number].set(False) & ~known.full & ~(known.met & later)
        return now._replace(known=known, slots=now.slots._replace(pending=pending))


def halted_code(watched: Watched, code: jax.Array) -> jax.Array:
    """The number of the result, where the conditions halt the integration."""
    code = jnp.where(watched.full, Result.MAX_CROSSINGS.value, code)
    return jnp.where(watched.met, Result.EVENT.value, code)


def _one_value(
    watch: Watch, stepper: Stepper, t: jax.Array, h: jax.Array, moved: Any, number: jax.Array, time: jax.Array
) -> jax.Array:
    return watch.values(stepper, t, h, time, moved)[number]


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

    ts: jax.Array  # on the clock of the loop
    xs: Any  # the states by name
    which: jax.Array  # the numbers of the events, -1 beyond the count
    rises: jax.Array
    count: jax.Array


def refined_rows(stepper: Stepper, watch: Watch, crossed: Crossed) -> Crossed:
    """Crossings whose times move as their conditions do with all inputs, from the states where their steps begin."""

    def one(row: Crossed) -> jax.Array:
        meeting = Meeting(row.which >= 0, row.which, row.s, row.t)
        return refined(stepper, watch, row.y, row.h, meeting).s

    s = jax.lax.map(lambda row: one(crossed._replace(**row, count=())), crossed._replace(count=())._asdict())
    return crossed._replace(s=s)


def crossing_rows(stepper: Stepper, crossed: Crossed, ys: Blocks) -> CrossingRows:
    """What users get of crossings, at which the stored states are ys."""
    there = crossed.which >= 0
    ts = jnp.where(there, crossed.t + crossed.s, jnp.nan)
    xs = jax.vmap(stepper.stored.value)(ys)
    xs = {k: jnp.where(there.reshape(there.shape + (1,) * (v.ndim - 1)), v, jnp.nan) for k, v in xs.items()}
    order = jnp.argsort(jax.lax.stop_gradient(ts), stable=True)
    rows = jax.tree.map(lambda a: a[order], (ts, xs, crossed.which, crossed.rises))
    return CrossingRows(*rows, there.sum())
