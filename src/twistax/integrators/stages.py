"""The stages of an explicit Runge-Kutta method: one loop for every tableau, on any pytree of slopes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from .tableau import ButcherTableau

__all__ = ["Slopes", "stage_slopes"]


class Slopes:
    """The slopes of all stages, one a row, and how to read a row as the pytree it is."""

    def __init__(self, rows: jax.Array, read: Callable[[jax.Array], Any]) -> None:
        self.rows = rows
        self.read = read

    def combine(self, weights: Any, h: jax.Array) -> Any:
        """h sum_i weights[i] k_i over the stages there are."""
        return self.read(h * _weighted(jnp.asarray(weights[: len(self.rows)], self.rows.dtype), self.rows))


def stage_slopes(
    tableau: ButcherTableau, slope: Callable[[jax.Array, Any], Any], first: Any, t: jax.Array, h: jax.Array
) -> Slopes:
    """k_1, k_2, ... with k_i = slope(t + c_i h, h sum_j a_ij k_j) and k_1 = first, by a loop over the stages.

    The loop is traced once whatever the tableau: a step of thirteen stages compiles as fast as one of four, and as one
    small function it runs as fast as written out. Stages that are still to come count zero, and stages after the last
    one that b counts are left out. Pure and traceable, and differentiable both ways.
    """
    start, read = ravel_pytree(first)
    count = tableau.counted_stages
    a, c = (jnp.asarray(table, start.dtype) for table in (tableau.a[1:count, :count], tableau.c[1:count]))
    rows = jnp.zeros((count, start.size), start.dtype).at[0].set(start)

    def stage(rows: jax.Array, entry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        number, weights, node = entry
        found = slope(t + node * h, read(h * _weighted(weights, rows)))
        return rows.at[number].set(ravel_pytree(found)[0]), None

    if count > 1:
        rows, _ = jax.lax.scan(stage, rows, (jnp.arange(1, count), a, c))
    return Slopes(rows, read)


def _weighted(weights: jax.Array, rows: jax.Array) -> jax.Array:
    """weights @ rows as a sum: a product of matrices may call a library, or lose digits on an accelerator."""
    return jnp.sum(weights[:, None] * rows, axis=0)
