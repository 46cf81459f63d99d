"""The loop over steps, for fixed and adaptive steps: stops, saved times, events, progress."""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ...scalar.small_call import small_call
from ...system.dynamics import Arrays
from ..charts.coordinates import Blocks
from ..events.search import AcceptedStep, find_crossings, halted_code
from ..method import Stepper
from .kernels import Packed
from .outcome import EventState, Run, Saved, StepPart, Trail
from .progress_callback import ProgressCalls

#: From a packed state to the stored one.
Read = Callable[[jax.Array], Blocks]


class Visits(NamedTuple):
    """The stops of the loop: one for each saved time, and the end."""

    stops: Any  # (n + 1,) in order, in the unit of the steps; saved times and their padding, then the end
    count: Any  # how many saved times are asked for; the rest is padding
    like: Any  # of the shape of what is saved at a stop


class Steps(ABC):
    """The steps of an integration, and the loop that takes them.

    Subclasses determine the length of steps. A pytree: times and tolerances are inputs, rules and bounds are structure.
    The carry of the loop is a dataclass of the subclass with the fields `y`, `code` and `event_state`.
    """

    t0: Any  # the start
    dense: bool  # whether the starts of all steps are kept
    events: Any  # the `EventConditions`, or None
    progress_calls: ProgressCalls | None  # the progress callback
    #: Whether `run` returns the states at saved times, not those before them, up to an event.
    finds_rows: bool = False
    #: Cause and fix, with the length h of the step: of an end that is not finite, where nothing else is known; of the
    #: equations of an implicit step that could not be solved.
    too_long: tuple[str, str]
    not_solved: tuple[str, str]

    # ---- the loop ----------------------------------------------------------------------------------------------------

    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Run:
        """Take all steps; `record` also stores the path, if a bound of the number of steps is known. Traceable, not
        differentiable in reverse mode.
        """
        inputs = self.inputs(y)
        state, saved = small_call(lambda steps, *rest: steps.all_steps(*rest, record), self, stepper, inputs)
        return self.result(state, saved)

    def all_steps(self, stepper: Stepper, inputs: Any, record: bool) -> tuple[Any, Any]:
        """The final carry of the loop, and what was saved at every stop."""
        state, visits = self.begin(stepper, inputs, record)
        if self.events is not None:
            advance = functools.partial(self.advance, stepper, state)
            event_state = self.events.begin(advance, stepper, *self.first_step(state), _packed(state.y))
            state = dataclasses.replace(state, event_state=event_state, code=halted_code(event_state.halt, state.code))

        if not isinstance(visits, Visits):
            return self._to(stepper, state, visits), None

        def visit(state: Any, stop: jax.Array) -> tuple[Any, Any]:
            state = self._to(stepper, state, stop)
            return state, self.row_at(state, stop)

        # The padding of saved times is the end: one more stop than saved times leads there.
        return first_rows(visit, state, visits.stops, visits.count + 1, visits.like)

    def _to(self, stepper: Stepper, state: Any, stop: Any) -> Any:
        """Advance to a stop, with calls of the progress callback on the way."""
        if self.progress_calls is None:
            return self._steps_to(stepper, stop, state, None)
        steps_to = functools.partial(self._steps_to, stepper, stop)
        return self.progress_calls.loop(steps_to, state, *self.parts_of_progress(stepper, stop))

    def _steps_to(self, stepper: Stepper, stop: Any, state: Any, most: Any) -> Any:
        """Advance to a stop, or at most `most` tries; in a kernel if there is one."""
        event_state = state.event_state is not None
        kernel = self.kernel(stepper, state, stop, most)
        if kernel is not None and not event_state and self.in_one_kernel:
            return kernel(state, one=False)

        def one_round(state: Any) -> Any:
            kernel = self.kernel(stepper, state, stop, most)
            after = self.one_step(stepper, state) if kernel is None else kernel(state, one=event_state)
            return self._with_events(stepper, state, after) if event_state else after

        return jax.lax.while_loop(lambda state: self.going(state, stop, most), one_round, state)

    def _with_events(self, stepper: Stepper, before: Any, after: Any) -> Any:
        """The carry after a step; the one before it if an event within it ends the integration."""
        accepted_step, taken, ends = self.accepted_step(before, after)
        advance = functools.partial(self.advance, stepper, before)
        event_state = find_crossings(self.events, advance, stepper, accepted_step, before.event_state, taken, ends)
        return self.halted(stepper, before, after, event_state, accepted_step.h)

    # ---- methods of subclasses ---------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def bound(self) -> int:
        """The largest possible number of accepted steps, a plain number, for derivatives and dense output."""

    @property
    def in_one_kernel(self) -> bool:
        """Whether a kernel takes all steps to a stop in one call."""
        return True

    @abstractmethod
    def inputs(self, y: Blocks) -> Any:
        """The arguments of `begin`, from the stored state at the start."""

    @abstractmethod
    def begin(self, stepper: Stepper, inputs: Any, record: bool) -> tuple[Any, Visits | Any]:
        """The carry before the first step, and the stops: saved times, or only the end."""

    @abstractmethod
    def first_step(self, state: Any) -> tuple[jax.Array, jax.Array]:
        """Start and length of the first step."""

    @abstractmethod
    def going(self, state: Any, stop: Any, most: Any) -> jax.Array:
        """Whether another step follows on the way to a stop; with `most` as many tries are allowed at most."""

    @abstractmethod
    def one_step(self, stepper: Stepper, state: Any) -> Any:
        """The next step, or a try of it."""

    @abstractmethod
    def kernel(self, stepper: Stepper, state: Any, stop: Any, most: Any) -> Callable[..., Any] | None:
        """A kernel of `one_step`: kernel(state, one) takes one step, or all to the stop. None where there is none."""

    @abstractmethod
    def advance(self, stepper: Stepper, state: Any, h: jax.Array) -> Packed:
        """The packed state after one more step of another length, by the kernel of the loop where it has one."""

    @abstractmethod
    def accepted_step(self, before: Any, after: Any) -> tuple[AcceptedStep, Any, tuple[Any, Any]]:
        """The step between two carries: whether it was accepted, whether it is the first one and the last one."""

    @abstractmethod
    def halted(self, stepper: Stepper, before: Any, after: Any, event_state: EventState, h: jax.Array) -> Any:
        """The state after a step of length h, or before it where a condition halts the loop."""

    @abstractmethod
    def row_at(self, state: Any, stop: Any) -> Any:
        """The data that is saved at a stop."""

    @abstractmethod
    def parts_of_progress(self, stepper: Stepper, stop: Any) -> tuple[Any, Any, Callable[[Any], Any]]:
        """For `ProgressCalls.loop`: the last count of steps, steps between two calls, and how far a state is."""

    @abstractmethod
    def result(self, state: Any, saved: Any) -> Run:
        """The result of the loop, from its final carry and the saved data."""

    # ---- the same steps again, for saved times, derivatives and failures ---------------------------------------------

    @abstractmethod
    def steps_of(self, path: Any) -> StepPart:
        """All steps, (bound,), those beyond the end without meaning; differentiable with respect to the times."""

    @abstractmethod
    def parts(self, path: Any, saved: Saved) -> StepPart:
        """The parts of steps to all saved times, (n,), zero where a step ends; without a path as the loop left them."""

    @property
    @abstractmethod
    def saved_times(self) -> jax.Array:
        """(n,) the saved times; differentiable."""

    def errors_by_state(self, stepper: Stepper, t: jax.Array, h: jax.Array, x: Arrays) -> dict[str, jax.Array]:
        """The largest error of each state in a step from x, in units of the allowed error; empty if unknown.

        Traceable.
        """
        return {}

    def trail(self, path: Any, steps: jax.Array, every: Blocks) -> Trail:
        """The starts of all steps, from the stored states before each and after the last."""
        known = self.steps_of(path)
        ends = jnp.concatenate([known.t[:1], known.t + known.h])
        return Trail(jnp.where(jnp.arange(ends.size) <= steps, ends, jnp.inf), every, steps)


def _packed(y: Any) -> Packed:
    return y if isinstance(y, Packed) else Packed.of(y)


# ---- tables that the loop fills ------------------------------------------------------------------------------------


def rows(like: Any, count: int) -> Any:
    """Zeros with a leading axis in front of every leaf of a pytree."""
    return jax.tree.map(lambda a: jnp.zeros((count, *a.shape), a.dtype), like)


def put(table: Any, row: Any, value: Any) -> Any:
    """The table with one row of every leaf set."""
    return jax.tree.map(lambda a, b: a.at[row].set(jnp.asarray(b, a.dtype)), table, value)


def first_rows(step: Callable[[Any, Any], Any], start: Any, inputs: Any, count: Any, like: Any) -> tuple[Any, Any]:
    """`jax.lax.scan`, which ends after `count` of the rows of its inputs.

    Args:
        like: the result of a row. Results of rows that are not visited are zero.
    """

    def one(carried: tuple[jax.Array, Any, Any]) -> tuple[jax.Array, Any, Any]:
        k, state, results = carried
        state, result = step(state, jax.tree.map(lambda a: a[k], inputs))
        return k + 1, state, put(results, k, result)

    results = rows(like, jax.tree.leaves(inputs)[0].shape[0])
    carried = jax.lax.while_loop(lambda carried: carried[0] < count, one, (jnp.zeros((), int), start, results))
    return carried[1], carried[2]


def zeros_like(function: Any) -> Any:
    """Zeros of the shapes of what a function would return."""
    return jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(function))


def all_finite(tree: Any) -> jax.Array:
    """Whether every entry is finite, as one reduction: XLA would compute a chain of tests again at every use."""
    return jnp.isfinite(ravel_pytree(tree)[0]).all()


# ---- rows at saved times between the ends of steps ------------------------------------------------------------------


class StepPolynomial(NamedTuple):
    """A tried step, for its polynomial. The end of a rejected step is its start."""

    end: jax.Array
    begin: jax.Array
    y: jax.Array
    h: jax.Array
    in_s: jax.Array  # the same by time: negative where an integration goes backward
    slopes: Any
    y_end: jax.Array

    def row(self, stepper: Stepper, read: Read, t: jax.Array) -> jax.Array:
        """The packed state at a time up to the end of the step."""
        share = (t - self.begin) / self.h
        moved = stepper.method.between(stepper.dynamics, read(self.y), self.in_s, self.slopes, share)
        at_ends = jnp.where(share <= 0.0, self.y, self.y_end)
        return jnp.where((share > 0.0) & (t < self.end), ravel_pytree(moved)[0], at_ends)


class StepStart(NamedTuple):
    """The state of the loop after a try, for a shorter step from the start of the last step."""

    t: jax.Array
    accepted: jax.Array  # how many steps were taken
    y: jax.Array
    last: Any  # time and state at the start of the last step taken

    def before(self, stop: jax.Array) -> tuple[Any, jax.Array]:
        """Time and state from which at most one step leads to a stop that was just passed; and the steps before it."""
        # A saved time that is the end of a step needs no other one.
        there = self.t <= stop
        start = jax.tree.map(lambda end, before: jnp.where(there, end, before), (self.t, self.y), self.last)
        return start, self.accepted - (~there).astype(self.accepted.dtype)

    def row(self, stepper: Stepper, read: Read, t: jax.Array) -> jax.Array:
        """The start of the shorter step to a time, as `row_of_start` packs it."""
        return row_of_start(*self.before(t))


def rows_from(stepper: Stepper, read: Read) -> Callable[[Any, jax.Array], jax.Array]:
    """A function of a step's record and a time that makes the saved row.

    The function reads no arrays of the stepper, because these may be traced.
    """
    return lambda step, t: step.row(stepper, read, t)


def row_of_start(start: tuple[jax.Array, jax.Array], steps: jax.Array) -> jax.Array:
    """Time and state of a start, and how many steps come before it, in one row."""
    return jnp.concatenate([jnp.stack([start[0], steps]), start[1]])


def starts_in(table: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The times, the numbers of steps and the states in rows of `row_of_start`."""
    return table[:, 0], table[:, 1].astype(int), table[:, 2:]
