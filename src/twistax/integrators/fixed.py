"""A flight with equal steps."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..errors import InputError
from ..lowering.small_call import small_call
from .charts.whole import Blocks
from .course import Course, Flown, Outcome, Part, Saved
from .events import Watch, Watched
from .finite import all_finite
from .grid import Grid, Saves
from .kernel_steps import KernelSteps, kernel_steps
from .method import Carry
from .result import Result
from .rows import put, rows
from .stepper import Stepper

__all__ = ["FixedCourse"]


class _Now(NamedTuple):
    """What the loop carries: steps taken, the stored state, what the method carries, evaluations, the number of the
    result so far, the states so far if kept, and the conditions if there are any.
    """

    steps: jax.Array
    y: Blocks
    carry: Carry
    evaluations: jax.Array
    code: jax.Array
    every: Blocks | None
    watched: Watched | None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FixedCourse(Course):
    """Equal steps from t0 to t1; a flight ends at the start of a step that fails.

    Attributes:
        t0, h: start and length of a step.
        steps: their number.
        at: where the saved times fall; None where there are none.
        most: their number as structure, which derivatives and dense output need; else None.
        dense: whether the starts of all steps are kept.
        watch: the conditions that end the flight.
    """

    t0: Any
    h: Any
    steps: Any
    at: Saves | None
    most: int | None = dataclasses.field(metadata={"static": True})
    dense: bool = dataclasses.field(metadata={"static": True})
    watch: Any = None

    @property
    def bound(self) -> int:
        if self.most is None:
            raise InputError(
                "a derivative is asked for of a flight whose inputs look like plain numbers: does u close over a "
                "traced value that it does not use at t0?\n  fix: pass that value through params or a table"
            )
        return self.most

    @classmethod
    def of(cls, grid: Grid, at: Saves | None, bounded: bool, dense: bool, watch: Watch | None) -> FixedCourse:
        """The course over a grid; `bounded` where the number of steps is to be structure too."""
        return cls(grid.t0, grid.h, jnp.asarray(grid.steps), at, grid.steps if bounded else None, dense, watch)

    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Flown:
        stops = self.steps[None]
        if self.at is not None:
            stops = jnp.concatenate([self.at.index.astype(stops.dtype), stops])
        now, found = small_call(FixedCourse._all_steps, self, stepper, y, stops)
        outcome = Outcome(now.code, now.steps, now.steps, now.evaluations, self._time(now.steps), self.h)
        trail = None if now.every is None else self.trail(None, now.steps, now.every)
        saved = None
        if self.at is not None:
            starts, reached = jax.tree.map(lambda a: a[:-1], found)
            saved = Saved(self.at.index, self._time(self.at.index), starts, reached)
        return Flown(now.y, outcome, saved, None, trail, now.watched)

    def _all_steps(self, stepper: Stepper, y: Blocks, stops: jax.Array) -> tuple[_Now, Any]:
        """The loops over stops and steps: what they carry at the end, and what is found at every stop."""

        def advance(now: _Now) -> _Now:
            found = stepper.follow(self._time(now.steps), now.y, now.carry, self.h)
            good = all_finite(found.y)
            code = jnp.where(good, Result.SUCCESS.value, Result.NON_FINITE.value)
            if found.solved is not None:
                good = good & found.solved
                code = jnp.where(found.solved, code, Result.NEWTON_FAILED.value)
            watched = None
            if now.watched is not None:
                t = self._time(now.steps)
                first, last = now.steps == 0, now.steps + 1 == self.steps
                watched = self.watch.after(stepper, t, self.h, found.y, now.watched, first, last)
                hit = good & watched.hits.any()
                watched = watched._replace(values=jnp.where(hit, now.watched.values, watched.values))
                code, good = jnp.where(hit, Result.EVENT.value, code), good & ~hit
            kept = jax.tree.map(lambda new, old: jnp.where(good, new, old), found.y, now.y)
            steps = now.steps + good.astype(now.steps.dtype)
            every = None if now.every is None else put(now.every, steps, kept)
            return _Now(steps, kept, found.carry, now.evaluations + found.evaluations, code, every, watched)

        def to_stop(now: _Now, stop: jax.Array) -> tuple[_Now, tuple[Blocks, jax.Array] | None]:
            if kernel is None:
                now = jax.lax.while_loop(lambda n: (n.steps < stop) & (n.code == Result.SUCCESS.value), advance, now)
            else:
                now = self._by_kernel(kernel, stepper, now, stop)
            return now, None if self.at is None else (now.y, now.code == Result.SUCCESS.value)

        every = put(rows(y, self.bound + 1), 0, y) if self.dense else None
        none, carry = jnp.zeros((), stops.dtype), stepper.method.before(stepper.dynamics, y)
        watched = None if self.watch is None else self.watch.begin(stepper, self.t0, self.h, y)
        now = _Now(none, y, carry, none, jnp.zeros((), int), every, watched)
        kernel = None
        if every is None and watched is None:
            kernel = kernel_steps(stepper, self.t0, self.h, none, y, carry)
        return jax.lax.scan(to_stop, now, stops)

    def _by_kernel(self, kernel: KernelSteps, stepper: Stepper, now: _Now, stop: jax.Array) -> _Now:
        """All steps up to a stop at once; a flight that halted already stays as it is."""
        stop = jnp.where(now.code == Result.SUCCESS.value, stop, now.steps)
        y, carry, steps = kernel.run(stepper, self.t0, self.h, now.steps, stop, now.y, now.carry)
        halted = steps < stop
        tried = steps - now.steps + halted.astype(steps.dtype)
        code = jnp.where(halted, Result.NON_FINITE.value, now.code)
        return now._replace(
            steps=steps, y=y, carry=carry, evaluations=now.evaluations + tried * kernel.evaluations, code=code
        )

    def steps_of(self, path: None) -> Part:
        k = jnp.arange(self.bound)
        return Part(self._time(k), jnp.broadcast_to(self.h, k.shape))

    def parts(self, path: None, saved: Saved) -> Part:
        assert self.at is not None  # else there would be nothing saved
        return Part(self._time(saved.steps), self.at.share * self.h)

    @property
    def saved_times(self) -> jax.Array:
        assert self.at is not None  # else there would be nothing saved
        return self.at.ts

    def _time(self, k: jax.Array) -> jax.Array:
        """The start of step k, computed afresh so that it does not drift."""
        return self.t0 + k.astype(self.t0.dtype) * self.h

    def too_long(self, h: float) -> tuple[str, str]:
        cause = f"the step {h:.6g} s is too long for rates this fast, or the solution itself grows without bound"
        return cause, "try a smaller dt"

    def not_solved(self, h: float) -> tuple[str, str]:
        cause = f"rates change too much within the step of {h:.6g} s for Newton's method, or they jump"
        return cause, "try a smaller dt, or steps chosen by tolerances: rtol=..., atol=..."
