"""NaN values and derivatives for states that an integration did not reach."""

from __future__ import annotations

import functools
from typing import TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def nan_unless(good: jax.Array, tree: Tree) -> Tree:
    """The arrays if they are good, else NaN, in values and derivatives (`jnp.where` would have zero derivatives).

    In reverse mode the derivative with respect to values that do not count, such as rows that a loss ignores, remains
    zero. Traceable, differentiable to any order.

    Args:
        good: a truth value, or one for each row of all arrays.
    """

    def wide(like: jax.Array) -> jax.Array:
        return good.reshape(good.shape + (1,) * (like.ndim - good.ndim))

    def forward(_: object, value: jax.Array) -> jax.Array:
        return jnp.where(wide(value), value, jnp.nan)

    def back(_: object, slope: jax.Array) -> jax.Array:
        return jnp.where(wide(slope) | (slope == 0.0), slope, jnp.nan)

    def of(value: jax.Array) -> jax.Array:
        # A linear map whose transpose is not that of a product with NaN.
        result: jax.Array = jax.lax.custom_linear_solve(lambda x: x, value, forward, back)
        return result

    good = jax.lax.stop_gradient(good)
    values: Tree = jax.tree.map(of, tree)
    return values


def zero_of(tree: object) -> jax.Array:
    """Zero as a linear function of all floating-point arrays, such that NaN propagates to each
    of them in reverse mode.
    """
    parts = [0.0 * a.sum() for a in jax.tree.leaves(tree)]
    return functools.reduce(jnp.add, parts)
