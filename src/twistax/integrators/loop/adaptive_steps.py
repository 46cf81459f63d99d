"""Adaptive steps, whose lengths follow from the tolerances."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ...scalar.loops import Filling
from ...scalar.small_call import stored_once
from ...system.dynamics import Arrays
from ..charts.coordinates import Blocks
from ..events.search import AcceptedStep, halted_code
from ..method import Stepper
from ..methods.interpolant import Between
from ..step_control import ErrorHistory, StepControl, Stops, Tolerances
from .kernels import Packed, kernel_tries, shared_kernel
from .loop import (
    StepPolynomial,
    Steps,
    StepStart,
    Visits,
    all_finite,
    put,
    row_of_start,
    rows,
    rows_from,
    starts_in,
    zeros_like,
)
from .outcome import EventState, Halt, LoopOutcome, Result, Run, Saved, StepPart
from .progress_callback import ProgressCalls

#: Steps between calls of the progress callback, which takes as long as some twenty of them.
_PROGRESS = 256
#: The most limits of a kernel: it compares the time with each.
_SEEN = 64


class _Path(NamedTuple):
    """The accepted steps: the leg of each, and its place there as shares of the leg."""

    leg: jax.Array
    begin: jax.Array
    end: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _State:
    """The carry of the loop.

    Pytrees are packed into vectors: XLA would compute the test of a step again for every scalar it guards.
    """

    t: Any
    h: Any  # the next step to try; after a failure the one that failed
    y: Any
    carry: Any  # what the method carries
    errors: Any
    rejected: Any
    tried: Any
    accepted: Any
    evaluations: Any
    code: Any
    last: Any  # the start of the last step taken
    path: Any = None
    every: Any = None  # the states at the ends of all accepted steps, for dense output
    slopes: Any = None  # those of the last step tried, where there are events and the method has any
    event_state: Any = None
    rows: Any = None  # those on polynomials; of kernels also the starts of parts of steps

    def bare(self, **changes: Any) -> _State:
        """The carry without events and saved rows."""
        return dataclasses.replace(self, event_state=None, rows=None, **changes)


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
    events: Any = None
    progress_calls: ProgressCalls | None = None

    too_long = (
        "however short the step: the solution grows without bound, or a rate stops being finite just after",
        "stop before that time, or guard the expression",
    )
    not_solved = (
        "even in a step of {h:.3g} s: rates jump there, or are not smooth, or their derivatives are not finite",
        "name times of jumps with jumps=..., or smooth the expression; with jumps=save_at steps end at the saved times",
    )

    @property
    def bound(self) -> int:
        return self.control.max_steps

    @property
    def finds_rows(self) -> bool:  # type: ignore[override]
        return self.between is Between.POLYNOMIAL

    @property
    def in_one_kernel(self) -> bool:
        return bool(self.stops.limits.size <= _SEEN)

    def inputs(self, y: Blocks) -> Packed:
        return Packed.of(y)

    def begin(self, stepper: Stepper, inputs: Packed, record: bool) -> tuple[_State, Visits | jax.Array]:
        stops, y, t = self.stops, inputs, self.t0
        bare = dataclasses.replace(self._bare(stops.limits), between=Between.STEP)
        carry, h = shared_kernel(AdaptiveSteps.carry_and_first_step, bare, stepper, y)
        slopes = None
        if self.events is not None:
            room = zeros_like(lambda: stepper.attempt(t, y.open(), carry.open(), h, self.tolerances).slopes)
            slopes = None if room is None else Packed.of(room)
        zero, number, end = jnp.zeros((), int), jnp.zeros((), t.dtype), jnp.asarray(stops.limits[-1])
        state = _State(
            t=t,
            h=h,
            y=y,
            carry=carry,
            errors=ErrorHistory(number, number),
            rejected=jnp.asarray(False),
            tried=zero,
            accepted=zero,
            evaluations=zero + 2,
            code=zero,
            last=(t, y.flat),
            path=rows(_Path(zero, t, t), self.bound) if record or self.dense else None,
            every=put(rows(y.flat, self.bound + 1), 0, y.flat) if self.dense else None,
            slopes=slopes,
        )
        if stops.ts is None:
            return state, end
        if self.finds_rows and not record:
            ts = jnp.asarray(stops.ts)
            table = Filling(ts, jnp.broadcast_to(y.flat, (ts.size, y.flat.size)), zero)
            return dataclasses.replace(state, rows=table), end
        if self.events is None and self.kernel(stepper, state, end, None) is not None:
            ts, start = jnp.asarray(stops.ts), row_of_start((t, y.flat), number)
            table = Filling(ts, jnp.broadcast_to(start, (ts.size, start.size)), zero)
            return dataclasses.replace(state, rows=table), end
        like = state.last, zero, jnp.asarray(False)
        return state, Visits(jnp.append(stops.ts, end), stops.count, like)

    def carry_and_first_step(self, stepper: Stepper, packed: Packed) -> tuple[Packed, jax.Array]:
        """The carry of the method at the start, and the first step to try."""
        y = packed.open()
        room = self.stops.limits[-1] - self.t0
        guess = jnp.where(self.first > 0.0, self.first, 1e-6 * room)
        rate = stepper.rate(self.t0, y, jnp.minimum(guess, self.stops.next_limit(self.t0) - self.t0))
        chosen = stepper.first_step(self.tolerances, self.t0, y, rate, guess, room)
        carry = stepper.method.begin(stepper.dynamics, y, rate)
        return Packed.of(carry), jnp.where(self.first > 0.0, self.first, chosen)

    def first_step(self, state: _State) -> tuple[jax.Array, jax.Array]:
        return self.t0, state.h

    def row_at(self, state: _State, stop: jax.Array) -> tuple[Any, jax.Array, jax.Array]:
        start, steps = StepStart(state.t, state.accepted, state.y.flat, state.last).before(stop)
        return start, steps, state.t >= stop

    def parts_of_progress(self, stepper: Stepper, stop: jax.Array) -> tuple[Any, Any, Callable[[_State], Any]]:
        def reached(state: _State) -> tuple[jax.Array, jax.Array, jax.Array]:
            tried = jnp.where(_before(state, stop), state.tried, self.bound)
            return tried, stepper.clock(state.t), (state.t - self.t0) / (self.stops.limits[-1] - self.t0)

        return jnp.asarray(self.bound), jnp.asarray(_PROGRESS), reached

    def result(self, state: _State, saved: Any) -> Run:
        stops, read = self.stops, state.y.read
        short = (state.code == Result.SUCCESS.value) & (state.t < stops.limits[-1])
        code = jnp.where(short, Result.MAX_STEPS.value, state.code)
        event_state, evaluations = state.event_state, state.evaluations
        if event_state is not None:
            evaluations = evaluations + event_state.evaluations
            event_state = event_state.after_loop(read, state.accepted)
        outcome = LoopOutcome(code, state.tried, state.accepted, evaluations, state.t, state.h)
        trail = self.trail(state.path, state.accepted, jax.vmap(read)(state.every)) if self.dense else None
        rows_saved = None
        if stops.ts is not None:
            requested = jnp.arange(stops.ts.size) < stops.count
            if state.rows is not None:
                # As at the ends of steps: nothing is left to do, and no step was taken up to the start.
                ts, table = jnp.asarray(stops.ts), state.rows.table
                steps, begins = (ts > self.t0).astype(int), ts
                if not self.finds_rows:
                    begins, steps, table = starts_in(table)
                rows_saved = Saved(steps, begins, jax.vmap(read)(table), (ts <= state.t) & requested, requested)
            else:
                (times, starts), index, reached = jax.tree.map(lambda a: a[:-1], saved)
                rows_saved = Saved(index, times, jax.vmap(read)(starts), reached & requested, requested)
        return Run(state.y, outcome, rows_saved, state.path, trail, event_state)

    def going(self, state: _State, stop: Any, most: Any) -> jax.Array:
        return _before(state, stop) & (state.tried < (self.bound if most is None else most))

    def one_step(self, stepper: Stepper, state: _State) -> _State:
        after, step = self.one_try(stepper, dataclasses.replace(state, event_state=None))
        if state.rows is not None and step is not None:
            row = rows_from(stepper, state.y.read)
            after = dataclasses.replace(after, rows=state.rows.up_to(after.t, row, stored_once(step)))
        return after

    def kernel(self, stepper: Stepper, state: _State, stop: Any, most: Any) -> Callable[..., _State] | None:
        if state.path is not None or state.every is not None:
            return None
        tries = self._tries(stepper, state.bare(), stop)
        if tries is None:
            return None

        def run(state: _State, one: bool) -> _State:
            end = self.bound if most is None else most
            last = state.tried + 1 if one else jnp.where(self.going(state, stop, most), end, state.tried)
            after, table = tries(state.bare(), state.tried, last, state.rows)
            return dataclasses.replace(after, rows=table)

        return run

    def _tries(self, stepper: Stepper, state: _State, stop: Any) -> Any:
        # Kernels count evaluations in the precision of the state.
        most = self.bound * (stepper.method.evaluations_of(stepper.dynamics) + 1)
        if most >= 2 ** jnp.finfo(self.t0.dtype).nmant:
            return None
        limits = self.stops.limits
        if limits.size > _SEEN:
            limits = jax.lax.dynamic_slice_in_dim(limits, jnp.searchsorted(limits, state.t), _SEEN)
            stop = jnp.minimum(stop, limits[-1])

        def one_try(
            inputs: Any, stepper: Stepper, state: _State
        ) -> tuple[_State, jax.Array, StepPolynomial | StepStart | None]:
            steps, stop = inputs
            after, step = steps.one_try(stepper, state)
            if not steps.finds_rows:
                taken = StepStart(after.t, after.accepted.astype(after.t.dtype), after.y.flat, after.last)
                return after, _before(after, stop), taken
            return after, _before(after, stop), step

        row, narrow = rows_from(stepper, state.y.read), _without_slopes
        return kernel_tries(one_try, row, (self._bare(limits), stop), stepper, state, narrow)

    def _bare(self, limits: Any) -> AdaptiveSteps:
        """The same steps without saved times and events, with these limits, so that all share a kernel."""
        return dataclasses.replace(self, stops=Stops(limits, None, None), events=None, progress_calls=None, dense=False)

    def one_try(self, stepper: Stepper, state: _State) -> tuple[_State, StepPolynomial | None]:
        """One try of a step, accepted or rejected, and the data of its polynomial, where the method has one."""
        control, order, t, before = self.control, stepper.method.error_order, state.t, state.y.open()
        end, h, planned, least = control.length(t, state.h, self.stops.next_limit(t))
        cut = h < planned
        # As far as the clock moves: rounding of large times would add up.
        h = end - t
        carry, evaluations = self._resumed(stepper, state, before, h)
        attempt = stepper.attempt(t, before, state.carry.read(carry), h, self.tolerances)
        y, new_carry = ravel_pytree(attempt.y)[0], ravel_pytree(attempt.carry)[0]
        finite = all_finite((y, new_carry))
        square = self.tolerances.square(stepper.coordinates, attempt.errors, before, attempt.y)
        usable = finite if attempt.solved is None else finite & attempt.solved
        square = jnp.where(usable & jnp.isfinite(square), square, jnp.inf)
        good = square <= 1.0
        growth, errors = control.grown(square, state.errors, state.rejected, order)
        # A step cut short at a limit says little against the longer one that was planned.
        longer = jnp.maximum(h * growth, jnp.where(cut, jnp.where(state.rejected, 0.0, planned), 0.0))
        shorter = h * control.shrunk(square, order)
        trouble = jnp.where(finite, Result.STEP_TOO_SMALL.value, Result.NON_FINITE.value)
        if attempt.solved is not None:
            shorter = jnp.where(attempt.solved, shorter, 0.5 * h)
            trouble = jnp.where(attempt.solved, trouble, Result.NEWTON_FAILED.value)
        failed = ~good & ((shorter < least) | (h <= least))

        def pick(new: Any, old: Any) -> Any:
            return jax.tree.map(lambda a, b: jnp.where(good, a, b), new, old)

        after = _State(
            t=pick(end, t),
            h=jnp.where(good, longer, jnp.where(failed, h, shorter)),
            y=Packed(pick(y, state.y.flat), state.y.read),
            carry=Packed(pick(new_carry, carry), state.carry.read),
            errors=pick(errors, state.errors),
            rejected=~good,
            tried=state.tried + 1,
            accepted=state.accepted + good.astype(int),
            evaluations=evaluations + attempt.evaluations,
            code=jnp.where(failed, trouble, state.code),
            last=pick((t, state.y.flat), state.last),
            # A step that is taken back leaves rows that a later one writes again.
            path=self._longer_path(state, end),
            every=None if state.every is None else put(state.every, state.accepted + 1, y),
            slopes=None if state.slopes is None else Packed(ravel_pytree(attempt.slopes)[0], state.slopes.read),
        )
        if attempt.slopes is None:
            return after, None
        return after, StepPolynomial(after.t, t, state.y.flat, h, stepper.clock(h), attempt.slopes, after.y.flat)

    def _resumed(self, stepper: Stepper, state: _State, y: Blocks, h: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The packed carry that the step begins with, and the evaluations so far."""
        limits, carry, evaluations = self.stops.limits, state.carry, state.evaluations
        if limits.size <= 1:
            return carry.flat, evaluations
        # Rates may have jumped where a step ended at a limit; at saved times they do not.
        at_limit = (limits == state.t).any() & ~state.rejected
        stored = carry.open()
        resumed = jax.lax.cond(
            at_limit, lambda: ravel_pytree(stepper.resume(state.t, y, stored, h))[0], lambda: carry.flat
        )
        return resumed, evaluations + jnp.where(at_limit, stepper.method.resume_evaluations, 0)

    def advance(self, stepper: Stepper, state: _State, h: jax.Array) -> Packed:
        # A try of unlimited tolerance, as if its end were the next limit.
        limits = jnp.where(self.stops.limits > state.t, state.t + h, self.stops.limits)
        stops = Stops(limits, self.stops.ts, self.stops.count)
        tolerances = jax.tree.map(lambda a: jnp.full_like(a, jnp.inf), self.tolerances)
        state = state.bare(h=jnp.full_like(state.h, jnp.inf), path=None, every=None)
        tries = dataclasses.replace(self, stops=stops, tolerances=tolerances)._tries(stepper, state, state.t)
        if tries is None:
            return Packed.of(stepper.advance(state.t, state.y.open(), h))
        moved, _ = tries(state, state.tried, state.tried + 1, None)
        return Packed(jnp.where(moved.accepted > state.accepted, moved.y.flat, jnp.nan), state.y.read)

    def accepted_step(self, before: _State, after: _State) -> tuple[AcceptedStep, Any, tuple[Any, Any]]:
        accepted_step = AcceptedStep(before.accepted, before.t, after.t - before.t, before.y, after.y, after.slopes)
        ends = before.accepted == 0, after.t == self.stops.limits[-1]
        return accepted_step, after.accepted > before.accepted, ends

    def halted(self, stepper: Stepper, before: _State, after: _State, event_state: EventState, h: jax.Array) -> _State:
        states = [state.bare(path=None, every=None) for state in (before, after)]
        kept = shared_kernel(_halted, None, stepper, *states, event_state.halt, h)
        return dataclasses.replace(kept, event_state=event_state, rows=after.rows, path=after.path, every=after.every)

    @property
    def saved_times(self) -> jax.Array:
        return jnp.asarray(self.stops.ts)

    def errors_by_state(self, stepper: Stepper, t: jax.Array, h: jax.Array, x: Arrays) -> dict[str, jax.Array]:
        y = stepper.coordinates.enter(x)
        carry = stepper.method.begin(stepper.dynamics, y, stepper.rate(t, y, h))
        attempt = stepper.attempt(t, y, carry, h, self.tolerances)
        return self.tolerances.by_state(stepper.coordinates, attempt.errors[0], y, attempt.y)

    def _longer_path(self, state: _State, end: jax.Array) -> _Path | None:
        if state.path is None:
            return None
        leg = jnp.minimum((self.stops.limits <= state.t).sum(), self.stops.limits.size - 1)
        start, length = self.stops.leg(self.t0, leg)
        length = jnp.where(length > 0.0, length, 1.0)
        return put(state.path, state.accepted, _Path(leg, (state.t - start) / length, (end - start) / length))

    def steps_of(self, path: _Path) -> StepPart:
        start, length = self.stops.leg(self.t0, path.leg)
        return StepPart(start + path.begin * length, (path.end - path.begin) * length)

    def parts(self, path: _Path | None, saved: Saved) -> StepPart:
        ts = self.saved_times
        if path is None:
            return StepPart(saved.t, ts - saved.t)
        k = jnp.maximum(saved.steps - 1, 0)
        start, length = self.stops.leg(self.t0, path.leg[k])
        before = jnp.where(saved.steps == 0, self.t0, start + path.end[k] * length)
        return StepPart(before, ts - before)


def _halted(_: None, __: Stepper, before: _State, after: _State, halt: Halt, h: jax.Array) -> _State:
    """The state after a try; the one before it where an event halts the loop."""
    code = halted_code(halt, after.code)
    hit = code != after.code
    names = ("t", "y", "carry", "errors", "accepted", "last")
    old = jax.tree.map(
        lambda a, b: jnp.where(hit, a, b), *([getattr(state, name) for name in names] for state in (before, after))
    )
    changes = dict(zip(names, old, strict=True))
    return dataclasses.replace(after, **changes, h=jnp.where(hit, h, after.h), code=code)


def _before(state: _State, stop: Any) -> jax.Array:
    """Whether the loop has neither reached a stop nor halted."""
    return (state.t < stop) & (state.code == 0)


def _without_slopes(state: _State) -> _State:
    return dataclasses.replace(state, slopes=None)
