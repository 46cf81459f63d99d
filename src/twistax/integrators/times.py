"""The saved times of an integration."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import real_array, short
from ..errors import InputError
from ..jax_inside import is_traced
from ..units import same_unit, seconds
from .loop.fixed_steps import FixedSteps, Saves, Splits, slack


def check_saves(save_at: Any, span: tuple[float, float] | None) -> bool:
    """Check saved times if they are known; returns whether they are. Raises InputError for invalid ones."""
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


def with_saves(fixed: FixedSteps, steps: int, save_at: Any, span: Any, count: Any) -> FixedSteps:
    """Equal steps with their saved times.

    Args:
        fixed, steps: the steps, and their number without those that jumps add.
        save_at: the saved times on the clock of the loop.
        span: start and end where they are known numbers.
        count: the number of requested saved times; the rest is padding.
    """
    start, h = fixed.t0, fixed.h
    known = span is not None and not is_traced(save_at)
    at = _places(save_at, span, steps, start.dtype) if known else _traced_places(save_at, start, h, steps)
    at = dataclasses.replace(_beyond_jumps(at, fixed.splits, start, h), count=count)
    return dataclasses.replace(fixed, at=at)


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


#: The time to write so many numbers is negligible.
_LIGHT = 2**15


def room_for(count: int, width: int) -> int:
    """The number of rows to allocate, such that most other counts of rows do not recompile.

    Up to eight times `count` for short rows, else up to twice.
    """
    room = 64
    while room < count:
        room *= 8 if room * width < _LIGHT else 2
    return room


def filled(save_at: Any, t1: Any, width: int) -> Any:
    """Known saved times, padded with the end to `room_for` rows."""
    times = np.asarray(save_at)
    room, kind = room_for(len(times), width), times.dtype if times.dtype.kind == "f" else float
    return np.append(times.astype(kind), np.full(room - len(times), float(t1), kind))
