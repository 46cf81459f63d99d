"""How an integration goes from its start to its end: the loop over steps; equal steps; what times may be given."""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import number, real_array, short, whole
from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.dynamics import Arrays
from ..lowering.small_call import small_call
from ..units import Quantity, same_unit, seconds
from .charts import Blocks
from .kernels import beside, kernel_steps
from .meter import Meter
from .method import Carry, Stepper
from .rows import first_rows, put, rows
from .run import Outcome, Part, Result, Run, Saved, Trail, Watched

#: A saved time this close to a step, in steps, counts as on it: far more than round-off, far less than anyone means.
_SNAP = 1e-9


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

    def advance(self, stepper: Stepper, carry: Any, t: jax.Array, y: Any, h: jax.Array) -> Any:
        """The stored state after one more step: by the kernel of the loop where it has one.

        Traceable, not differentiable.

        Args:
            carry, y: what the method carries there, and the state, as `run` left them.
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


class _Saves(NamedTuple):
    """Saved times: each lies `share` of a step after grid point `index`."""

    ts: Any  # (n,) the times
    index: Any  # (n,) whole steps before each
    share: Any  # (n,) in [0, 1]
    count: Any  # how many were asked for; those that fill up the rest are at the end


class _Now(NamedTuple):
    """What the loop carries."""

    steps: jax.Array  # taken so far
    y: Blocks
    carry: Carry
    evaluations: jax.Array
    code: jax.Array  # the number of the result so far
    every: Blocks | None  # the states so far if kept
    watched: Watched | None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FixedSteps(Steps):
    """Equal steps from t0; the loop ends at the start of a step that fails."""

    t0: Any
    h: Any  # the length of a step
    steps: Any  # their number
    at: Any  # the `_Saves`, where the saved times fall; None where there are none
    #: The number of steps as structure, which derivatives and dense output need; else None.
    most: int | None = dataclasses.field(metadata={"static": True})
    dense: bool = dataclasses.field(metadata={"static": True})
    watch: Any = None
    meter: Meter | None = None

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
        outcome = Outcome(now.code, now.steps, now.steps, now.evaluations, self._time(now.steps), self.h)
        trail = None if now.every is None else self.trail(None, now.steps, now.every)
        saved = None
        if self.at is not None:
            starts, reached = jax.tree.map(lambda a: a[:-1], found)
            asked = jnp.arange(len(reached)) < self.at.count
            saved = Saved(self.at.index, self._time(self.at.index), starts, reached & asked, asked)
        return Run(now.y, outcome, saved, None, trail, now.watched)

    def _all_steps(self, stepper: Stepper, y: Blocks, stops: jax.Array) -> tuple[_Now, Any]:
        """The loops over stops and steps: what they carry at the end, and what is found at every stop."""
        every = put(rows(y, self.bound + 1), 0, y) if self.dense else None
        none, carry = jnp.zeros((), stops.dtype), stepper.method.before(stepper.dynamics, y)
        watched = None
        if self.watch is not None:
            watched = self.watch.begin(functools.partial(self.advance, stepper, ()), stepper, self.t0, self.h, y)
        start = _Now(none, y, carry, none, jnp.zeros((), int), every, watched)
        kernel = None if every is not None else kernel_steps(stepper, self.t0, self.h, none, y, carry)

        def in_kernel(now: _Now, stop: jax.Array) -> _Now:
            assert kernel is not None
            y, carry, steps = kernel.run(stepper, self.t0, self.h, now.steps, stop, now.y, now.carry)
            halted = steps < stop
            tried = steps - now.steps + halted.astype(steps.dtype)
            evaluations = now.evaluations + tried * kernel.evaluations
            return now._replace(
                steps=steps,
                y=y,
                carry=carry,
                evaluations=evaluations,
                code=jnp.where(halted, Result.NON_FINITE.value, now.code),
            )

        def one_step(now: _Now) -> _Now:
            after = self._one_step(stepper, now) if kernel is None else in_kernel(now, now.steps + 1)
            return after if now.watched is None else beside(FixedSteps._watched, self, stepper, now, after)

        def steps_to(now: _Now, stop: jax.Array) -> _Now:
            if kernel is not None and now.watched is None:
                # A loop that halted already stays as it is.
                return in_kernel(now, jnp.where(now.code == Result.SUCCESS.value, stop, now.steps))
            return jax.lax.while_loop(lambda n: (n.steps < stop) & (n.code == Result.SUCCESS.value), one_step, now)

        def so_far(now: _Now) -> tuple[jax.Array, jax.Array, jax.Array]:
            steps = jnp.where(now.code == Result.SUCCESS.value, now.steps, jnp.iinfo(now.steps.dtype).max)
            return steps, self._time(now.steps), now.steps / jnp.maximum(self.steps, 1)

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
        t = self._time(now.steps)
        found = stepper.method.follow(stepper.field(t, self.h), t, now.y, now.carry, self.h)
        good = all_finite(found.y)
        code = jnp.where(good, Result.SUCCESS.value, Result.NON_FINITE.value)
        if found.solved is not None:
            good = good & found.solved
            code = jnp.where(found.solved, code, Result.NEWTON_FAILED.value)
        kept = jax.tree.map(lambda new, old: jnp.where(good, new, old), found.y, now.y)
        steps = now.steps + good.astype(now.steps.dtype)
        every = None if now.every is None else put(now.every, steps, kept)
        return _Now(steps, kept, found.carry, now.evaluations + found.evaluations, code, every, now.watched)

    def _watched(self, stepper: Stepper, before: _Now, after: _Now) -> _Now:
        """After a step, or as before it with what is known of the event that it met."""
        assert before.watched is not None
        first, last = before.steps == 0, before.steps + 1 == self.steps
        t = self._time(before.steps)
        watched = self.watch.after(stepper, t, self.h, after.y, before.watched, first, last)
        hit = (after.steps > before.steps) & watched.hits.any()
        watched = watched._replace(values=jnp.where(hit, before.watched.values, watched.values))

        def pick(old: Any, new: Any) -> Any:
            return jax.tree.map(lambda a, b: jnp.where(hit, a, b), old, new)

        return after._replace(
            steps=pick(before.steps, after.steps),
            y=pick(before.y, after.y),
            code=jnp.where(hit, Result.EVENT.value, after.code),
            watched=watched,
        )

    def advance(self, stepper: Stepper, carry: Carry, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        none, carry = jnp.zeros_like(jnp.asarray(self.steps)), stepper.method.before(stepper.dynamics, y)
        kernel = kernel_steps(stepper, t, h, none, y, carry)
        if kernel is None:
            return stepper.advance(t, y, h)
        moved, _, count = kernel.run(stepper, t, h, none, none + 1, y, carry)
        return jax.tree.map(lambda a: jnp.where(count > 0, a, jnp.nan), moved)

    def steps_of(self, path: None) -> Part:
        k = jnp.arange(self.bound)
        return Part(self._time(k), jnp.broadcast_to(self.h, k.shape))

    def parts(self, path: None, saved: Saved) -> Part:
        return Part(self._time(saved.steps), self.at.share * self.h)

    @property
    def saved_times(self) -> jax.Array:
        return jnp.asarray(self.at.ts)

    def _time(self, k: jax.Array) -> jax.Array:
        """The start of step k, computed afresh so that it does not drift."""
        return self.t0 + k.astype(self.t0.dtype) * self.h


def all_finite(tree: Any) -> jax.Array:
    """Whether every entry is finite. One reduction: XLA would compute a chain of tests again at every reader."""
    return jnp.isfinite(ravel_pytree(tree)[0]).all()


# ---- what a user asked for ----------------------------------------------------------------------------------------


def span_of(t0: Any, t1: Any, dt: Any) -> tuple[float, float] | None:
    """(t0, t1) as plain numbers, None where they are traced. Raises InputError for times or a dt that make no sense."""
    for name, value in (("t0", t0), ("t1", t1), ("dt", dt)):
        if isinstance(value, Quantity):
            same_unit(name, value, seconds)
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
    same_unit("save_at", save_at, seconds)
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


def fixed_steps(
    t0: Any,
    t1: Any,
    span: Any,
    dt: Any,
    steps: Any,
    save_at: Any,
    count: Any,
    dtype: Any,
    *,
    bounded: bool,
    dense: bool,
    watch: Any,
) -> FixedSteps:
    """Equal steps from t0 to t1, (t1 - t0) / dt rounded to whole ones, at least one, or `steps` of them.

    Args:
        count: how many of the saved times are asked for.
        bounded: their number is to be structure too.
    Raises:
        InputError: neither dt nor steps, or both, or times that are not known.
    """
    if (dt is None) == (steps is None):
        raise InputError("give either dt, the length of a step, or steps, their number; or rtol for adaptive steps")
    if steps is None:
        if span is None or is_traced(dt):
            raise InputError(
                "t0, t1 or dt is traced (inside jit, grad or vmap), so the number of steps is not known.\n"
                "  fix: give steps=<whole number> instead of dt; the step is then (t1 - t0) / steps"
            )
        length = span[1] - span[0]
        steps = max(1, round(_countable(length / float(dt)))) if length else 0
    else:
        steps = _countable(whole("steps", steps))
    array: Any = jnp if span is None else np  # known numbers are made arrays of JAX where they are used, all at once
    start, end = array.asarray(t0, dtype), array.asarray(t1, dtype)
    h = np.asarray((span[1] - span[0]) / max(steps, 1), dtype) if span else (end - start) / steps
    at = None
    if save_at is not None:
        known = span is not None and not is_traced(save_at)
        at = _places(save_at, span, steps, dtype) if known else _traced_places(save_at, start, h, steps)
        at = at._replace(count=count)
    return FixedSteps(start, h, np.asarray(steps), at, steps if bounded or dense else None, dense, watch)


def _countable(steps: Any) -> Any:
    """A number of steps, if JAX's integers hold it: beyond them it would wrap. Raises InputError."""
    most = np.iinfo(jax.dtypes.canonicalize_dtype(np.int64)).max
    if steps > most:
        raise InputError(
            f"{short(steps)} steps are more than the {most} that can be counted.\n"
            '  fix: longer steps; without them jax.config.update("jax_enable_x64", True) counts to 9e18'
        )
    return steps


def _places(save_at: Any, span: Any, steps: int, dtype: Any) -> _Saves:
    """Where known times fall on a grid of known times."""
    times = np.asarray(save_at, float)
    start, end = span
    length = (end - start) / max(steps, 1) or 1.0
    position = (times - start) / length
    nearest = np.rint(position)
    # What counts as on the grid allows for the precision the times came in.
    eps = np.finfo(given).eps if (given := np.asarray(save_at).dtype).kind == "f" else 0.0
    slack = np.maximum(_SNAP, 4 * eps * np.maximum(np.abs(times), abs(start)) / length)
    snapped = np.abs(position - nearest) <= slack
    index = np.clip(np.where(snapped, nearest, np.floor(position)), 0, steps)
    share = np.where(snapped, 0.0, position - index)
    return _Saves(times.astype(dtype), index.astype(int), share.astype(dtype), None)


def _traced_places(save_at: Any, start: Any, h: Any, steps: int) -> _Saves:
    """The same where times are traced."""
    ts = jnp.asarray(save_at, start.dtype)
    place = (ts - start) / jnp.where(h > 0.0, h, 1.0)
    before = jnp.clip(jnp.floor(jax.lax.stop_gradient(place)), 0, max(steps - 1, 0))
    return _Saves(ts, before.astype(int), place - before, None)
