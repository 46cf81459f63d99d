"""Pytrees of numbers in loops: whether all are finite, kept in one array, rows that are filled one by one."""

from __future__ import annotations

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..lowering.small_call import inside_small_call

__all__ = ["all_finite", "held", "put", "rows"]

Tree = TypeVar("Tree")


def all_finite(tree: Any) -> jax.Array:
    """Whether every entry of a pytree is finite. Traceable.

    One reduction of all entries: XLA would compute a chain of scalar tests again at every place that reads the result.
    """
    return jnp.isfinite(ravel_pytree(tree)[0]).all()


def held(tree: Tree) -> Tree:
    """The same numbers, kept in one array. Inside a small function XLA else computes scalars anew at every reader."""
    if not inside_small_call():
        return tree
    packed, read = ravel_pytree(tree)
    kept: Tree = read(jax.lax.optimization_barrier(packed))
    return kept


def rows(like: Any, count: int) -> Any:
    """Zeros with a leading axis in front of every leaf of a pytree."""
    return jax.tree.map(lambda a: jnp.zeros((count, *a.shape), a.dtype), like)


def put(table: Any, row: Any, value: Any) -> Any:
    """The table with one row of every leaf set."""
    return jax.tree.map(lambda a, b: a.at[row].set(jnp.asarray(b, a.dtype)), table, value)
