"""Where the loop over steps halts, and the rows of results it leaves there: room for them, written one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import real_array
from ..errors import InputError
from ..jax_inside import is_traced
from ..system.inputs import is_finite, need_held
from ..units import same_unit, seconds
from .controls import Signals

#: So many numbers are written in no time.
_LIGHT = 2**15


class Stops(NamedTuple):
    """Where the loop over steps halts, at saved times, which a step may pass; and limits, where a step must end."""

    limits: Any  # (m,) times in order, the last one the end; rates may jump there
    ts: Any  # (n,) the saved times in order, infinite where rows stay as they are; None if no times are saved
    count: Any  # how many of these were asked for; those that fill up the rest are at the end

    @classmethod
    def given(cls, limits: Any, t0: Any, save_at: Any, count: Any) -> Stops:
        """The stops of limits, the last one the end, and of saved times."""
        if save_at is None:
            return cls(limits, None, 0)
        array: Any = jnp if is_traced((limits, t0, save_at)) else np
        saves, t1 = array.asarray(save_at, t0.dtype), limits[-1]
        return cls(limits, array.where(saves < t0, t0, array.where((saves > t1) & (saves < np.inf), t1, saves)), count)


def limits_of(t0: Any, t1: Any, jumps: Any, signals: Signals, direction: Any) -> Any:
    """(m,) the times at which a step must end, in order: jumps that a user named, those of tables, and the end.

    Args:
        t0, t1: start and end, on the clock of the loop over steps: times in s by the direction.
    Raises:
        InputError: jumps that are no sorted, finite times.
    """
    if jumps is not None:
        same_unit("jumps", jumps, seconds)
        given = real_array("jumps", jumps)
        falls = not is_traced(given) and given.ndim == 1 and bool((np.diff(np.asarray(given)) < 0).any())
        if given.ndim != 1 or not is_finite(given) or falls:
            raise InputError(f"jumps expects finite, sorted times with shape (n,), got {jumps!r}")
        need_held("jumps", given, t0.dtype)
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


def rows(like: Any, count: int) -> Any:
    """Zeros with a leading axis in front of every leaf of a pytree."""
    return jax.tree.map(lambda a: jnp.zeros((count, *a.shape), a.dtype), like)


def put(table: Any, row: Any, value: Any) -> Any:
    """The table with one row of every leaf set."""
    return jax.tree.map(lambda a, b: a.at[row].set(jnp.asarray(b, a.dtype)), table, value)


def first_rows(
    step: Callable[[Any, Any], Any],
    start: Any,
    given: Any,
    count: Any,
    like: Any,
) -> tuple[Any, Any]:
    """`jax.lax.scan`, which ends after `count` of the rows that are given.

    Args:
        like: the result of a row. Results of rows that are not visited are zero.
    """

    def one(now: tuple[jax.Array, Any, Any]) -> tuple[jax.Array, Any, Any]:
        k, carried, results = now
        carried, found = step(carried, jax.tree.map(lambda a: a[k], given))
        return k + 1, carried, put(results, k, found)

    results = rows(like, jax.tree.leaves(given)[0].shape[0])
    found = jax.lax.while_loop(lambda now: now[0] < count, one, (jnp.zeros((), int), start, results))
    return found[1], found[2]


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
