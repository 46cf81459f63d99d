"""Inverses of small matrices, real and complex, without a library."""

from __future__ import annotations

from typing import TypeAlias

import jax
import jax.numpy as jnp

__all__ = ["Parts", "applied", "inverse", "times"]

#: A real array (a,), or a complex one as real and imaginary part (a, b): complex numbers do not compile everywhere.
Parts: TypeAlias = tuple[jax.Array, ...]

#: Larger matrices are left to a library.
_LARGEST = 24


def inverse(matrix: Parts) -> Parts:
    """The inverse of a square matrix, by Gauss-Jordan elimination with partial pivoting. Pure and traceable.

    An inverse, not factors: products with it are loops over independent numbers, while substitution is a chain. It is
    about as accurate where it serves Newton's method, which looks at residuals. Not a number where the matrix is
    singular.

    Source: Golub, Van Loan, Matrix Computations (2013), sections 3.4 and 3.5.
    """
    if matrix[0].shape[0] > _LARGEST:
        return _by_library(matrix)
    places = jnp.arange(matrix[0].shape[0])

    def eliminate(k: jax.Array, now: tuple[Parts, jax.Array]) -> tuple[Parts, jax.Array]:
        parts, order = now
        column = tuple(jax.lax.dynamic_index_in_dim(part, k, 1, keepdims=False) for part in parts)
        largest = jnp.argmax(jnp.where(places >= k, sum(jnp.abs(entry) for entry in column), -1.0)).astype(order.dtype)
        here, upper = places == k, tuple(part[k] for part in parts)
        pivot = _reciprocal(tuple(entry[largest] for entry in column))
        row = times(
            pivot, tuple(jnp.where(here, one, part[largest]) for one, part in zip((1.0, 0.0), parts, strict=False))
        )
        # Rows k and `largest` change places.
        column = tuple(jnp.where(here, 0.0, jnp.where(places == largest, entry[k], entry)) for entry in column)
        outer = times(tuple(entry[:, None] for entry in column), tuple(entry[None, :] for entry in row))
        parts = tuple(part.at[largest].set(own) for part, own in zip(parts, upper, strict=True))
        parts = tuple(
            (jnp.where(here[None, :], 0.0, part) - gone).at[k].set(own)
            for own, part, gone in zip(row, parts, outer, strict=True)
        )
        return parts, order.at[largest].set(order[k]).at[k].set(order[largest])

    parts, order = jax.lax.fori_loop(0, places.size, eliminate, (matrix, places))
    # Rows were swapped on the way: columns of the inverse are.
    back = jnp.argmax(order[:, None] == places[None, :], axis=0)
    return tuple(part[:, back] for part in parts)


def applied(matrix: Parts, vector: Parts) -> Parts:
    """The product of a matrix and a vector."""
    products = times(matrix, tuple(entry[None, :] for entry in vector))
    return tuple(jnp.sum(product, axis=1) for product in products)


def times(a: Parts, b: Parts) -> Parts:
    """The product of two numbers, entry by entry."""
    if len(a) == 1:
        return (a[0] * b[0],)
    return (a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


def _reciprocal(a: Parts) -> Parts:
    if len(a) == 1:
        return (1.0 / a[0],)
    # Scaled, so that no square overflows.
    scale = jnp.maximum(jnp.abs(a[0]), jnp.abs(a[1]))
    p, q = a[0] / scale, a[1] / scale
    square = scale * (p * p + q * q)
    return (p / square, -q / square)


def _by_library(matrix: Parts) -> Parts:
    if len(matrix) == 1:
        return (jnp.linalg.inv(matrix[0]),)
    found = jnp.linalg.inv(jax.lax.complex(*matrix))
    return (found.real, found.imag)
