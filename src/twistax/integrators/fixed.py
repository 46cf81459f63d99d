"""Equal steps."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.small_call import small_call
from .charts.coordinates import Blocks
from .events import Watched
from .kernels import KernelSteps, kernel_steps
from .method import Carry, Stepper
from .solution import Result
from .steps import Outcome, Part, Run, Saved, Steps, all_finite, check_saves, put, rows, span_of

__all__ = ["FixedSteps", "fixed_steps"]

#: A saved time this close to a step, in steps, counts as on it: far more than round-off, far less than anyone means.
_SNAP = 1e-9


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Saves:
    """Saved times: each lies `share` of a step after grid point `index`.

    Attributes:
        ts: (n,) the times.
        index: (n,) whole steps before each.
        share: (n,) in [0, 1].
    """

    ts: Any
    index: Any
    share: Any


class _Now(NamedTuple):
    """What the loop carries: steps taken, the stored state, what the method carries, evaluations, the number of the
    result so far, the states so far if kept, and the conditions if there are any.
    """

    steps: jax.Array
    y: Blocks
    carry: Carry
    evaluations: jax.Array
    code: jax.Array
    every: Blocks | None
    watched: Watched | None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FixedSteps(Steps):
    """Equal steps from t0; the loop ends at the start of a step that fails.

    Attributes:
        t0, h: start and length of a step.
        steps: their number.
        at: where the saved times fall; None where there are none.
        most: their number as structure, which derivatives and dense output need; else None.
        dense: whether the starts of all steps are kept.
        watch: the conditions that end the integration.
    """

    t0: Any
    h: Any
    steps: Any
    at: _Saves | None
    most: int | None = dataclasses.field(metadata={"static": True})
    dense: bool = dataclasses.field(metadata={"static": True})
    watch: Any = None

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
            saved = Saved(self.at.index, self._time(self.at.index), starts, reached)
        return Run(now.y, outcome, saved, None, trail, now.watched)

    def _all_steps(self, stepper: Stepper, y: Blocks, stops: jax.Array) -> tuple[_Now, Any]:
        """The loops over stops and steps: what they carry at the end, and what is found at every stop."""
        every = put(rows(y, self.bound + 1), 0, y) if self.dense else None
        none, carry = jnp.zeros((), stops.dtype), stepper.method.before(stepper.dynamics, y)
        watched = None if self.watch is None else self.watch.begin(stepper, self.t0, self.h, y)
        start = _Now(none, y, carry, none, jnp.zeros((), int), every, watched)
        kernel = None
        if every is None and watched is None:
            kernel = kernel_steps(stepper, self.t0, self.h, none, y, carry)

        def to_stop(now: _Now, stop: jax.Array) -> tuple[_Now, tuple[Blocks, jax.Array] | None]:
            if kernel is None:
                now = jax.lax.while_loop(
                    lambda n: (n.steps < stop) & (n.code == Result.SUCCESS.value),
                    lambda n: self._one_step(stepper, n),
                    now,
                )
            else:
                now = self._by_kernel(kernel, stepper, now, stop)
            return now, None if self.at is None else (now.y, now.code == Result.SUCCESS.value)

        return jax.lax.scan(to_stop, start, stops)

    def _one_step(self, stepper: Stepper, now: _Now) -> _Now:
        """The next step; the state stays where it fails or meets an event."""
        t = self._time(now.steps)
        found = stepper.follow(t, now.y, now.carry, self.h)
        good = all_finite(found.y)
        code = jnp.where(good, Result.SUCCESS.value, Result.NON_FINITE.value)
        if found.solved is not None:
            good = good & found.solved
            code = jnp.where(found.solved, code, Result.NEWTON_FAILED.value)
        watched = None
        if now.watched is not None:
            first, last = now.steps == 0, now.steps + 1 == self.steps
            watched = self.watch.after(stepper, t, self.h, found.y, now.watched, first, last)
            hit = good & watched.hits.any()
            watched = watched._replace(values=jnp.where(hit, now.watched.values, watched.values))
            code, good = jnp.where(hit, Result.EVENT.value, code), good & ~hit
        kept = jax.tree.map(lambda new, old: jnp.where(good, new, old), found.y, now.y)
        steps = now.steps + good.astype(now.steps.dtype)
        every = None if now.every is None else put(now.every, steps, kept)
        return _Now(steps, kept, found.carry, now.evaluations + found.evaluations, code, every, watched)

    def _by_kernel(self, kernel: KernelSteps, stepper: Stepper, now: _Now, stop: jax.Array) -> _Now:
        """All steps up to a stop at once; a loop that halted already stays as it is."""
        stop = jnp.where(now.code == Result.SUCCESS.value, stop, now.steps)
        y, carry, steps = kernel.run(stepper, self.t0, self.h, now.steps, stop, now.y, now.carry)
        halted = steps < stop
        tried = steps - now.steps + halted.astype(steps.dtype)
        code = jnp.where(halted, Result.NON_FINITE.value, now.code)
        return now._replace(
            steps=steps, y=y, carry=carry, evaluations=now.evaluations + tried * kernel.evaluations, code=code
        )

    def steps_of(self, path: None) -> Part:
        k = jnp.arange(self.bound)
        return Part(self._time(k), jnp.broadcast_to(self.h, k.shape))

    def parts(self, path: None, saved: Saved) -> Part:
        assert self.at is not None  # else there would be nothing saved
        return Part(self._time(saved.steps), self.at.share * self.h)

    @property
    def saved_times(self) -> jax.Array:
        assert self.at is not None  # else there would be nothing saved
        return self.at.ts

    def _time(self, k: jax.Array) -> jax.Array:
        """The start of step k, computed afresh so that it does not drift."""
        return self.t0 + k.astype(self.t0.dtype) * self.h

    def too_long(self, h: float) -> tuple[str, str]:
        cause = f"the step {h:.6g} s is too long for rates this fast, or the solution itself grows without bound"
        return cause, "try a smaller dt"

    def not_solved(self, h: float) -> tuple[str, str]:
        cause = f"rates change too much within the step of {h:.6g} s for Newton's method, or they jump"
        return cause, "try a smaller dt, or steps chosen by tolerances: rtol=..., atol=..."


def fixed_steps(
    t0: Any, t1: Any, dt: Any, steps: Any, save_at: Any, dtype: Any, *, bounded: bool, dense: bool, watch: Any
) -> FixedSteps:
    """Equal steps from t0 to t1, (t1 - t0) / dt rounded to whole ones, at least one, or `steps` of them.

    Args:
        bounded: whether the number of steps is to be structure too.
    Raises:
        InputError: what `span_of` and `check_saves` raise; dt and steps both or neither; traced times with dt, for
            which the number of steps would not be known.
    """
    if (dt is None) == (steps is None):
        raise InputError("give either dt, the length of a step, or steps, their number; or rtol for adaptive steps")
    span = span_of(t0, t1, dt)
    if steps is None:
        if span is None or is_traced(dt):
            raise InputError(
                "t0, t1 or dt is traced (inside jit, grad or vmap), so the number of steps is not known.\n"
                "  fix: give steps=<whole number> instead of dt; the step is then (t1 - t0) / steps"
            )
        length = span[1] - span[0]
        steps = max(1, round(length / float(dt))) if length else 0
    elif isinstance(steps, bool) or not isinstance(steps, int) or steps < 1:
        raise InputError(f"steps must be a positive whole number, got {steps!r}")
    start, end = jnp.asarray(t0, dtype), jnp.asarray(t1, dtype)
    h = jnp.asarray((span[1] - span[0]) / max(steps, 1), dtype) if span else (end - start) / steps
    at = None
    if save_at is not None:
        known = check_saves(save_at, span)
        at = _places(save_at, span, steps, dtype) if known else _traced_places(save_at, start, h, steps)
    return FixedSteps(start, h, jnp.asarray(steps), at, steps if bounded or dense else None, dense, watch)


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
    return _Saves(jnp.asarray(times, dtype), jnp.asarray(index, int), jnp.asarray(share, dtype))


def _traced_places(save_at: Any, start: jax.Array, h: jax.Array, steps: int) -> _Saves:
    """The same where times are traced."""
    ts = jnp.asarray(save_at, start.dtype)
    place = (ts - start) / jnp.where(h > 0.0, h, 1.0)
    before = jnp.clip(jnp.floor(jax.lax.stop_gradient(place)), 0, max(steps - 1, 0))
    return _Saves(ts, before.astype(int), place - before)
