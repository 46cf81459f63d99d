"""The times of an integration: start, end, saved times, limits of steps, and fixed steps between them."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import number, real_array, short, whole
from ..errors import InputError
from ..jax_inside import is_traced
from ..system.inputs import is_finite, need_representable
from ..units import Quantity, same_unit, seconds
from .controls import Signals
from .loop.fixed_steps import FixedSteps, Saves, Splits, slack, splits_of


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
    return float(t0), float(t1)


def direction_of(t0: Any, t1: Any, dtype: Any) -> Any:
    """1.0, or -1.0 where the end lies before the start: times by it grow along the integration."""
    array: Any = jnp if is_traced((t0, t1)) else np
    return array.where(array.asarray(t1, dtype) < array.asarray(t0, dtype), -1.0, 1.0).astype(dtype)


def check_saves(save_at: Any, span: tuple[float, float] | None) -> bool:
    """Check saved times as far as they are known; returns whether they are. Raises InputError."""
    same_unit("save_at", save_at, seconds)
    array = real_array("save_at", save_at)
    if array.ndim != 1 or array.size == 0:
        raise InputError(f"save_at expects times with shape (n,), n >= 1, got shape {array.shape}")
    if span is None or is_traced(array):
        return False
    times = np.asarray(array, float)
    start, end = span
    if not np.isfinite(times).all():
        raise InputError(f"save_at expects finite times, got {short(times)}")
    sign = -1.0 if end < start else 1.0
    if (wrong := sign * np.diff(times) < 0).any():
        i = int(np.argmax(wrong))
        raise InputError(f"save_at must be sorted from t0 to t1, got {times[i]:g} before {times[i + 1]:g}")
    low, high = min(start, end), max(start, end)
    room = 1e-6 * (high - low)
    if (outside := (times < low - room) | (times > high + room)).any():
        worst = times[int(np.argmax(outside))]
        raise InputError(f"save_at must lie inside [t0, t1] = [{start:g}, {end:g}], got {worst:g}")
    return True


def fixed_steps(
    start: Any, end: Any, span: Any, options: Any, save_at: Any, limits: Any, *, count: Any, bounded: bool, events: Any
) -> FixedSteps:
    """Equal steps from start to end, their distance by dt rounded to whole ones, at least one, or `steps` of them.

    All times are those of the clock of the loop over steps, which goes forward.

    Args:
        span: the times where they are known numbers.
        options: `dt`, `steps` and `dense`.
        limits: the times where a step must end, in order, the last one the end.
        count: how many of the saved times are asked for; the rest is padding.
        bounded: whether the number of steps is part of the structure.
    Raises:
        InputError: neither dt nor steps, or both, or times that are not known.
    """
    dt, steps, dtype = options.dt, options.steps, start.dtype
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
    start, end = array.asarray(start), array.asarray(end)
    h = np.asarray((span[1] - span[0]) / max(steps, 1), dtype) if span else (end - start) / steps
    splits, more = splits_of(limits[:-1], start, h, steps)
    at = None
    if save_at is not None:
        known = span is not None and not is_traced(save_at)
        at = _places(save_at, span, steps, dtype) if known else _traced_places(save_at, start, h, steps)
        at = dataclasses.replace(_beyond_jumps(at, splits, start, h), count=count)
    array = jnp if is_traced(more) else np
    # What jumps add is a number; the bound has room for all of them.
    most = steps + np.size(limits) - 1 if bounded else None
    return FixedSteps(start, h, array.asarray(steps + more), at, most, options.dense, events, splits=splits)


def _countable(steps: Any) -> Any:
    """A number of steps, if JAX's integers hold it: beyond them it would wrap. Raises InputError."""
    most = np.iinfo(jax.dtypes.canonicalize_dtype(np.int64)).max
    if steps > most:
        raise InputError(
            f"{short(steps)} steps are more than the {most} that can be counted.\n"
            '  fix: longer steps; without them jax.config.update("jax_enable_x64", True) counts to 9e18'
        )
    return steps


def _places(save_at: Any, span: Any, steps: int, dtype: Any) -> Saves:
    """Where known times fall on a grid of known times."""
    times = np.asarray(save_at, float)
    start, end = span
    length = (end - start) / max(steps, 1) or 1.0
    position = (times - start) / length
    nearest = np.rint(position)
    # What counts as on the grid allows for the precision the times came in.
    eps = float(np.finfo(dtype_in).eps) if (dtype_in := np.asarray(save_at).dtype).kind == "f" else 0.0
    near = slack(np.maximum(np.abs(times), abs(start)), length, eps) / length
    snapped = np.abs(position - nearest) <= near
    index = np.clip(np.where(snapped, nearest, np.floor(position)), 0, steps)
    share = np.where(snapped, 0.0, position - index)
    return Saves(times.astype(dtype), index.astype(int), share.astype(dtype), share == 0.0, None)


def _traced_places(save_at: Any, start: Any, h: Any, steps: int) -> Saves:
    """`_places` of traced times."""
    ts = jnp.asarray(save_at, start.dtype)
    place = (ts - start) / jnp.where(h > 0.0, h, 1.0)
    before = jnp.clip(jnp.floor(jax.lax.stop_gradient(place)), 0, max(steps - 1, 0))
    return Saves(ts, before.astype(int), place - before, place == before, None)


def _beyond_jumps(at: Saves, splits: Splits | None, start: Any, h: Any) -> Saves:
    """The places, moved on by the steps that jumps add before them."""
    if splits is None:
        return at
    array: Any = jnp if is_traced((at, splits, start, h)) else np
    slots, times, added = map(array.asarray, jax.lax.stop_gradient(tuple(splits)) if array is jnp else splits)
    ts = array.asarray(jax.lax.stop_gradient(at.ts) if array is jnp else at.ts)
    # Jumps at the ends of equal steps add none, and are no places within one.
    inside = (array.diff(added, prepend=0) > 0) & (slots < np.iinfo(slots.dtype).max)
    times = array.sort(array.where(inside, times, np.inf))
    near = slack(ts, h, float(np.finfo(times.dtype).eps))
    past = array.searchsorted(times, ts + near, side="right")
    there = array.searchsorted(times, ts - near, side="left") < past
    return dataclasses.replace(at, index=at.index + past.astype(slots.dtype), on=there | at.on)


#: So many numbers are written in no time.
_LIGHT = 2**15


class Stops(NamedTuple):
    """Where the loop over steps halts, at saved times, which a step may pass; and limits, where a step must end."""

    limits: Any  # (m,) times in order, the last one the end; rates may jump there
    ts: Any  # (n,) the saved times in order, infinite where rows stay as they are; None if no times are saved
    count: Any  # how many of these were asked for; those that fill up the rest are at the end

    @classmethod
    def of(cls, limits: Any, t0: Any, save_at: Any, count: Any) -> Stops:
        """The stops of limits, the last one the end, and of saved times."""
        if save_at is None:
            return cls(limits, None, 0)
        array: Any = jnp if is_traced((limits, t0, save_at)) else np
        saves, t1 = array.asarray(save_at, t0.dtype), limits[-1]
        return cls(limits, array.where(saves < t0, t0, array.where((saves > t1) & (saves < np.inf), t1, saves)), count)

    def next_limit(self, t: jax.Array) -> jax.Array:
        """The next limit after a time."""
        return jnp.where(self.limits > t, self.limits, self.limits[-1]).min()

    def leg(self, t0: Any, number: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Start and length of the leg between two limits, the first one from t0."""
        start = jnp.where(number == 0, t0, self.limits[jnp.maximum(number - 1, 0)])
        return start, self.limits[number] - start


def limits_of(t0: Any, t1: Any, jumps: Any, signals: Signals, direction: Any) -> Any:
    """(m,) the times at which a step must end, in order: jumps that a user named, those of tables, and the end.

    Args:
        t0, t1: start and end, on the clock of the loop over steps: times in s by the direction.
    Raises:
        InputError: jumps that are no sorted, finite times.
    """
    if jumps is not None:
        same_unit("jumps", jumps, seconds)
        array_of_jumps = real_array("jumps", jumps)
        falls = (
            not is_traced(array_of_jumps)
            and array_of_jumps.ndim == 1
            and bool((np.diff(np.asarray(array_of_jumps)) < 0).any())
        )
        if array_of_jumps.ndim != 1 or not is_finite(array_of_jumps) or falls:
            raise InputError(f"jumps expects finite, sorted times with shape (n,), got {jumps!r}")
        need_representable("jumps", array_of_jumps, t0.dtype)
    known = [*signals.jumps, *([] if jumps is None else [jumps])]
    # Known times are sorted by NumPy: JAX would run each of these operations by itself, in tens of microseconds.
    array: Any = jnp if is_traced((t0, t1, known)) else np
    t1 = array.asarray(t1, t0.dtype)

    def inside(ts: Any) -> Any:
        # Not jnp.clip, whose derivative is halved where a time is exactly an end. A jump there moves with the end.
        ts = direction * array.asarray(ts, t0.dtype)
        return array.where(ts <= t0, t0, array.where(ts >= t1, t1, ts))

    if not known:
        return t1[None]
    limits = array.append(array.sort(array.concatenate([inside(ts) for ts in known])), t1)
    # Limits that coincide move together: none of the legs between them has a step, so that the derivatives of
    # the two ends of each must be the same. Half of what both do goes to the first, half to the last.
    first, last = (array.searchsorted(limits, limits, side=side) for side in ("left", "right"))
    return 0.5 * (limits[first] + limits[last - 1])


def room_for(count: int, width: int) -> int:
    """How many rows of so many numbers to make room for, so that another count mostly compiles nothing anew.

    Up to eight times as many where they are light, else up to twice as many.
    """
    room = 64
    while room < count:
        room *= 8 if room * width < _LIGHT else 2
    return room


def filled(save_at: Any, t1: Any, width: int) -> Any:
    """Known saved times with the end behind them, as many as there is room for."""
    times = np.asarray(save_at)
    room, kind = room_for(len(times), width), times.dtype if times.dtype.kind == "f" else float
    return np.append(times.astype(kind), np.full(room - len(times), float(t1), kind))
