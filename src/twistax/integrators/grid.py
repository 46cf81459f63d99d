"""The grid of a fixed-step integration, and where saved times fall on it."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.inputs import is_finite

__all__ = ["Grid", "Saves", "check_saves", "make_grid", "place_saves", "span_of"]

#: A saved time this close to a step, in steps, counts as on it: far more than round-off, far less than anyone means.
_SNAP = 1e-9


@dataclasses.dataclass(frozen=True)
class Grid:
    """Equal steps from t0 to t1.

    Attributes:
        t0, t1, h: start, end and length of a step in the flight's precision.
        steps: their number.
        span: (t0, t1) as plain numbers, None where they are traced.
    """

    t0: jax.Array
    t1: jax.Array
    h: jax.Array
    steps: int
    span: tuple[float, float] | None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Saves:
    """Saved times: each lies `share` of a step after grid point `index`.

    Attributes:
        ts: (n,) the times.
        index: (n,) whole steps before each.
        share: (n,) in [0, 1].
        off_grid: whether a share may be other than zero.
    """

    ts: Any
    index: Any
    share: Any
    off_grid: bool = dataclasses.field(metadata={"static": True})


def span_of(t0: Any, t1: Any, dt: Any) -> tuple[float, float] | None:
    """(t0, t1) as plain numbers, None where they are traced.

    Raises:
        InputError: a time or dt that is no finite number; t1 before t0; dt not positive.
    """
    for name, value in (("t0", t0), ("t1", t1), ("dt", dt)):
        if value is not None and (np.shape(value) != () or not is_finite(value)):
            raise InputError(f"{name} must be a finite number, got {value!r}")
    if dt is not None and not is_traced(dt) and float(dt) <= 0.0:
        raise InputError(f"dt must be positive, got {float(dt):g}")
    if is_traced((t0, t1)):
        return None
    span = (float(t0), float(t1))
    if span[1] < span[0]:
        raise InputError(f"t1 = {span[1]:g} lies before t0 = {span[0]:g}.\n  fix: integrate forward in time")
    return span


def make_grid(t0: Any, t1: Any, dt: Any, steps: Any, dtype: Any) -> Grid:
    """The grid with (t1 - t0) / dt rounded to whole steps, at least one, or with `steps` steps.

    Raises:
        InputError: what `span_of` raises; dt and steps both or neither; traced times with dt, for which the number of
            steps would not be known.
    """
    if (dt is None) == (steps is None):
        raise InputError("give either dt, the length of a step, or steps, their number")
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
    step = jnp.asarray((span[1] - span[0]) / max(steps, 1), dtype) if span else (end - start) / steps
    return Grid(start, end, step, steps, span)


def place_saves(save_at: Any, grid: Grid, dtype: Any) -> Saves | None:
    """Where the saved times fall; None where none are asked for.

    Raises:
        InputError: not a vector of numbers, not sorted, or outside [t0, t1].
    """
    if save_at is None:
        return None
    if not check_saves(save_at, grid.span) or grid.span is None:
        ts = jnp.asarray(save_at, dtype)
        place = (ts - grid.t0) / jnp.where(grid.h > 0.0, grid.h, 1.0)
        before = jnp.clip(jnp.floor(jax.lax.stop_gradient(place)), 0, max(grid.steps - 1, 0))
        return Saves(ts, before.astype(int), place - before, True)
    times = np.asarray(save_at, float)
    start, end = grid.span
    length = (end - start) / max(grid.steps, 1) or 1.0
    position = (times - start) / length
    nearest = np.rint(position)
    # What counts as on the grid allows for the precision the times came in.
    eps = np.finfo(given).eps if (given := np.asarray(save_at).dtype).kind == "f" else 0.0
    slack = np.maximum(_SNAP, 4 * eps * np.maximum(np.abs(times), abs(start)) / length)
    snapped = np.abs(position - nearest) <= slack
    index = np.clip(np.where(snapped, nearest, np.floor(position)), 0, grid.steps)
    share = np.where(snapped, 0.0, position - index)
    return Saves(jnp.asarray(times, dtype), jnp.asarray(index, int), jnp.asarray(share, dtype), bool(share.any()))


def check_saves(save_at: Any, span: tuple[float, float] | None) -> bool:
    """Check saved times as far as they are known; returns whether they are.

    Raises:
        InputError: not a vector of numbers, not sorted, or outside [t0, t1].
    """
    if np.ndim(save_at) != 1 or np.shape(save_at)[0] == 0:
        raise InputError(f"save_at expects times with shape (n,), n >= 1, got shape {np.shape(save_at)}")
    if span is None or is_traced(save_at):
        return False
    times = np.asarray(save_at, float)
    start, end = span
    if not np.isfinite(times).all():
        raise InputError("save_at has times that are not finite")
    if (np.diff(times) < 0).any():
        i = int(np.argmax(np.diff(times) < 0))
        raise InputError(f"save_at must be sorted, got {times[i]:g} before {times[i + 1]:g}")
    room = 1e-6 * (end - start)
    if times[0] < start - room or times[-1] > end + room:
        worst = times[0] if times[0] < start - room else times[-1]
        raise InputError(f"save_at must lie inside [t0, t1] = [{start:g}, {end:g}], got {worst:g}")
    return True
