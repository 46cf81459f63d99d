"""Steps as long as the tolerances allow."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..scalar.loops import Filling
from ..scalar.small_call import held, small_call
from ..system.dynamics import Arrays
from .charts import Blocks
from .interpolant import Between
from .kernels import Packed, beside, kernel_tries
from .meter import Meter
from .method import Carry, Stepper
from .rows import Stops, first_rows, put, rows
from .run import Halt, Outcome, Part, Result, Run, Saved, Watched
from .search import Stride, halted_code, watched_along
from .step_control import Errors, StepControl, first_step
from .steps import Steps, all_finite, zeros_like
from .tolerances import Tolerances

#: Steps between words of how far it is, where they are asked for: a word takes as long as some twenty of them.
_TOLD = 256
#: A step that leaves less than this share of itself to the next stop goes there at once.
_STRETCH = 0.01
#: How many limits a kernel looks at: it compares the time with each.
_SEEN = 64


class _Path(NamedTuple):
    """The accepted steps: on which leg each lies, and where on it, as shares of the leg."""

    leg: jax.Array
    begin: jax.Array
    end: jax.Array


class _Packing(NamedTuple):
    state: Callable[[jax.Array], Blocks]  # reads what is packed
    carry: Callable[[jax.Array], Carry]
    slopes: Any  # the same; None where there are none


class _Step(NamedTuple):
    """A step that was tried, for polynomials. Of one that was taken back the end is its start."""

    end: jax.Array
    begin: jax.Array
    y: jax.Array
    h: jax.Array
    in_s: jax.Array  # the same by time: negative where an integration goes backward
    slopes: Any
    y_end: jax.Array


class _Now(NamedTuple):
    """What the loop carries.

    Pytrees are packed into vectors: XLA would compute the test of a step again for every scalar it guards.
    """

    t: jax.Array
    h: jax.Array  # the next step to try; after a failure the one that failed
    y: jax.Array
    carry: jax.Array  # what the method carries
    errors: Errors
    rejected: jax.Array
    tried: jax.Array
    accepted: jax.Array
    evaluations: jax.Array
    code: jax.Array
    last: tuple[jax.Array, jax.Array]  # the start of the last step taken
    path: _Path | None
    every: jax.Array | None
    slopes: jax.Array | None  # those of the last step tried, where conditions are watched and the method has any
    watched: Watched | None
    rows: Filling | None  # those on polynomials


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class AdaptiveSteps(Steps):
    """Steps from t0 through all stops."""

    t0: Any
    first: Any  # the first step to try, in s; zero or less: chosen
    stops: Stops
    tolerances: Tolerances  # the error allowed in a step
    control: StepControl = dataclasses.field(metadata={"static": True})
    dense: bool = dataclasses.field(metadata={"static": True})
    between: Between = dataclasses.field(metadata={"static": True})
    watch: Any = None
    meter: Meter | None = None

    too_long = (
        "however short the step: the solution grows without bound, or a rate stops being finite just after",
        "stop before that time, or guard the expression",
    )
    not_solved = (
        "even in a step of {h:.3g} s: rates jump there, or are not smooth, or their derivatives are not finite",
        "name times of jumps with jumps=..., or smooth the expression",
    )

    @property
    def bound(self) -> int:
        return self.control.max_steps

    @property
    def finds_rows(self) -> bool:  # type: ignore[override]
        return self.between is Between.POLYNOMIAL

    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Run:
        stops, packed = self.stops, Packed.of(y)
        read = packed.read
        now, found = small_call(lambda steps, stepper, y: steps._all_steps(stepper, y, record), self, stepper, packed)
        short = (now.code == Result.SUCCESS.value) & (now.t < stops.limits[-1])
        code = jnp.where(short, Result.MAX_STEPS.value, now.code)
        watched, evaluations = now.watched, now.evaluations
        if watched is not None:
            evaluations = evaluations + watched.evaluations
            watched = watched.after_loop(read, now.accepted)
        outcome = Outcome(code, now.tried, now.accepted, evaluations, now.t, now.h)
        trail = self.trail(now.path, now.accepted, jax.vmap(read)(now.every)) if self.dense else None
        saved = None
        if stops.ts is not None:
            asked = jnp.arange(stops.ts.size) < stops.count
            if now.rows is not None:
                # As at the ends of steps: nothing is left to do, and no step was taken up to the start.
                ts, ys = jnp.asarray(stops.ts), jax.vmap(read)(now.rows.table)
                saved = Saved((ts > self.t0).astype(int), ts, ys, (ts <= now.t) & asked, asked)
            else:
                (times, starts), index, reached = jax.tree.map(lambda a: a[:-1], found)
                saved = Saved(index, times, jax.vmap(read)(starts), reached & asked, asked)
        return Run(Packed(now.y, read), outcome, saved, now.path, trail, watched)

    def _row(self, stepper: Stepper, read: Callable[[jax.Array], Blocks], step: _Step, t: jax.Array) -> jax.Array:
        """The packed state at a time up to the end of a step.

        It reads no arrays of the stepper: they may be traced, and rows are made of what a step left alone.
        """
        share = (t - step.begin) / step.h
        moved = stepper.method.between(stepper.dynamics, read(step.y), step.in_s, step.slopes, share)
        at_ends = jnp.where(share <= 0.0, step.y, step.y_end)
        return jnp.where((share > 0.0) & (t < step.end), ravel_pytree(moved)[0], at_ends)

    def _all_steps(self, stepper: Stepper, y: Packed, record: bool) -> tuple[_Now, Any]:
        """The loops over stops and steps: what they carry at the end, and what is found at stops."""
        stops = self.stops
        bare = dataclasses.replace(self._bare(stops.limits), between=Between.STEP)
        begun, first = beside(AdaptiveSteps._begin, bare, stepper, y)
        now, packing = self._start(stepper, self.t0, y, begun, first)
        zero, end = jnp.zeros((), int), jnp.asarray(stops.limits[-1])
        if record or self.dense:
            now = now._replace(path=rows(_Path(zero, self.t0, self.t0), self.bound))
        if self.dense:
            now = now._replace(every=put(rows(now.y, self.bound + 1), 0, now.y))
        if not record and self.finds_rows and stops.ts is not None:
            ts = jnp.asarray(stops.ts)
            now = now._replace(rows=Filling(ts, jnp.broadcast_to(now.y, (ts.size, now.y.size)), zero))
        if self.watch is not None:
            advance = functools.partial(self._advance, stepper, packing, now)
            watched = self.watch.begin(advance, stepper, self.t0, first, y)
            now = now._replace(watched=watched, code=halted_code(watched.halt, now.code))

        if now.rows is not None or stops.ts is None:
            return self._to(end, stepper, packing, now), None

        def to_stop(now: _Now, t: jax.Array) -> tuple[_Now, Any]:
            now = self._to(t, stepper, packing, now)
            # A saved time that is the end of a step needs no other one.
            there = now.t <= t
            start = jax.tree.map(lambda end, before: jnp.where(there, end, before), (now.t, now.y), now.last)
            return now, (start, now.accepted - (~there).astype(int), now.t >= t)

        # The times that fill up the rows are ends, so that the stop after those that were asked for is one.
        like = now.last, zero, jnp.asarray(False)
        return first_rows(to_stop, now, jnp.append(stops.ts, end), stops.count + 1, like)

    def _start(self, stepper: Stepper, t: jax.Array, y: Packed, carry: Packed, h: jax.Array) -> tuple[_Now, _Packing]:
        """What the loop carries before its first step, of length h."""
        zero, number = jnp.zeros((), int), jnp.zeros((), t.dtype)
        slopes, read = None, None
        if self.watch is not None:
            room = zeros_like(lambda: stepper.attempt(t, y.open(), carry.open(), h, self.tolerances).slopes)
            slopes, read = (None, None) if room is None else ravel_pytree(room)
        now = _Now(
            t=t,
            h=h,
            y=y.flat,
            carry=carry.flat,
            errors=Errors(number, number),
            rejected=jnp.asarray(False),
            tried=zero,
            accepted=zero,
            evaluations=zero + 2,
            code=zero,
            last=(t, y.flat),
            path=None,
            every=None,
            slopes=slopes,
            watched=None,
            rows=None,
        )
        return now, _Packing(y.read, carry.read, read)

    def _begin(self, stepper: Stepper, packed: Packed) -> tuple[Packed, jax.Array]:
        """What the method carries at the start, and the first step to try."""
        y = packed.open()
        room = self.stops.limits[-1] - self.t0
        guess = jnp.where(self.first > 0.0, self.first, 1e-6 * room)
        rate = stepper.rate(self.t0, y, jnp.minimum(guess, self._limit(self.t0) - self.t0))
        chosen = first_step(stepper, self.tolerances, self.t0, y, rate, guess, room)
        begun = stepper.method.begin(stepper.dynamics, y, rate)
        return Packed.of(begun), jnp.where(self.first > 0.0, self.first, chosen)

    def _to(self, t: jax.Array, stepper: Stepper, packing: _Packing, now: _Now) -> _Now:
        """Steps to a stop at t, or beyond it up to the next limit."""
        if self.meter is None:
            return self._tries(t, stepper, packing, now, self.bound)

        def so_far(now: _Now) -> tuple[jax.Array, jax.Array, jax.Array]:
            tried = jnp.where((now.t < t) & (now.code == 0), now.tried, self.bound)
            return tried, stepper.clock(now.t), (now.t - self.t0) / (self.stops.limits[-1] - self.t0)

        return self.meter.along(
            lambda now, most: self._tries(t, stepper, packing, now, most),
            now,
            jnp.asarray(self.bound),
            jnp.asarray(_TOLD),
            so_far,
        )

    def _tries(self, t: jax.Array, stepper: Stepper, packing: _Packing, now: _Now, bound: Any) -> _Now:
        """The same, until so many were tried."""

        def going(now: _Now) -> jax.Array:
            return _going(now, t) & (now.tried < bound)

        def kernel(now: _Now) -> _Kernel | None:
            if now.path is not None or now.every is not None:
                return None
            return self._kernel(t, stepper, packing, now._replace(watched=None, rows=None))

        def by_kernel(kernel: _Kernel, now: _Now, stop: Any) -> _Now:
            after, rows = kernel(now._replace(watched=None, rows=None), now.tried, stop, now.rows)
            return after._replace(rows=rows)

        first, watched = kernel(now), now.watched is not None
        if first is not None and not watched and self.stops.limits.size <= _SEEN:
            return by_kernel(first, now, jnp.where(going(now), bound, now.tried))

        def one_round(now: _Now) -> _Now:
            if (own := kernel(now)) is not None:
                after = by_kernel(own, now, now.tried + 1 if watched else bound)
            else:
                after, step = self._try(stepper, packing, now._replace(watched=None))
                if now.rows is not None and step is not None:
                    row = functools.partial(self._row, stepper, packing.state)
                    after = after._replace(rows=now.rows.up_to(after.t, row, held(step)))
            if not watched:
                return after
            return self._watched(stepper, packing, now, after)

        return jax.lax.while_loop(going, one_round, now)

    def _kernel(self, t: jax.Array, stepper: Stepper, packing: _Packing, now: _Now) -> _Kernel | None:
        """Tries in a kernel: what is carried, and rows, from the first of them to the last."""
        # Kernels count evaluations in the precision of the state.
        most = self.bound * (stepper.method.evaluations_of(stepper.dynamics) + 1)
        if most >= 2 ** jnp.finfo(self.t0.dtype).nmant:
            return None
        limits = self.stops.limits
        if limits.size > _SEEN:
            limits = jax.lax.dynamic_slice_in_dim(limits, jnp.searchsorted(limits, now.t), _SEEN)
            t = jnp.minimum(t, limits[-1])

        def one_try(given: Any, stepper: Stepper, now: _Now) -> tuple[_Now, jax.Array, _Step | None]:
            steps, t = given
            found, step = steps._try(stepper, packing, now)
            return found, _going(found, t), step if steps.finds_rows else None

        row = functools.partial(self._row, stepper, packing.state)
        return kernel_tries(one_try, row, (self._bare(limits), t), stepper, now, lambda now: now._replace(slopes=None))

    def _bare(self, limits: Any) -> AdaptiveSteps:
        """The same with these limits, without saved times and events: others need no other kernel."""
        return dataclasses.replace(self, stops=Stops(limits, None, None), watch=None, meter=None, dense=False)

    def _advance(self, stepper: Stepper, packing: _Packing, now: _Now, h: jax.Array) -> Packed:
        """The packed state after one more step: a try of unlimited tolerance, as if its end were the next limit."""
        stops = self.stops._replace(limits=jnp.where(self.stops.limits > now.t, now.t + h, self.stops.limits))
        tolerances = jax.tree.map(lambda a: jnp.full_like(a, jnp.inf), self.tolerances)
        now = now._replace(h=jnp.full_like(now.h, jnp.inf), path=None, every=None, watched=None, rows=None)
        kernel = dataclasses.replace(self, stops=stops, tolerances=tolerances)._kernel(now.t, stepper, packing, now)
        if kernel is None:
            return Packed.of(stepper.advance(now.t, packing.state(now.y), h))
        moved, _ = kernel(now, now.tried, now.tried + 1, None)
        return Packed(jnp.where(moved.accepted > now.accepted, moved.y, jnp.nan), packing.state)

    def _watched(self, stepper: Stepper, packing: _Packing, before: _Now, after: _Now) -> _Now:
        """After a try, or as before it where it meets an event that ends the integration: the loop halts there."""
        assert before.watched is not None
        good, step = after.accepted > before.accepted, after.t - before.t
        y, end = Packed(before.y, packing.state), Packed(after.y, packing.state)
        slopes = None if after.slopes is None else Packed(after.slopes, packing.slopes)
        advance = functools.partial(self._advance, stepper, packing, before)
        stride = Stride(before.accepted, before.t, step, y, end, slopes)
        ends = before.accepted == 0, after.t == self.stops.limits[-1]
        watched = watched_along(self.watch, advance, stepper, stride, before.watched, good, ends)
        states = [now._replace(watched=None, rows=None, path=None, every=None) for now in (before, after)]
        settled = beside(_settled, None, stepper, *states, watched.halt, step)
        return settled._replace(watched=watched, rows=after.rows, path=after.path, every=after.every)

    def _try(self, stepper: Stepper, packing: _Packing, now: _Now) -> tuple[_Now, _Step | None]:
        """One step, taken or taken back, and what its polynomial is of, where the method has one."""
        control, order = self.control, stepper.method.error_order
        limits = self.stops.limits
        limit = self._limit(now.t)
        room = limit - now.t
        eps = float(jnp.finfo(now.t.dtype).eps)
        least = jnp.maximum(8.0 * eps * jnp.abs(now.t), control.dtmin or 0.0)
        h = jnp.maximum(now.h, least)
        if control.dtmax is not None:
            h = jnp.minimum(h, control.dtmax)
        # No crumbs before a limit: the last two steps share what is left.
        step = jnp.where((1.0 + _STRETCH) * h >= room, room, jnp.where(2.0 * h > room, 0.5 * room, h))
        cut = step < h
        # As far as the clock moves: rounding of large times would add up.
        t = jnp.where(step == room, limit, now.t + step)
        step = t - now.t
        before = packing.state(now.y)
        resumed, evaluations = now.carry, now.evaluations
        if limits.size > 1:
            # Rates may have jumped where a step ended at a limit; at saved times they do not.
            at_limit = (limits == now.t).any() & ~now.rejected
            stored = packing.carry(now.carry)
            resumed = jax.lax.cond(
                at_limit,
                lambda: ravel_pytree(stepper.resume(now.t, before, stored, step))[0],
                lambda: now.carry,
            )
            evaluations = evaluations + jnp.where(at_limit, stepper.method.resume_evaluations, 0)
        found = stepper.attempt(now.t, before, packing.carry(resumed), step, self.tolerances)
        y, carry = ravel_pytree(found.y)[0], ravel_pytree(found.carry)[0]
        finite = all_finite((y, carry))
        square = self._error(stepper, before, found.y, found.errors)
        usable = finite if found.solved is None else finite & found.solved
        square = jnp.where(usable & jnp.isfinite(square), square, jnp.inf)
        good = square <= 1.0
        growth, errors = control.grown(square, now.errors, now.rejected, order)
        # A step cut short at a limit says little against the longer one that was planned.
        longer = jnp.maximum(step * growth, jnp.where(cut, jnp.where(now.rejected, 0.0, h), 0.0))
        shorter = step * control.shrunk(square, order)
        trouble = jnp.where(finite, Result.STEP_TOO_SMALL.value, Result.NON_FINITE.value)
        if found.solved is not None:
            shorter = jnp.where(found.solved, shorter, 0.5 * step)
            trouble = jnp.where(found.solved, trouble, Result.NEWTON_FAILED.value)
        failed = ~good & ((shorter < least) | (step <= least))
        code = jnp.where(failed, trouble, now.code)

        def pick(new: Any, old: Any) -> Any:
            return jax.tree.map(lambda a, b: jnp.where(good, a, b), new, old)

        path = now.path
        if path is not None:
            leg = jnp.minimum((limits <= now.t).sum(), limits.size - 1)
            start, length = self._leg(leg)
            length = jnp.where(length > 0.0, length, 1.0)
            path = put(path, now.accepted, _Path(leg, (now.t - start) / length, (t - start) / length))

        after = _Now(
            t=pick(t, now.t),
            h=jnp.where(good, longer, jnp.where(failed, step, shorter)),
            y=pick(y, now.y),
            carry=pick(carry, resumed),
            errors=pick(errors, now.errors),
            rejected=~good,
            tried=now.tried + 1,
            accepted=now.accepted + good.astype(int),
            evaluations=evaluations + found.evaluations,
            code=code,
            last=pick((now.t, now.y), now.last),
            # A step that is taken back leaves rows that a later one writes again.
            path=path,
            every=None if now.every is None else put(now.every, now.accepted + 1, y),
            slopes=None if now.slopes is None else ravel_pytree(found.slopes)[0],
            watched=None,
            rows=None,
        )
        if found.slopes is None:
            return after, None
        return after, _Step(after.t, now.t, now.y, step, stepper.clock(step), found.slopes, after.y)

    def _error(self, stepper: Stepper, before: Blocks, after: Blocks, errors: tuple[Blocks, ...]) -> jax.Array:
        """The square of the error in units of what is allowed; two estimates are weighed as in the program DOP853."""
        local, tolerances = stepper.coordinates, self.tolerances
        squares = [tolerances.mean_square(local, e, before, after) for e in errors]
        if len(squares) == 1:
            return squares[0]
        first, second = squares
        weight = first + 0.01 * second
        return jnp.where(weight > 0.0, first * first / jnp.where(weight > 0.0, weight, 1.0), 0.0)

    @property
    def saved_times(self) -> jax.Array:
        return jnp.asarray(self.stops.ts)

    def errors_by_state(self, stepper: Stepper, t: jax.Array, h: jax.Array, x: Arrays) -> dict[str, jax.Array]:
        y = stepper.coordinates.enter(x)
        carry = stepper.method.begin(stepper.dynamics, y, stepper.rate(t, y, h))
        found = stepper.attempt(t, y, carry, h, self.tolerances)
        return self.tolerances.by_state(stepper.coordinates, found.errors[0], y, found.y)

    def _limit(self, t: jax.Array) -> jax.Array:
        """The next limit after a time."""
        limits = self.stops.limits
        return jnp.where(limits > t, limits, limits[-1]).min()

    def _leg(self, leg: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Start and length of a leg."""
        limits = self.stops.limits
        start = jnp.where(leg == 0, self.t0, limits[jnp.maximum(leg - 1, 0)])
        return start, limits[leg] - start

    def steps_of(self, path: _Path) -> Part:
        start, length = self._leg(path.leg)
        return Part(start + path.begin * length, (path.end - path.begin) * length)

    def parts(self, path: _Path | None, saved: Saved) -> Part:
        ts = self.saved_times
        if path is None:
            return Part(saved.t, ts - saved.t)
        k = jnp.maximum(saved.steps - 1, 0)
        start, length = self._leg(path.leg[k])
        before = jnp.where(saved.steps == 0, self.t0, start + path.end[k] * length)
        return Part(before, ts - before)


#: From what is carried, the first try, the stop, and rows, to what is carried and rows.
_Kernel: TypeAlias = Callable[[_Now, jax.Array, jax.Array, Filling | None], tuple[_Now, Filling | None]]


def _settled(_: None, __: Stepper, before: _Now, after: _Now, halt: Halt, step: jax.Array) -> _Now:
    """After a try, or before it where it halts."""
    code = halted_code(halt, after.code)
    hit = code != after.code
    kept = ("t", "y", "carry", "errors", "accepted", "last")
    old = jax.tree.map(
        lambda a, b: jnp.where(hit, a, b), *([getattr(now, name) for name in kept] for now in (before, after))
    )
    return after._replace(**dict(zip(kept, old, strict=True)), h=jnp.where(hit, step, after.h), code=code)


def _going(now: _Now, t: jax.Array) -> jax.Array:
    """Whether the loop has not come to a stop, nor halted."""
    return (now.t < t) & (now.code == 0)
