"""The stages of an explicit Runge-Kutta method: one loop for every tableau, on any pytree of slopes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray

from ..lowering.small_call import inside_small_call
from .tableau import Rows

__all__ = ["Slopes", "stage_slopes"]

Aside = TypeVar("Aside")


class Slopes:
    """The slopes of all stages, one a row, and how to read a row as the pytree it is."""

    def __init__(self, rows: jax.Array, read: Callable[[jax.Array], Any]) -> None:
        self.rows = rows
        self.read = read

    def combine(self, weights: Any, h: jax.Array) -> Any:
        """h sum_i weights[i] k_i over the stages there are; stages beyond the weights count zero."""
        known = np.zeros(len(self.rows))
        known[: len(weights)] = weights[: len(self.rows)]
        return self.read(h * _combination(known, self.rows))


def stage_slopes(
    stages: Rows,
    slope: Callable[[jax.Array, Any], tuple[Any, Aside]],
    first: Any,
    aside: Aside,
    t: jax.Array,
    h: jax.Array,
) -> tuple[Slopes, Aside]:
    """k_1, k_2, ... with k_i = slope(t + c_i h, h sum_j a_ij k_j) and k_1 = first, by a loop over the stages.

    The loop is traced once whatever the tableau: a step of thirteen stages compiles as fast as one of four, and as one
    small function it runs as fast as written out. Pure and traceable, and differentiable both ways.

    Args:
        stages: a and c of the stages to run, the first one included.
        slope: gives the slope of a stage and, aside, what of the last stage the caller wants.
        first, aside: both of the first stage.
    Returns:
        The slopes of all stages, and what the last one set aside.
    """
    start, read = ravel_pytree(first)
    a, c = (np.asarray(table) for table in stages)
    count = len(c)
    rows = jnp.zeros((count, start.size), start.dtype).at[0].set(start)
    combination = _combinations(a, start.dtype)

    def stage(carried: tuple[jax.Array, Aside], entry: tuple[jax.Array, jax.Array]) -> tuple[Any, None]:
        rows, _ = carried
        number, node = entry
        found, aside = slope(t + node * h, read(h * combination(number, rows)))
        k = ravel_pytree(found)[0]
        return (jax.lax.dynamic_update_index_in_dim(rows, k, number, 0, allow_negative_indices=False), aside), None

    if count > 1:
        (rows, aside), _ = jax.lax.scan(stage, (rows, aside), (jnp.arange(1, count), jnp.asarray(c[1:], start.dtype)))
    return Slopes(rows, read), aside


def _combinations(a: NDArray[Any], dtype: Any) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """(i, rows) -> sum_j a_ij rows_j, i a traced number.

    Inside a small function a branch for every i, without the zeros of the tableau; elsewhere, where branches are slow,
    a row of weights.
    """
    if inside_small_call():
        branches = [lambda rows, row=row: _sum(row, rows) for row in a[1:]]
        return lambda number, rows: jax.lax.switch(number - 1, branches, rows)
    weights = jnp.asarray(a, dtype)
    return lambda number, rows: _weighted(weights[number], rows)


def _combination(weights: NDArray[Any], rows: jax.Array) -> jax.Array:
    """weights @ rows for known weights; see `_combinations`."""
    return _sum(weights, rows) if inside_small_call() else _weighted(jnp.asarray(weights, rows.dtype), rows)


def _sum(weights: NDArray[Any], rows: jax.Array) -> jax.Array:
    """weights @ rows for weights that are known, term by term."""
    terms = [float(weights[j]) * rows[j] for j in np.flatnonzero(weights)]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros_like(rows[0])


def _weighted(weights: jax.Array, rows: jax.Array) -> jax.Array:
    """weights @ rows as a sum: a product of matrices may call a library, or lose digits on an accelerator."""
    return jnp.sum(weights[:, None] * rows, axis=0)
