"""Equal steps, split at times at which rates may jump, so that no step contains a jump."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import short, whole
from ...errors import InputError
from ...jax_inside import is_traced
from ...scalar.loops import Filling
from ..charts.coordinates import Blocks
from ..controls import row_at
from ..events.search import AcceptedStep, halted_code
from ..method import StepAttempt, Stepper
from .kernels import KernelSteps, Packed, kernel_steps
from .loop import Steps, Visits, all_finite, put, rows, zeros_like
from .outcome import EventState, LoopOutcome, Result, Run, Saved, StepPart
from .progress_callback import ProgressCalls

#: A time this close to the end of a step, in steps, counts as on it: far more than round-off, far less than anyone
#: means.
SNAP = 1e-9


def slack(times: Any, h: Any, eps: float) -> Any:
    """The tolerance, s, within which a time counts as the end of a step of length h, because times may be rounded too.

    Args:
        eps: the relative spacing of floating-point numbers in the precision of the times.
    """
    array: Any = jnp if is_traced((times, h)) else np
    return array.maximum(SNAP * h, 4.0 * eps * abs(times))


class Splits(NamedTuple):
    """The places of jumps in a sequence of steps: inside an equal step, which they split, or at its end."""

    slots: Any  # (m,) in order: the number of the step that begins at each jump; beyond all steps for those left out
    times: Any  # (m,) the jumps
    added: Any  # (m,) the steps that the jumps up to and including this one add


class Grid(NamedTuple):
    """Steps of length h from t0, split at jumps. A pytree: other numbers do not recompile.

    Step k begins at $t0 + (k - a) h$, with a the number of steps that jumps have added before it, or at a jump. A jump
    at the end of an equal step replaces that end, so that derivatives with respect to its time are correct.
    """

    t0: Any
    h: Any
    splits: Splits | None = None

    def begin(self, k: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The start of step k, computed without accumulated error; and whether it is a jump."""
        if self.splits is None:
            return self.t0 + k.astype(self.t0.dtype) * self.h, jnp.zeros(jnp.shape(k), bool)
        slots, times, added = map(jnp.asarray, self.splits)
        row = row_at(slots, k)
        last = jnp.maximum(row, 0)
        before = jnp.where(row < 0, 0, added[last])
        at_jump = (row >= 0) & (slots[last] == k)
        return jnp.where(at_jump, times[last], self.t0 + (k - before).astype(self.t0.dtype) * self.h), at_jump

    def step(self, k: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Start and length of step k."""
        t, from_jump = self.begin(k)
        if self.splits is None:
            return t, self.h
        end, to_jump = self.begin(k + 1)
        return t, jnp.where(from_jump | to_jump, end - t, self.h)

    def attempt(self, stepper: Stepper, k: jax.Array, state: tuple[Any, Any, Any]) -> StepAttempt:
        """Step k from a stored state, with what the method carries, and slopes where the step is sampled.

        The loop executes it, and kernels are compiled from it.
        """
        (t, h), (y, carry, slopes) = self.step(k), state
        return stepper.follow(t, y, carry, h, slopes is not None)

    def one_step(self, t: jax.Array, h: jax.Array) -> Grid:
        """A grid of the same structure whose first step is that of length h from t."""
        if self.splits is None:
            return Grid(t, h)
        slots = jnp.asarray(self.splits.slots)
        return Grid(
            t, h, Splits(jnp.full_like(slots, jnp.iinfo(slots.dtype).max), self.splits.times, self.splits.added)
        )


def splits_of(limits: Any, t0: Any, h: Any, steps: int) -> tuple[Splits | None, Any]:
    """The splits of equal steps at sorted times inside of [t0, t0 + steps h], and how many steps they add.

    Times at the ends of the whole span split no step. The result is None if there are no times.
    """
    if not np.size(limits):
        return None, 0
    array: Any = jnp if is_traced((limits, t0, h)) else np
    kind = jax.dtypes.canonicalize_dtype(int)
    fixed = jax.lax.stop_gradient((limits, t0, h)) if array is jnp else (limits, t0, h)
    times, start, length = (array.asarray(value) for value in fixed)
    length = array.where(length > 0.0, length, 1.0)
    near = slack(times, length, float(np.finfo(times.dtype).eps)) / length
    place = (times - start) / length
    nearest = array.rint(place)
    on_end = abs(place - nearest) <= near
    end = array.where(on_end, nearest, array.ceil(place))
    again = (array.diff(end) == 0.0) & on_end[1:] & on_end[:-1] | (array.diff(place) <= near[1:])
    again = array.append(array.zeros(1, bool), again)
    present = (end > 0.0) & ((end < steps) | (~on_end & (end <= steps))) & ~again
    added = array.cumsum(present & ~on_end).astype(kind)
    # Of those that add a step the ones before count, and the equal steps up to the jump.
    slots = end.astype(kind) + array.where(on_end, added, added - 1)
    slots = array.where(present, slots, np.iinfo(kind).max)
    order = array.argsort(slots, **({"stable": True} if array is jnp else {"kind": "stable"}))
    return Splits(slots[order], array.asarray(limits)[order], added[order]), added[-1]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Saves:
    """Saved times: each lies at the fraction `share` of an equal step after the start of step `index`, unless that
    starts at a jump.
    """

    ts: Any  # (n,) the times
    index: Any  # (n,) whole steps before each
    share: Any  # (n,) in [0, 1]
    on: Any  # (n,) whether it is where step `index` begins
    count: Any  # how many were asked for; padding is at the end


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _State:
    steps: Any  # taken so far
    y: Any
    carry: Any
    evaluations: Any
    code: Any  # the number of the result so far
    every: Any  # the states so far if kept
    slopes: Any  # those of the last step, where there are events and the method has any
    event_state: Any
    rows: Any = None  # of kernels: the states before the saved times


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FixedSteps(Steps):
    """Equal steps from t0, split at jumps; the loop ends at the start of a step that fails."""

    t0: Any
    h: Any  # the length of an equal step
    steps: Any  # the number of steps, those that jumps add included
    at: Any  # the `Saves`, where the saved times fall; None where there are none
    #: The number of steps as structure, which derivatives and dense output need; else None.
    most: int | None = dataclasses.field(metadata={"static": True})
    dense: bool = dataclasses.field(metadata={"static": True})
    events: Any = None
    progress_calls: ProgressCalls | None = None
    splits: Splits | None = None  # at jumps

    too_long = (
        "the step {h:.6g} s is too long for rates this fast, or the solution itself grows without bound",
        "try a smaller dt",
    )
    not_solved = (
        "rates change too much within the step of {h:.6g} s for Newton's method, or they jump",
        "try a smaller dt, or steps chosen by tolerances: rtol=..., atol=...",
    )

    @property
    def bound(self) -> int:
        if self.most is None:
            raise InputError(
                "cannot differentiate this integration, whose inputs are known numbers: does u close over a "
                "traced value that it does not use at t0?\n  fix: pass that value through params or a table"
            )
        return self.most

    @property
    def grid(self) -> Grid:
        """Where steps begin."""
        return Grid(jnp.asarray(self.t0), jnp.asarray(self.h), self.splits)

    def inputs(self, y: Blocks) -> tuple[Blocks, jax.Array]:
        stops = self.steps[None]
        if self.at is not None:
            stops = jnp.concatenate([self.at.index.astype(stops.dtype), stops])
        return y, stops

    def begin(
        self, stepper: Stepper, inputs: tuple[Blocks, jax.Array], record: bool
    ) -> tuple[_State, Visits | jax.Array]:
        y, stops = inputs
        every = put(rows(y, self.bound + 1), 0, y) if self.dense else None
        zero, carry, slopes = jnp.zeros((), stops.dtype), stepper.method.before(stepper.dynamics, y), None
        if self.events is not None:
            t, h = self.grid.step(jnp.zeros((), int))
            slopes = zeros_like(lambda: stepper.follow(t, y, carry, h, sampled=True).slopes)
        state = _State(zero, y, carry, zero, jnp.zeros((), int), every, slopes, None)
        if self.at is None:
            return state, stops[0]
        if self.events is None and every is None and self._kernel(stepper, state, saves=True) is not None:
            marks, start = stops[:-1], Packed.of(y).flat
            # The start is the row of no steps; padding has no row.
            marks = jnp.where(jnp.arange(marks.size) < self.at.count, marks, jnp.iinfo(marks.dtype).max)
            table = jnp.broadcast_to(start, (marks.size, start.size))
            return dataclasses.replace(state, rows=Filling(marks, table, (marks <= 0).sum(dtype=zero.dtype))), stops[-1]
        return state, Visits(stops, self.at.count, (y, jnp.zeros((), bool)))

    def first_step(self, state: _State) -> tuple[jax.Array, jax.Array]:
        return self.grid.step(state.steps)

    def going(self, state: _State, stop: Any, most: Any) -> jax.Array:
        return (state.steps < (stop if most is None else most)) & (state.code == Result.SUCCESS.value)

    def one_step(self, stepper: Stepper, state: _State) -> _State:
        """The next step; the state stays where it fails."""
        attempt = self.grid.attempt(stepper, state.steps, (state.y, state.carry, state.slopes))
        good = all_finite(attempt.y)
        code = jnp.where(good, Result.SUCCESS.value, Result.NON_FINITE.value)
        if attempt.solved is not None:
            good = good & attempt.solved
            code = jnp.where(attempt.solved, code, Result.NEWTON_FAILED.value)
        y = jax.tree.map(lambda new, old: jnp.where(good, new, old), attempt.y, state.y)
        steps = state.steps + good.astype(state.steps.dtype)
        return _State(
            steps=steps,
            y=y,
            carry=attempt.carry,
            evaluations=state.evaluations + attempt.evaluations,
            code=code,
            every=None if state.every is None else put(state.every, steps, y),
            slopes=state.slopes and attempt.slopes,
            event_state=state.event_state,
        )

    def _kernel(self, stepper: Stepper, state: _State, saves: bool) -> KernelSteps | None:
        number = jnp.zeros_like(state.steps)
        return kernel_steps(stepper, self.grid, number, (state.y, state.carry, state.slopes), saves)

    def kernel(self, stepper: Stepper, state: _State, stop: Any, most: Any) -> Callable[..., _State] | None:
        kernel = None if state.every is not None else self._kernel(stepper, state, state.rows is not None)
        if kernel is None:
            return None

        def run(state: _State, one: bool) -> _State:
            end = state.steps + 1 if one else stop if most is None else most
            # A loop that halted already stays as it is.
            end = end if one else jnp.where(state.code == Result.SUCCESS.value, end, state.steps)
            (y, carry, slopes), steps, filled = kernel.run(
                stepper, self.grid, state.steps, end, (state.y, state.carry, state.slopes), state.rows
            )
            halted = steps < end
            tried = steps - state.steps + halted.astype(steps.dtype)
            evaluations = state.evaluations + tried * kernel.evaluations
            code = jnp.where(halted, Result.NON_FINITE.value, state.code)
            return dataclasses.replace(
                state, steps=steps, y=y, carry=carry, slopes=slopes, evaluations=evaluations, code=code, rows=filled
            )

        return run

    def advance(self, stepper: Stepper, state: _State, h: jax.Array) -> Packed:
        t, _ = self.grid.step(state.steps)
        number, carry = jnp.zeros_like(state.steps), stepper.method.before(stepper.dynamics, state.y)
        grid, start = self.grid.one_step(t, h), (state.y, carry, state.slopes)
        kernel = kernel_steps(stepper, grid, number, start)
        if kernel is None:
            return Packed.of(stepper.advance(t, state.y, h))
        (moved, _, _), count, _ = kernel.run(stepper, grid, number, number + 1, start, None)
        packed = Packed.of(moved)
        return Packed(jnp.where(count > 0, packed.flat, jnp.nan), packed.read)

    def accepted_step(self, before: _State, after: _State) -> tuple[AcceptedStep, Any, tuple[Any, Any]]:
        t, h = self.grid.step(before.steps)
        accepted_step = AcceptedStep(before.steps, t, h, Packed.of(before.y), Packed.of(after.y), after.slopes)
        return accepted_step, after.steps > before.steps, (before.steps == 0, before.steps + 1 == self.steps)

    def halted(self, stepper: Stepper, before: _State, after: _State, event_state: EventState, h: jax.Array) -> _State:
        code = halted_code(event_state.halt, after.code)
        hit = code != after.code
        steps, y = jax.tree.map(lambda a, b: jnp.where(hit, a, b), (before.steps, before.y), (after.steps, after.y))
        return dataclasses.replace(after, steps=steps, y=y, code=code, event_state=event_state)

    def row_at(self, state: _State, stop: Any) -> tuple[Blocks, jax.Array]:
        return state.y, state.code == Result.SUCCESS.value

    def parts_of_progress(self, stepper: Stepper, stop: jax.Array) -> tuple[Any, Any, Callable[[_State], Any]]:
        def reached(state: _State) -> tuple[jax.Array, jax.Array, jax.Array]:
            steps = jnp.where(state.code == Result.SUCCESS.value, state.steps, jnp.iinfo(state.steps.dtype).max)
            return steps, stepper.clock(self.grid.begin(state.steps)[0]), state.steps / jnp.maximum(self.steps, 1)

        return stop, jnp.maximum(self.steps // 100, 1).astype(stop.dtype), reached

    def result(self, state: _State, saved: Any) -> Run:
        evaluations, event_state = state.evaluations, state.event_state
        if event_state is not None:
            evaluations = evaluations + event_state.evaluations
            event_state = event_state.after_loop(Packed.of(state.y).read, state.steps)
        outcome = LoopOutcome(state.code, state.steps, state.steps, evaluations, *self.grid.step(state.steps))
        trail = None if state.every is None else self.trail(None, state.steps, state.every)
        rows_saved = None
        if self.at is not None:
            if state.rows is None:
                starts, reached = jax.tree.map(lambda a: a[:-1], saved)
            else:
                read = Packed.of(state.y).read
                starts, reached = jax.vmap(read)(state.rows.table), self.at.index <= state.steps
            requested = jnp.arange(len(reached)) < self.at.count
            times = self.grid.begin(self.at.index)[0]
            rows_saved = Saved(self.at.index, times, starts, reached & requested, requested)
        return Run(state.y, outcome, rows_saved, None, trail, event_state)

    def steps_of(self, path: None) -> StepPart:
        t, h = self.grid.step(jnp.arange(self.bound))
        return StepPart(t, jnp.broadcast_to(h, t.shape))

    def parts(self, path: None, saved: Saved) -> StepPart:
        t, from_jump = self.grid.begin(saved.steps)
        h = self.at.share * self.h
        if self.splits is not None:
            since = self.saved_times - t
            # Nothing is left to do where a saved time is a jump, but the jump may move.
            since = since - jnp.where(self.at.on, jax.lax.stop_gradient(since), 0.0)
            h = jnp.where(from_jump, since, h)
        return StepPart(t, h)

    @property
    def saved_times(self) -> jax.Array:
        return jnp.asarray(self.at.ts)


def equal_steps(
    start: Any, end: Any, span: Any, options: Any, limits: Any, bounded: bool, events: Any
) -> tuple[FixedSteps, int]:
    """Equal steps from start to end, and their number: (end - start) / dt rounded, at least one; or `steps`.

    All times are those of the clock of the loop over steps, which goes forward.

    Args:
        span: the times where they are known numbers.
        options: `dt`, `steps` and `dense`.
        limits: the times where a step must end, in order, the last one the end.
        bounded: whether the number of steps is part of the structure.
    Raises:
        InputError: neither dt nor steps, or both, or times that are not known.
    """
    dt, steps, dtype = options.dt, options.steps, start.dtype
    if (dt is None) == (steps is None):
        raise InputError("pass one of dt (the length of a step), steps (the number of steps), or rtol (adaptive steps)")
    if steps is None:
        if span is None or is_traced(dt):
            raise InputError(
                "t0, t1 or dt is traced (inside jit, grad or vmap), so the number of steps is not known.\n"
                "  fix: pass steps=<whole number> instead of dt; the step is then (t1 - t0) / steps"
            )
        length = span[1] - span[0]
        steps = max(1, round(_countable(length / float(dt)))) if length else 0
    else:
        steps = _countable(whole("steps", steps))
    array: Any = jnp if span is None else np  # known numbers are made arrays of JAX where they are used, all at once
    start, end = array.asarray(start), array.asarray(end)
    h = np.asarray((span[1] - span[0]) / max(steps, 1), dtype) if span else (end - start) / steps
    splits, more = splits_of(limits[:-1], start, h, steps)
    array = jnp if is_traced(more) else np
    # What jumps add is a number; the bound has room for all of them.
    most = steps + np.size(limits) - 1 if bounded else None
    fixed = FixedSteps(start, h, array.asarray(steps + more), None, most, options.dense, events, splits=splits)
    return fixed, steps


def _countable(steps: Any) -> Any:
    """A number of steps, if JAX's integers hold it: beyond them it would wrap. Raises InputError."""
    most = np.iinfo(jax.dtypes.canonicalize_dtype(np.int64)).max
    if steps > most:
        raise InputError(
            f"{short(steps)} steps are more than the {most} that can be counted.\n"
            '  fix: use longer steps, or jax.config.update("jax_enable_x64", True) counts to 9e18'
        )
    return steps
