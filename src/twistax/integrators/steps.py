"""How an integration goes from its start to its end: the loop over steps, and steps of fixed length."""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..errors import InputError
from ..scalar.small_call import small_call
from ..system.dynamics import Arrays
from .charts import Blocks
from .grid import Grid, Splits
from .kernels import Packed, kernel_steps
from .meter import Meter
from .method import Carry, Stepper
from .rows import first_rows, put, rows
from .run import Outcome, Part, Result, Run, Saved, Trail, Watched
from .search import Stride, halted_code, watched_along


def ended_well(code: Any) -> Any:
    """Whether numbers of a `Result` are no failures."""
    return (code == Result.SUCCESS.value) | (code == Result.EVENT.value)


class Steps(ABC):
    """The loop over steps. A pytree: times and tolerances are inputs, rules and bounds are structure."""

    t0: Any  # when they begin
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

    def errors_by_state(self, stepper: Stepper, t: jax.Array, h: jax.Array, x: Arrays) -> dict[str, jax.Array]:
        """The largest error of each state in a step from x, in units of what is allowed; empty where none is known.

        Traceable.
        """
        return {}

    def trail(self, path: Any, steps: jax.Array, every: Blocks) -> Trail:
        """The starts of all steps, from the stored states before each and after the last."""
        known = self.steps_of(path)
        ends = jnp.concatenate([known.t[:1], known.t + known.h])
        return Trail(jnp.where(jnp.arange(ends.size) <= steps, ends, jnp.inf), every, steps)


class Saves(NamedTuple):
    """Saved times: each lies `share` of an equal step after step `index` begins, unless that begins at a jump."""

    ts: Any  # (n,) the times
    index: Any  # (n,) whole steps before each
    share: Any  # (n,) in [0, 1]
    on: Any  # (n,) whether it is where step `index` begins
    count: Any  # how many were asked for; those that fill up the rest are at the end


class _Now(NamedTuple):
    """What the loop carries."""

    steps: jax.Array  # taken so far
    y: Blocks
    carry: Carry
    evaluations: jax.Array
    code: jax.Array  # the number of the result so far
    every: Blocks | None  # the states so far if kept
    slopes: Any  # those of the last step, where conditions are watched and the method has any
    watched: Watched | None


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
    watch: Any = None
    meter: Meter | None = None
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
                "a derivative is asked for of an integration whose inputs look like plain numbers: does u close over a "
                "traced value that it does not use at t0?\n  fix: pass that value through params or a table"
            )
        return self.most

    def run(self, stepper: Stepper, y: Blocks, record: bool) -> Run:
        stops = self.steps[None]
        if self.at is not None:
            stops = jnp.concatenate([self.at.index.astype(stops.dtype), stops])
        now, found = small_call(FixedSteps._all_steps, self, stepper, y, stops)
        evaluations, watched = now.evaluations, now.watched
        if watched is not None:
            evaluations = evaluations + watched.evaluations
            watched = watched.after_loop(Packed.of(y).read, now.steps)
        outcome = Outcome(now.code, now.steps, now.steps, evaluations, *self._grid.step(now.steps))
        trail = None if now.every is None else self.trail(None, now.steps, now.every)
        saved = None
        if self.at is not None:
            starts, reached = jax.tree.map(lambda a: a[:-1], found)
            asked = jnp.arange(len(reached)) < self.at.count
            saved = Saved(self.at.index, self._grid.begin(self.at.index)[0], starts, reached & asked, asked)
        return Run(now.y, outcome, saved, None, trail, watched)

    def _all_steps(self, stepper: Stepper, y: Blocks, stops: jax.Array) -> tuple[_Now, Any]:
        """The loops over stops and steps: what they carry at the end, and what is found at every stop."""
        every = put(rows(y, self.bound + 1), 0, y) if self.dense else None
        none, carry = jnp.zeros((), stops.dtype), stepper.method.before(stepper.dynamics, y)
        start = _Now(none, y, carry, none, jnp.zeros((), int), every, self._slopes(stepper, y, carry), None)
        if self.watch is not None:
            advance = functools.partial(self._advance, stepper, start)
            watched = self.watch.begin(advance, stepper, *self._grid.step(none), Packed.of(y))
            start = start._replace(watched=watched, code=halted_code(watched.halt, start.code))
        kernel = None if every is not None else kernel_steps(stepper, self._grid, none, (y, carry, start.slopes))

        def in_kernel(now: _Now, stop: jax.Array) -> _Now:
            assert kernel is not None
            state = now.y, now.carry, now.slopes
            (y, carry, slopes), steps = kernel.run(stepper, self._grid, now.steps, stop, state)
            halted = steps < stop
            tried = steps - now.steps + halted.astype(steps.dtype)
            evaluations = now.evaluations + tried * kernel.evaluations
            return now._replace(
                steps=steps,
                y=y,
                carry=carry,
                slopes=slopes,
                evaluations=evaluations,
                code=jnp.where(halted, Result.NON_FINITE.value, now.code),
            )

        def one_step(now: _Now) -> _Now:
            after = self._one_step(stepper, now) if kernel is None else in_kernel(now, now.steps + 1)
            return after if now.watched is None else self._watched(stepper, now, after)

        def steps_to(now: _Now, stop: jax.Array) -> _Now:
            if kernel is not None and now.watched is None:
                # A loop that halted already stays as it is.
                return in_kernel(now, jnp.where(now.code == Result.SUCCESS.value, stop, now.steps))
            return jax.lax.while_loop(lambda n: (n.steps < stop) & (n.code == Result.SUCCESS.value), one_step, now)

        def so_far(now: _Now) -> tuple[jax.Array, jax.Array, jax.Array]:
            steps = jnp.where(now.code == Result.SUCCESS.value, now.steps, jnp.iinfo(now.steps.dtype).max)
            return steps, stepper.clock(self._grid.begin(now.steps)[0]), now.steps / jnp.maximum(self.steps, 1)

        def to_stop(now: _Now, stop: jax.Array) -> tuple[_Now, tuple[Blocks, jax.Array] | None]:
            if self.meter is None:
                now = steps_to(now, stop)
            else:
                part = jnp.maximum(self.steps // 100, 1).astype(stop.dtype)
                now = self.meter.along(steps_to, now, stop, part, so_far)
            return now, None if self.at is None else (now.y, now.code == Result.SUCCESS.value)

        if self.at is None:
            return to_stop(start, stops[0])
        # The times that fill up the rows are ends, so that the stop after those that were asked for is one.
        return first_rows(to_stop, start, stops, self.at.count + 1, (y, jnp.zeros((), bool)))

    def _one_step(self, stepper: Stepper, now: _Now) -> _Now:
        """The next step; the state stays where it fails."""
        t, h = self._grid.step(now.steps)
        found = stepper.follow(t, now.y, now.carry, h, now.slopes is not None)
        good = all_finite(found.y)
        code = jnp.where(good, Result.SUCCESS.value, Result.NON_FINITE.value)
        if found.solved is not None:
            good = good & found.solved
            code = jnp.where(found.solved, code, Result.NEWTON_FAILED.value)
        kept = jax.tree.map(lambda new, old: jnp.where(good, new, old), found.y, now.y)
        steps = now.steps + good.astype(now.steps.dtype)
        every = None if now.every is None else put(now.every, steps, kept)
        return _Now(
            steps,
            kept,
            found.carry,
            now.evaluations + found.evaluations,
            code,
            every,
            now.slopes and found.slopes,
            now.watched,
        )

    def _slopes(self, stepper: Stepper, y: Blocks, carry: Carry) -> Any:
        """Room for the slopes of a step, where conditions are watched."""
        if self.watch is None:
            return None
        t, h = self._grid.step(jnp.zeros((), int))
        return zeros_like(lambda: stepper.follow(t, y, carry, h, sampled=True).slopes)

    def _watched(self, stepper: Stepper, before: _Now, after: _Now) -> _Now:
        """After a step, or as before it where it meets an event that ends the integration."""
        assert before.watched is not None
        t, h = self._grid.step(before.steps)
        stride = Stride(before.steps, t, h, Packed.of(before.y), Packed.of(after.y), after.slopes)
        advance = functools.partial(self._advance, stepper, before)
        ends = before.steps == 0, before.steps + 1 == self.steps
        watched = watched_along(self.watch, advance, stepper, stride, before.watched, after.steps > before.steps, ends)
        code = halted_code(watched.halt, after.code)
        hit = code != after.code
        steps, y = jax.tree.map(lambda a, b: jnp.where(hit, a, b), (before.steps, before.y), (after.steps, after.y))
        return after._replace(steps=steps, y=y, code=code, watched=watched)

    def _advance(self, stepper: Stepper, now: _Now, h: jax.Array) -> Packed:
        """The packed state after one more step of another length, by the kernel of the loop where it has one."""
        t, _ = self._grid.step(now.steps)
        none, carry = jnp.zeros_like(now.steps), stepper.method.before(stepper.dynamics, now.y)
        grid, state = self._grid.one_step(t, h), (now.y, carry, now.slopes)
        kernel = kernel_steps(stepper, grid, none, state)
        if kernel is None:
            return Packed.of(stepper.advance(t, now.y, h))
        (moved, _, _), count = kernel.run(stepper, grid, none, none + 1, state)
        packed = Packed.of(moved)
        return Packed(jnp.where(count > 0, packed.flat, jnp.nan), packed.read)

    def steps_of(self, path: None) -> Part:
        t, h = self._grid.step(jnp.arange(self.bound))
        return Part(t, jnp.broadcast_to(h, t.shape))

    def parts(self, path: None, saved: Saved) -> Part:
        t, from_jump = self._grid.begin(saved.steps)
        h = self.at.share * self.h
        if self.splits is not None:
            since = self.saved_times - t
            # Nothing is left to do where a saved time is a jump, but the jump may move.
            since = since - jnp.where(self.at.on, jax.lax.stop_gradient(since), 0.0)
            h = jnp.where(from_jump, since, h)
        return Part(t, h)

    @property
    def saved_times(self) -> jax.Array:
        return jnp.asarray(self.at.ts)

    @property
    def _grid(self) -> Grid:
        return Grid(jnp.asarray(self.t0), jnp.asarray(self.h), self.splits)


def zeros_like(function: Any) -> Any:
    """Zeros of the shapes of what a function would give."""
    return jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(function))


def all_finite(tree: Any) -> jax.Array:
    """Whether every entry is finite. One reduction: XLA would compute a chain of tests again at every reader."""
    return jnp.isfinite(ravel_pytree(tree)[0]).all()
