"""How a flight goes from its start to its end: the steps it takes, and where saved times fall between them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..lowering.dynamics import Arrays
from .charts.whole import Blocks
from .events import Watched
from .stepper import Stepper

__all__ = ["Course", "Flown", "Outcome", "Part", "Saved", "Trail"]


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
        reached: whether the flight came so far.
    """

    steps: jax.Array
    t: jax.Array
    y: Blocks
    reached: jax.Array


class Flown(NamedTuple):
    """What a loop over steps leaves behind.

    Attributes:
        end: the stored state it reached.
        outcome: how the steps went.
        saved: for the saved times; None where the end alone is asked for.
        path: what a course needs to take the same steps again, where it was asked for.
        trail: the starts of all steps, where a course keeps them.
        watched: what is known of the conditions, where there are any. A course halts before the step with an event.
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


class Course(ABC):
    """A pytree: times and tolerances are inputs, rules and bounds are structure.

    Attributes:
        dense: whether the starts of all steps are kept.
        watch: the conditions that end a flight; None where there are none.
    """

    dense: bool
    watch: Any

    @property
    @abstractmethod
    def bound(self) -> int:
        """How many accepted steps there are at most, a plain number, for derivatives and dense output."""

    @abstractmethod
    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Flown:
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
        """The state with the largest error in a step from where the flight ended; None where errors are not known."""
        return None

    def trail(self, path: Any, steps: jax.Array, every: Blocks) -> Trail:
        """The starts of all steps, from the stored states before each and after the last."""
        known = self.steps_of(path)
        ends = jnp.concatenate([known.t[:1], known.t + known.h])
        return Trail(jnp.where(jnp.arange(ends.size) <= steps, ends, jnp.inf), every, steps)
