"""How a flight goes from its start to its end: the steps it takes, and where saved times fall between them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax

from ..lowering.dynamics import Arrays
from .charts.whole import Blocks
from .stepper import Stepper

__all__ = ["Course", "Flown", "Outcome", "Part"]


class Outcome(NamedTuple):
    """How the steps went: arrays of no dimension.

    Attributes:
        code: the number of the `Result`.
        tried, accepted: steps.
        evaluations: of the right-hand side, without those of saved times.
        t: the time that was reached.
        h: the length of the last step tried.
    """

    code: jax.Array
    tried: jax.Array
    accepted: jax.Array
    evaluations: jax.Array
    t: jax.Array
    h: jax.Array


class Flown(NamedTuple):
    """What a loop over steps leaves behind.

    Attributes:
        end: the stored state it reached.
        outcome: how the steps went.
        index: (n,) accepted steps before each saved time; None without saved times, as the next three.
        starts: the stored states after that many steps.
        times: (n,) the times then.
        reached: (n,) whether the flight came so far.
        path: what a course needs to take the same steps again, where it was asked for.
    """

    end: Blocks
    outcome: Outcome
    index: jax.Array | None
    starts: Blocks | None
    times: jax.Array | None
    reached: jax.Array | None
    path: Any


class Part(NamedTuple):
    """A step, or a part of one: when it begins, and its length."""

    t: jax.Array
    h: jax.Array


class Course(ABC):
    """A pytree: times and tolerances are inputs, rules and bounds are structure."""

    @property
    @abstractmethod
    def bound(self) -> int | None:
        """How many accepted steps there are at most, a plain number; None where derivatives are not asked for."""

    @property
    @abstractmethod
    def saves(self) -> int | None:
        """The number of saved times; None where the end alone is asked for."""

    @abstractmethod
    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Flown:
        """Take all steps. Traceable, not differentiable in reverse.

        Args:
            record: keep the path; `bound` must be known.
        """

    @abstractmethod
    def steps_of(self, path: Any) -> Part:
        """All steps, (bound,), those beyond the end without meaning; differentiable with respect to the times."""

    @abstractmethod
    def parts(self, path: Any, flown: Flown) -> Part:
        """The parts of steps to all saved times, (n,), of length zero where a step ends; likewise.

        Without a path they are as the loop left them.
        """

    def worst(self, stepper: Stepper, outcome: Outcome, x: Arrays) -> str | None:
        """The state with the largest error in a step from where the flight ended; None where errors are not known."""
        return None
