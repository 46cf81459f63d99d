"""What every loop over steps leaves behind, how an integration ends, and what times may be given."""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import number, real_array, short
from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.dynamics import Arrays
from .charts import Blocks
from .meter import Meter
from .method import Stepper


class Result(enum.IntEnum):
    """How an integration ended; `sentence` says it in words. SUCCESS and EVENT are no failures."""

    SUCCESS = 0, "the end time was reached"
    NON_FINITE = 1, "a state became infinite or NaN"
    MAX_STEPS = 2, "the steps ran out before the end time"
    STEP_TOO_SMALL = 3, "no step is small enough for the tolerances"
    NEWTON_FAILED = 4, "the equations of an implicit step could not be solved"
    EVENT = 5, "an event stopped it"
    NO_EVENT = 6, "a phase ended without its event"

    #: What happened, in plain words.
    sentence: str

    def __new__(cls, code: int, sentence: str = "") -> Result:
        found = int.__new__(cls, code)
        found._value_, found.sentence = code, sentence
        return found

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


def ended_well(code: Any) -> Any:
    """Whether numbers of a `Result` are no failures."""
    return (code == Result.SUCCESS.value) | (code == Result.EVENT.value)


class Outcome(NamedTuple):
    """How the steps went: arrays of no dimension."""

    code: jax.Array  # the number of the `Result`
    tried: jax.Array  # steps
    accepted: jax.Array  # steps
    evaluations: jax.Array  # of the right-hand side, without those of saved times
    t: jax.Array  # the time that was reached
    h: jax.Array  # the length of a step there: after a failure of the one that failed, else of the next one to try


class Trail(NamedTuple):
    """The starts of all steps, and the end."""

    t: jax.Array  # (bound + 1,) their times; infinite beyond the end
    y: Blocks  # the stored states there
    steps: jax.Array  # their number


class Saved(NamedTuple):
    """What a loop over steps leaves behind for the saved times, all with a leading axis n."""

    steps: jax.Array  # the accepted steps before each
    t: jax.Array  # time and stored state after that many steps
    y: Blocks
    reached: jax.Array  # whether the loop came so far
    asked: jax.Array  # whether it is a time that was asked for; those beyond only fill up the rows


class Watched(NamedTuple):
    """What a loop over steps knows of the conditions."""

    values: jax.Array  # (m,) where the step begins; the last ones that were not NaN
    hits: jax.Array  # (m,) whether each became zero in the last step tried
    ends: jax.Array  # (m,) the values where that step ends


class Run(NamedTuple):
    """What a loop over steps leaves behind. It halts before the step with an event."""

    end: Blocks  # the stored state it reached
    outcome: Outcome
    saved: Saved | None  # None where the end alone is asked for
    path: Any  # what is needed to take the same steps again, where it was asked for
    trail: Trail | None  # where it is kept
    watched: Watched | None = None  # what is known of the conditions, where there are any


class Part(NamedTuple):
    """A step, or a part of one: when it begins, and its length."""

    t: jax.Array
    h: jax.Array


class Steps(ABC):
    """The loop over steps. A pytree: times and tolerances are inputs, rules and bounds are structure."""

    dense: bool  # whether the starts of all steps are kept
    watch: Any  # the `Watch`, the conditions that end an integration
    meter: Meter | None  # who is told how far it is
    #: Whether `run` leaves the states at saved times behind, not those before them, up to an event.
    finds_rows: bool = False
    #: Cause and fix, with the length h of the step: of an end that is not finite, where nothing else is known; of the
    #: equations of an implicit step that could not be solved.
    too_long: tuple[str, str]
    not_solved: tuple[str, str]

    @property
    @abstractmethod
    def bound(self) -> int:
        """How many accepted steps there are at most, a plain number, for derivatives and dense output."""

    @abstractmethod
    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Run:
        """Take all steps; `record` keeps the path, for a known bound. Traceable, not differentiable in reverse."""

    def advance(self, stepper: Stepper, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The stored state after one more step, from any state: by the kernel of the loop where it has one.

        Traceable, not differentiable.
        """
        return stepper.advance(t, y, h)

    @abstractmethod
    def steps_of(self, path: Any) -> Part:
        """All steps, (bound,), those beyond the end without meaning; differentiable with respect to the times."""

    @abstractmethod
    def parts(self, path: Any, saved: Saved) -> Part:
        """The parts of steps to all saved times, (n,), zero where a step ends; without a path as the loop left them."""

    @property
    @abstractmethod
    def saved_times(self) -> jax.Array:
        """(n,) the saved times; differentiable."""

    def worst(self, stepper: Stepper, outcome: Outcome, x: Arrays) -> str | None:
        """The state with the largest error in a step from the end; None where errors are not known."""
        return None

    def trail(self, path: Any, steps: jax.Array, every: Blocks) -> Trail:
        """The starts of all steps, from the stored states before each and after the last."""
        known = self.steps_of(path)
        ends = jnp.concatenate([known.t[:1], known.t + known.h])
        return Trail(jnp.where(jnp.arange(ends.size) <= steps, ends, jnp.inf), every, steps)


def all_finite(tree: Any) -> jax.Array:
    """Whether every entry is finite. One reduction: XLA would compute a chain of tests again at every reader."""
    return jnp.isfinite(ravel_pytree(tree)[0]).all()


# ---- what a user asked for ----------------------------------------------------------------------------------------


def span_of(t0: Any, t1: Any, dt: Any) -> tuple[float, float] | None:
    """(t0, t1) as plain numbers, None where they are traced. Raises InputError for times or a dt that make no sense."""
    for name, value in (("t0", t0), ("t1", t1)):
        number(name, value, "a finite time in s")
    if dt is not None:
        number("dt", dt, "a positive number of s", lambda h: 0.0 < h < np.inf)
    if is_traced((t0, t1)):
        return None
    span = (float(t0), float(t1))
    if span[1] < span[0]:
        raise InputError(f"t1 = {span[1]:g} lies before t0 = {span[0]:g}.\n  fix: integrate forward in time")
    return span


def check_saves(save_at: Any, span: tuple[float, float] | None) -> bool:
    """Check saved times as far as they are known; returns whether they are. Raises InputError."""
    given = real_array("save_at", save_at)
    if given.ndim != 1 or given.size == 0:
        raise InputError(f"save_at expects times with shape (n,), n >= 1, got shape {given.shape}")
    if span is None or is_traced(given):
        return False
    times = np.asarray(given, float)
    start, end = span
    if not np.isfinite(times).all():
        raise InputError(f"save_at expects finite times, got {short(times)}")
    if (np.diff(times) < 0).any():
        i = int(np.argmax(np.diff(times) < 0))
        raise InputError(f"save_at must be sorted, got {times[i]:g} before {times[i + 1]:g}")
    room = 1e-6 * (end - start)
    if times[0] < start - room or times[-1] > end + room:
        worst = times[0] if times[0] < start - room else times[-1]
        raise InputError(f"save_at must lie inside [t0, t1] = [{start:g}, {end:g}], got {worst:g}")
    return True
