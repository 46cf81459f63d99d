"""A flight with equal steps."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .charts.whole import Blocks
from .course import Course, Flown, Outcome, Part
from .finite import all_finite
from .grid import Grid, Saves
from .solution import Result
from .stepper import Stepper

__all__ = ["FixedCourse"]


class _Now(NamedTuple):
    """What the loop carries: steps taken, the stored state, and whether all went well."""

    steps: jax.Array
    y: Blocks
    good: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FixedCourse(Course):
    """Equal steps from t0 to t1; a flight ends at the start of a step that fails.

    Attributes:
        t0, h: start and length of a step.
        steps: their number.
        at: where the saved times fall; None where there are none.
        most: their number as structure, which derivatives need; else None.
    """

    t0: Any
    h: Any
    steps: Any
    at: Saves | None
    most: int | None = dataclasses.field(metadata={"static": True})

    @property
    def bound(self) -> int | None:
        return self.most

    @classmethod
    def of(cls, grid: Grid, at: Saves | None, bounded: bool) -> FixedCourse:
        """The course over a grid; `bounded` where the number of steps is to be structure too."""
        return cls(grid.t0, grid.h, jnp.asarray(grid.steps), at, grid.steps if bounded else None)

    @property
    def saves(self) -> int | None:
        return None if self.at is None else self.at.index.size

    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Flown:
        def advance(now: _Now) -> _Now:
            moved = stepper.advance(self._time(now.steps), now.y, self.h)
            good = all_finite(moved)
            kept = jax.tree.map(lambda new, old: jnp.where(good, new, old), moved, now.y)
            return _Now(now.steps + good.astype(now.steps.dtype), kept, good)

        def to_stop(now: _Now, stop: jax.Array) -> tuple[_Now, tuple[Blocks, jax.Array] | None]:
            now = jax.lax.while_loop(lambda n: (n.steps < stop) & n.good, advance, now)
            return now, None if self.at is None else (now.y, now.good)

        stops = self.steps[None]
        if self.at is not None:
            stops = jnp.concatenate([self.at.index.astype(stops.dtype), stops])
        now = _Now(jnp.zeros((), stops.dtype), y, jnp.asarray(True))
        now, found = jax.lax.scan(to_stop, now, stops)
        code = jnp.where(now.good, Result.DONE.value, Result.NON_FINITE.value)
        tries = now.steps + (~now.good).astype(now.steps.dtype)
        evaluations = tries * stepper.method.evaluations_of(stepper.dynamics)
        outcome = Outcome(code, tries, now.steps, evaluations, self._time(now.steps), self.h)
        if self.at is None:
            return Flown(now.y, outcome, None, None, None, None, None)
        starts, reached = jax.tree.map(lambda a: a[:-1], found)
        return Flown(now.y, outcome, self.at.index, starts, self._time(self.at.index), reached, None)

    def steps_of(self, path: None) -> Part:
        k = jnp.arange(self.bound)
        return Part(self._time(k), jnp.broadcast_to(self.h, k.shape))

    def parts(self, path: None, flown: Flown) -> Part:
        return Part(self._time(self.at.index), self.at.share * self.h)

    def _time(self, k: jax.Array) -> jax.Array:
        """The start of step k, computed afresh so that it does not drift."""
        return self.t0 + k.astype(self.t0.dtype) * self.h
