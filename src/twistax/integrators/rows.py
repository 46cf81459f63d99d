"""Rows that a loop fills one by one."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["put", "rows"]


def rows(like: Any, count: int) -> Any:
    """Zeros with a leading axis in front of every leaf of a pytree."""
    return jax.tree.map(lambda a: jnp.zeros((count, *a.shape), a.dtype), like)


def put(table: Any, row: Any, value: Any) -> Any:
    """The table with one row of every leaf set."""
    return jax.tree.map(lambda a, b: _put(a, jnp.asarray(row), jnp.asarray(b, a.dtype)), table, value)


@jax.custom_batching.custom_vmap
def _put(table: jax.Array, row: jax.Array, value: jax.Array) -> jax.Array:
    return jax.lax.dynamic_update_index_in_dim(table, value, row, 0)


@_put.def_vmap
def _put_lanes(lanes: int, batched: list[bool], table: Any, row: Any, value: Any) -> tuple[jax.Array, bool]:
    """Lane by lane: rows that differ between lanes would become a scatter, which XLA cannot compile in a small call."""
    table, row, value = (
        a if is_batched else jnp.broadcast_to(a, (lanes, *a.shape))
        for a, is_batched in zip((table, row, value), batched, strict=True)
    )
    count = table.shape[1]
    flat = table.reshape(lanes * count, *table.shape[2:])

    def one(flat: jax.Array, lane: jax.Array) -> tuple[jax.Array, None]:
        return _put(flat, lane * count + row[lane], value[lane]), None

    return jax.lax.scan(one, flat, jnp.arange(lanes))[0].reshape(table.shape), True
