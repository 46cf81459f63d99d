"""The stages of an explicit Runge-Kutta method: one loop for every tableau, on any pytree of slopes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

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
        return self.read(h * _weighted(jnp.asarray(known, self.rows.dtype), self.rows))


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
    small function it runs as fast as written out. Stages that are still to come count zero. Pure and traceable, and
    differentiable both ways.

    Args:
        stages: a and c of the stages to run, the first one included.
        slope: gives the slope of a stage and, aside, what of the last stage the caller wants.
        first, aside: both of the first stage.
    Returns:
        The slopes of all stages, and what the last one set aside.
    """
    start, read = ravel_pytree(first)
    a, c = (jnp.asarray(table[1:], start.dtype) for table in stages)
    count = len(a) + 1
    rows = jnp.zeros((count, start.size), start.dtype).at[0].set(start)

    def stage(
        carried: tuple[jax.Array, Aside], entry: tuple[jax.Array, jax.Array, jax.Array]
    ) -> tuple[tuple[jax.Array, Aside], None]:
        rows, _ = carried
        number, weights, node = entry
        found, aside = slope(t + node * h, read(h * _weighted(weights, rows)))
        return (rows.at[number].set(ravel_pytree(found)[0]), aside), None

    if count > 1:
        (rows, aside), _ = jax.lax.scan(stage, (rows, aside), (jnp.arange(1, count), a, c))
    return Slopes(rows, read), aside


def _weighted(weights: jax.Array, rows: jax.Array) -> jax.Array:
    """weights @ rows as a sum: a product of matrices may call a library, or lose digits on an accelerator."""
    return jnp.sum(weights[:, None] * rows, axis=0)
