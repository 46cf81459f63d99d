"""How an integration goes from its start to its end: the steps, where saved times fall in them, and what loops need."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.dynamics import Arrays
from ..lowering.inputs import is_finite
from .charts.coordinates import Blocks
from .events import Watched
from .method import Stepper

__all__ = [
    "Outcome",
    "Part",
    "Run",
    "Saved",
    "Steps",
    "Trail",
    "all_finite",
    "check_saves",
    "put",
    "rows",
    "span_of",
]


class Outcome(NamedTuple):
    """How the steps went: arrays of no dimension.

    Attributes:
        code: the number of the `Result`.
        tried, accepted: steps.
        evaluations: of the right-hand side, without those of saved times.
        t: the time that was reached.
        h: the length of a step there: after a failure of the one that failed, else of the next one to try.
    """

    code: jax.Array
    tried: jax.Array
    accepted: jax.Array
    evaluations: jax.Array
    t: jax.Array
    h: jax.Array


class Trail(NamedTuple):
    """The starts of all steps, and the end.

    Attributes:
        t: (bound + 1,) their times; infinite beyond the end.
        y: the stored states there.
        steps: the number of steps.
    """

    t: jax.Array
    y: Blocks
    steps: jax.Array


class Saved(NamedTuple):
    """What a loop over steps leaves behind for the saved times, all with a leading axis n.

    Attributes:
        steps: the accepted steps before each.
        t, y: time and stored state after that many steps.
        reached: whether the loop came so far.
    """

    steps: jax.Array
    t: jax.Array
    y: Blocks
    reached: jax.Array


class Run(NamedTuple):
    """What a loop over steps leaves behind.

    Attributes:
        end: the stored state it reached.
        outcome: how the steps went.
        saved: for the saved times; None where the end alone is asked for.
        path: what is needed to take the same steps again, where it was asked for.
        trail: the starts of all steps, where they are kept.
        watched: what is known of the conditions, where there are any. A loop halts before the step with an event.
    """

    end: Blocks
    outcome: Outcome
    saved: Saved | None
    path: Any
    trail: Trail | None
    watched: Watched | None = None


class Part(NamedTuple):
    """A step, or a part of one: when it begins, and its length."""

    t: jax.Array
    h: jax.Array


class Steps(ABC):
    """The loop over steps. A pytree: times and tolerances are inputs, rules and bounds are structure.

    Attributes:
        dense: whether the starts of all steps are kept.
        watch: the conditions that end an integration; None where there are none.
    """

    dense: bool
    watch: Any

    @property
    @abstractmethod
    def bound(self) -> int:
        """How many accepted steps there are at most, a plain number, for derivatives and dense output."""

    @abstractmethod
    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Run:
        """Take all steps. Traceable, not differentiable in reverse.

        Args:
            record: keep the path; the bound must be known.
        """

    @abstractmethod
    def steps_of(self, path: Any) -> Part:
        """All steps, (bound,), those beyond the end without meaning; differentiable with respect to the times."""

    @abstractmethod
    def parts(self, path: Any, saved: Saved) -> Part:
        """The parts of steps to all saved times, (n,), of length zero where a step ends; likewise.

        Without a path they are as the loop left them.
        """

    @property
    @abstractmethod
    def saved_times(self) -> jax.Array:
        """(n,) the saved times; differentiable."""

    @abstractmethod
    def too_long(self, h: float) -> tuple[str, str]:
        """Cause and fix of a step of length h whose end is not finite, where nothing else is known."""

    @abstractmethod
    def not_solved(self, h: float) -> tuple[str, str]:
        """Cause and fix of an implicit step of length h whose equations could not be solved."""

    def worst(self, stepper: Stepper, outcome: Outcome, x: Arrays) -> str | None:
        """The state with the largest error in a step from the end; None where errors are not known."""
        return None

    def trail(self, path: Any, steps: jax.Array, every: Blocks) -> Trail:
        """The starts of all steps, from the stored states before each and after the last."""
        known = self.steps_of(path)
        ends = jnp.concatenate([known.t[:1], known.t + known.h])
        return Trail(jnp.where(jnp.arange(ends.size) <= steps, ends, jnp.inf), every, steps)


def span_of(t0: Any, t1: Any, dt: Any) -> tuple[float, float] | None:
    """(t0, t1) as plain numbers, None where they are traced.

    Raises:
        InputError: a time or dt that is no finite number; t1 before t0; dt not positive.
    """
    for name, value in (("t0", t0), ("t1", t1), ("dt", dt)):
        if value is not None and (np.shape(value) != () or not is_finite(value)):
            raise InputError(f"{name} must be a finite number, got {value!r}")
    if dt is not None and not is_traced(dt) and float(dt) <= 0.0:
        raise InputError(f"dt must be positive, got {float(dt):g}")
    if is_traced((t0, t1)):
        return None
    span = (float(t0), float(t1))
    if span[1] < span[0]:
        raise InputError(f"t1 = {span[1]:g} lies before t0 = {span[0]:g}.\n  fix: integrate forward in time")
    return span


def check_saves(save_at: Any, span: tuple[float, float] | None) -> bool:
    """Check saved times as far as they are known; returns whether they are.

    Raises:
        InputError: not a vector of numbers, not sorted, or outside [t0, t1].
    """
    if np.ndim(save_at) != 1 or np.shape(save_at)[0] == 0:
        raise InputError(f"save_at expects times with shape (n,), n >= 1, got shape {np.shape(save_at)}")
    if span is None or is_traced(save_at):
        return False
    times = np.asarray(save_at, float)
    start, end = span
    if not np.isfinite(times).all():
        raise InputError("save_at has times that are not finite")
    if (np.diff(times) < 0).any():
        i = int(np.argmax(np.diff(times) < 0))
        raise InputError(f"save_at must be sorted, got {times[i]:g} before {times[i + 1]:g}")
    room = 1e-6 * (end - start)
    if times[0] < start - room or times[-1] > end + room:
        worst = times[0] if times[0] < start - room else times[-1]
        raise InputError(f"save_at must lie inside [t0, t1] = [{start:g}, {end:g}], got {worst:g}")
    return True


def all_finite(tree: Any) -> jax.Array:
    """Whether every entry of a pytree is finite. Traceable.

    One reduction of all entries: XLA would compute a chain of scalar tests again at every place that reads the result.
    """
    return jnp.isfinite(ravel_pytree(tree)[0]).all()


def rows(like: Any, count: int) -> Any:
    """Zeros with a leading axis in front of every leaf of a pytree."""
    return jax.tree.map(lambda a: jnp.zeros((count, *a.shape), a.dtype), like)


def put(table: Any, row: Any, value: Any) -> Any:
    """The table with one row of every leaf set."""
    return jax.tree.map(lambda a, b: a.at[row].set(jnp.asarray(b, a.dtype)), table, value)
