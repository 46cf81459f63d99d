"""Rows of results: made room for, written one by one, and only as many visited as were asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

#: So many numbers are written in no time.
_LIGHT = 2**15


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
