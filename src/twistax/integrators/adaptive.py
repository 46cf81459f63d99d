"""Steps as long as the tolerances allow."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..lowering.dynamics import Arrays
from ..lowering.scalar.loops import Filling
from ..lowering.small_call import held, small_call
from .charts import Blocks
from .interpolant import Between
from .kernels import kernel_tries
from .meter import Meter
from .method import Carry, Stepper
from .rows import Stops, first_rows, put, rows
from .run import Outcome, Part, Result, Run, Saved, Watched
from .step_control import Errors, StepControl, first_step
from .steps import Steps, all_finite
from .tolerances import Tolerances

#: Steps between words of how far it is, where they are asked for: a word takes as long as some twenty of them.
_TOLD = 256
#: A step that leaves less than this share of itself to the next stop goes there at once.
_STRETCH = 0.01


class _Path(NamedTuple):
    """The accepted steps: on which leg each lies, and where on it, as shares of the leg."""

    leg: jax.Array
    begin: jax.Array
    end: jax.Array


class _Packing(NamedTuple):
    state: Callable[[jax.Array], Blocks]  # reads what is packed
    carry: Callable[[jax.Array], Carry]


class _Step(NamedTuple):
    """A step that was tried, for polynomials. Of one that was taken back the end is its start."""

    end: jax.Array
    begin: jax.Array
    y: jax.Array
    h: jax.Array
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
        stops, read = self.stops, ravel_pytree(y)[1]
        now, found = small_call(lambda steps, stepper, y: steps._all_steps(stepper, y, record), self, stepper, y)
        short = (now.code == Result.SUCCESS.value) & (now.t < stops.limits[-1])
        code = jnp.where(short, Result.MAX_STEPS.value, now.code)
        outcome = Outcome(code, now.tried, now.accepted, now.evaluations, now.t, now.h)
        trail = self.trail(now.path, now.accepted, jax.vmap(read)(now.every)) if self.dense else None
        saved = None
        if stops.place is not None:
            asked = jnp.arange(stops.place.size) < stops.count
            if now.rows is not None:
                # As at the ends of steps: nothing is left to do, and no step was taken up to the start.
                ts, ys = self.saved_times, jax.vmap(read)(now.rows.table)
                saved = Saved((ts > self.t0).astype(int), ts, ys, (ts <= now.t) & asked, asked)
            else:
                (times, starts), index, reached = jax.tree.map(lambda a: a[stops.place], found)
                saved = Saved(index, times, jax.vmap(read)(starts), reached & asked, asked)
        return Run(read(now.y), outcome, saved, now.path, trail, now.watched)

    def _row(self, stepper: Stepper, read: Callable[[jax.Array], Blocks], step: _Step, t: jax.Array) -> jax.Array:
        """The packed state at a time up to the end of a step."""
        share = (t - step.begin) / step.h
        moved = stepper.method.between(stepper.dynamics, read(step.y), step.h, step.slopes, share)
        at_ends = jnp.where(share <= 0.0, step.y, step.y_end)
        return jnp.where((share > 0.0) & (t < step.end), ravel_pytree(moved)[0], at_ends)

    def _all_steps(self, stepper: Stepper, y: Blocks, record: bool) -> tuple[_Now, Any]:
        """The loops over stops and steps: what they carry at the end, and what is found at every stop."""
        stops = self.stops
        beside = stepper.beside_loops
        begun, first = small_call(AdaptiveSteps._begin, self, beside, y)
        now, packing = self._start(self.t0, y, begun, first)
        (read, read_carry), zero = packing, jnp.zeros((), int)
        if record or self.dense:
            now = now._replace(path=rows(_Path(zero, self.t0, self.t0), self.bound))
        if self.dense:
            now = now._replace(every=put(rows(now.y, self.bound + 1), 0, now.y))
        fills = not record and self.finds_rows and stops.place is not None
        if fills:
            ts = self.saved_times
            marks = jnp.where(jnp.arange(ts.size) < stops.count, ts, jnp.inf)
            now = now._replace(rows=Filling(marks, jnp.broadcast_to(now.y, (ts.size, now.y.size)), zero))
        if self.watch is not None:
            advance = functools.partial(self.advance, stepper)
            now = now._replace(watched=self.watch.begin(advance, stepper, self.t0, first, y))

        def to_stop(now: _Now, stop: tuple[jax.Array, jax.Array]) -> tuple[_Now, Any]:
            t, leg = stop
            if stops.limits.size > 1:
                # Rates may have jumped at the limit before; at saved times they do not.
                ahead = jnp.minimum(now.h, stops.limits[leg] - now.t)
                field = beside.field(now.t, ahead)
                resumed = stepper.method.resume(field, now.t, read(now.y), read_carry(now.carry))
                carry = jnp.where(now.t == self._leg(leg)[0], ravel_pytree(resumed)[0], now.carry)
                now = now._replace(carry=carry, evaluations=now.evaluations + stepper.method.resume_evaluations)
            now = self._to(t, leg, stepper, packing, now)
            if fills or stops.place is None:
                return now, None
            # A saved time that is the end of a step needs no other one.
            there = now.t <= t
            start = jax.tree.map(lambda end, before: jnp.where(there, end, before), (now.t, now.y), now.last)
            return now, (start, now.accepted - (~there).astype(int), now.t >= t)

        if fills:
            # Steps pass saved times.
            limits = stops.limits, jnp.arange(stops.limits.size)
            return first_rows(to_stop, now, limits, stops.limits.size, None)
        # Stops beyond these are ends, one of which they include.
        loop = to_stop, now, (stops.ts, stops.leg), stops.limits.size + stops.count
        return first_rows(*loop, None if stops.place is None else (now.last, zero, jnp.asarray(False)))

    @staticmethod
    def _start(t: jax.Array, y: Blocks, begun: Carry, h: jax.Array) -> tuple[_Now, _Packing]:
        """What the loop carries before its first step, of length h."""
        packed, read = ravel_pytree(y)
        carry, read_carry = ravel_pytree(begun)
        zero, number = jnp.zeros((), int), jnp.zeros((), t.dtype)
        now = _Now(
            t=t,
            h=h,
            y=packed,
            carry=carry,
            errors=Errors(number, number),
            rejected=jnp.asarray(False),
            tried=zero,
            accepted=zero,
            evaluations=zero + 2,
            code=zero,
            last=(t, packed),
            path=None,
            every=None,
            watched=None,
            rows=None,
        )
        return now, _Packing(read, read_carry)

    def _begin(self, stepper: Stepper, y: Blocks) -> tuple[Carry, jax.Array]:
        """What the method carries at the start, and the first step to try."""
        room = self.stops.limits[-1] - self.t0
        guess = jnp.where(self.first > 0.0, self.first, 1e-6 * room)
        rate = stepper.rate(self.t0, y, guess)
        chosen = first_step(stepper, self.tolerances, self.t0, y, rate, guess, room)
        begun = stepper.method.begin(stepper.dynamics, y, rate)
        return begun, jnp.where(self.first > 0.0, self.first, chosen)

    def _to(self, t: jax.Array, leg: jax.Array, stepper: Stepper, packing: _Packing, now: _Now) -> _Now:
        """Steps to a stop at t, or beyond it up to the end of the leg."""
        if self.meter is None:
            return self._tries(t, leg, stepper, packing, now, self.bound)

        def so_far(now: _Now) -> tuple[jax.Array, jax.Array, jax.Array]:
            tried = jnp.where((now.t < t) & (now.code == 0), now.tried, self.bound)
            return tried, now.t, (now.t - self.t0) / (self.stops.limits[-1] - self.t0)

        return self.meter.along(
            lambda now, most: self._tries(t, leg, stepper, packing, now, most),
            now,
            jnp.asarray(self.bound),
            jnp.asarray(_TOLD),
            so_far,
        )

    def _tries(self, t: jax.Array, leg: jax.Array, stepper: Stepper, packing: _Packing, now: _Now, bound: Any) -> _Now:
        """The same, until so many were tried."""
        kernel = None
        if now.path is None and now.every is None:
            kernel = self._kernel(t, leg, stepper, packing, now._replace(watched=None, rows=None))

        def by_kernel(kernel: _Kernel, now: _Now, stop: jax.Array) -> _Now:
            after, rows = kernel(now._replace(watched=None, rows=None), now.tried, stop, now.rows)
            return after._replace(rows=rows)

        if kernel is not None and now.watched is None:
            return by_kernel(kernel, now, jnp.where(_going(now, t), bound, now.tried))

        def one_try(now: _Now) -> _Now:
            if kernel is not None:
                after = by_kernel(kernel, now, now.tried + 1)
            else:
                after, step = self._try(stepper, packing, now._replace(watched=None), leg)
                if now.rows is not None and step is not None:
                    row = functools.partial(self._row, stepper, packing.state)
                    after = after._replace(rows=now.rows.up_to(after.t, row, held(step)))
            if now.watched is None:
                return after
            return small_call(lambda *own: own[0]._watched(own[1], packing, *own[2:]), self, stepper, now, after)

        return jax.lax.while_loop(lambda n: _going(n, t) & (n.tried < bound), one_try, now)

    def _kernel(self, t: jax.Array, leg: jax.Array, stepper: Stepper, packing: _Packing, now: _Now) -> _Kernel | None:
        """Tries in a kernel: what is carried, and rows, from the first of them to the last."""
        # Kernels count evaluations in the precision of the state.
        most = self.bound * (stepper.method.evaluations_of(stepper.dynamics) + 1)
        if most >= 2 ** jnp.finfo(self.t0.dtype).nmant:
            return None

        def one_try(given: Any, stepper: Stepper, now: _Now) -> tuple[_Now, jax.Array, _Step | None]:
            steps, t, leg = given
            found, step = steps._try(stepper, packing, now, leg)
            return found, _going(found, t), step if steps.finds_rows else None

        # Neither saved times nor events are part of it: others need no other kernel. What rows are made of is.
        own = self.stops._replace(ts=None, leg=None, place=None, count=None)
        alone = dataclasses.replace(self, stops=own, watch=None, meter=None, dense=False)
        row = functools.partial(self._row, stepper, packing.state)
        return kernel_tries(one_try, row, (alone, t, leg), stepper, now)

    def advance(self, stepper: Stepper, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """A try of unlimited tolerance to the end of a leg of this length."""
        packings: list[_Packing] = []

        def begun(steps: AdaptiveSteps, stepper: Stepper, t: jax.Array, y: Blocks, h: jax.Array) -> Any:
            limits = jnp.full_like(steps.stops.limits, t + h)
            anything = jax.tree.map(lambda a: jnp.full_like(a, jnp.inf), steps.tolerances)
            rate = stepper.rate(t, y, h)
            start = stepper.method.begin(stepper.dynamics, y, rate)
            now, packing = steps._start(t, y, start, jnp.full_like(h, jnp.inf))
            packings.append(packing)
            return limits, anything, now

        def kernel(limits: Any, anything: Any, now: _Now) -> _Kernel | None:
            stops = self.stops._replace(limits=limits)
            steps = dataclasses.replace(self, stops=stops, tolerances=anything, between=Between.STEP)
            return steps._kernel(t, none, stepper, packings[-1], now)

        none, given = jnp.zeros((), int), (self, stepper.beside_loops, t, y, h)
        like = jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), jax.eval_shape(begun, *given))
        if kernel(*like) is None:
            return stepper.advance(t, y, h)
        limits, anything, now = small_call(begun, *given)
        take = kernel(limits, anything, now)
        assert take is not None
        moved, _ = take(now, none, none + 1, None)
        return packings[-1].state(jnp.where(moved.accepted > 0, moved.y, jnp.nan))

    def _watched(self, stepper: Stepper, packing: _Packing, before: _Now, after: _Now) -> _Now:
        """After a try, or as before it with what is known of the event that it met: the loop halts there."""
        assert before.watched is not None
        good, step, end = after.accepted > before.accepted, after.t - before.t, self.stops.limits[-1]
        state, first = packing.state(after.y), before.accepted == 0
        watched = self.watch.after(stepper, before.t, step, state, before.watched, first, after.t == end)
        hit = good & watched.hits.any()
        watched = watched._replace(values=jnp.where(good & ~hit, watched.values, before.watched.values))
        kept = ("t", "y", "carry", "errors", "accepted", "last")
        old = jax.tree.map(
            lambda a, b: jnp.where(hit, a, b), *([getattr(now, name) for name in kept] for now in (before, after))
        )
        return after._replace(
            **dict(zip(kept, old, strict=True)),
            h=jnp.where(hit, step, after.h),
            code=jnp.where(hit, Result.EVENT.value, after.code),
            watched=watched,
        )

    def _try(self, stepper: Stepper, packing: _Packing, now: _Now, leg: jax.Array) -> tuple[_Now, _Step | None]:
        """One step, taken or taken back, and what its polynomial is of, where the method has one."""
        control, order = self.control, stepper.method.error_order
        limit = self.stops.limits[leg]
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
        found = stepper.attempt(now.t, before, packing.carry(now.carry), step, self.tolerances)
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
            start, length = self._leg(leg)
            length = jnp.where(length > 0.0, length, 1.0)
            path = put(path, now.accepted, _Path(leg, (now.t - start) / length, (t - start) / length))

        after = _Now(
            t=pick(t, now.t),
            h=jnp.where(good, longer, jnp.where(failed, step, shorter)),
            y=pick(y, now.y),
            carry=pick(carry, now.carry),
            errors=pick(errors, now.errors),
            rejected=~good,
            tried=now.tried + 1,
            accepted=now.accepted + good.astype(int),
            evaluations=now.evaluations + found.evaluations,
            code=code,
            last=pick((now.t, now.y), now.last),
            # A step that is taken back leaves rows that a later one writes again.
            path=path,
            every=None if now.every is None else put(now.every, now.accepted + 1, y),
            watched=None,
            rows=None,
        )
        return after, None if found.slopes is None else _Step(after.t, now.t, now.y, step, found.slopes, after.y)

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
        return self.stops.ts[self.stops.place]

    def worst(self, stepper: Stepper, outcome: Outcome, x: Arrays) -> str | None:
        y = stepper.coordinates.enter(x)
        carry = stepper.method.begin(stepper.dynamics, y, stepper.rate(outcome.t, y, outcome.h))
        found = stepper.attempt(outcome.t, y, carry, outcome.h, self.tolerances)
        parts = self.tolerances.by_state(stepper.coordinates, found.errors[0], y, found.y)
        return max(parts, key=lambda name: float(parts[name]))

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


def _going(now: _Now, t: jax.Array) -> jax.Array:
    """Whether the loop has not come to a stop, nor halted."""
    return (now.t < t) & (now.code == 0)
