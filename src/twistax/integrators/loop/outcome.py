"""Result codes of the loop over steps, and of an integration."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..charts.coordinates import Blocks
from ..events.crossings import CrossingTable


class Result(enum.IntEnum):
    """The status of an integration; `sentence` is its description. SUCCESS and EVENT are not failures."""

    SUCCESS = 0
    NON_FINITE = 1
    MAX_STEPS = 2
    STEP_TOO_SMALL = 3
    NEWTON_FAILED = 4
    EVENT = 5
    NO_EVENT = 6
    MAX_CROSSINGS = 7

    @property
    def sentence(self) -> str:
        """A sentence that describes the result."""
        return _SENTENCES[self]

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


_SENTENCES = {
    Result.SUCCESS: "the end time was reached",
    Result.NON_FINITE: "a state became infinite or NaN",
    Result.MAX_STEPS: "the integration reached max_steps before the end time",
    Result.STEP_TOO_SMALL: "no step is small enough for the tolerances",
    Result.NEWTON_FAILED: "the equations of an implicit step could not be solved",
    Result.EVENT: "an event ended the integration",
    Result.NO_EVENT: "a phase ended without its event",
    Result.MAX_CROSSINGS: "there were more than max_crossings crossings",
}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LoopOutcome:
    """Counts and codes of the loop: arrays of shape ()."""

    code: Any  # the number of the `Result`
    tried: Any  # steps
    accepted: Any  # steps
    evaluations: Any  # of the right-hand side, without those of saved times
    t: Any  # the time that was reached
    h: Any  # the length of a step there: after a failure of the one that failed, else of the next one to try


class Trail(NamedTuple):
    """The starts of all steps, and the end."""

    t: jax.Array  # (bound + 1,) their times; infinite beyond the end
    y: Blocks  # the stored states there
    steps: jax.Array  # their number


class Saved(NamedTuple):
    """The states from which saved times are computed, with a leading axis n."""

    steps: jax.Array  # the accepted steps before each
    t: jax.Array  # time and stored state after that many steps
    y: Blocks
    reached: jax.Array  # whether the loop came so far
    requested: jax.Array  # whether it is a time that was asked for; those beyond only fill up the rows


class Halt(NamedTuple):
    """The reason why the loop halts within a step: an event that ends it, or a crossing without room in the table."""

    code: jax.Array  # the number of the `Result`; zero for nothing
    which: jax.Array  # the number of the event
    s: jax.Array  # how far into the step it lies; infinite for nothing

    @classmethod
    def none(cls, t: jax.Array) -> Halt:
        """No halt; t is any time."""
        zero = jnp.zeros((), int)
        return cls(zero, zero - 1, jnp.full_like(t, jnp.inf))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class EventState:
    """The state of the events in the loop over steps."""

    values: Any  # (m,) where the next step begins; the last ones that were not NaN
    met: Any  # (m,) whether each was zero, or past it, at the start
    halt: Any
    y: Any  # the stored state where it halts; within the loop packed
    evaluations: Any  # of the right-hand side, to find roots
    #: Within the loop a `CrossingTable`, after it `Crossed`, where there are events that do not end the integration.
    crossed: Any = None

    def after_loop(self, read: Callable[[jax.Array], Any], steps: jax.Array) -> EventState:
        """The state of the events after the loop, with this number of accepted steps; `read` unpacks a state."""
        table: CrossingTable | None = self.crossed
        crossed = None if table is None else table.rows(read, steps, self.halt.s)
        return dataclasses.replace(self, y=read(self.y), crossed=crossed)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Run:
    """The result of the loop over steps. It halts before the step with an event."""

    end: Any  # the stored state it reached
    outcome: Any
    saved: Any  # None where the end alone is asked for
    path: Any  # what is needed to take the same steps again, where it was asked for
    trail: Any  # where it is kept
    event_state: Any = None  # what is known of the conditions, where there are any


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class StepPart:
    """A step, or a part of one: when it begins, and its length."""

    t: Any
    h: Any
