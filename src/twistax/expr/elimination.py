"""Linear systems of up to three unknowns by elimination with partial pivoting, without branches and library calls.

The adjugate is cheaper by a third, and its error grows with the square of the condition number; that of elimination
grows with the condition number itself. Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), ch. 9.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

__all__ = ["LARGEST", "eliminate"]

#: Larger systems are LAPACK's: unrolled they would not gain.
LARGEST = 3


def eliminate(A: jax.Array, b: jax.Array) -> jax.Array:
    """The x with A x = b: A (..., n, n), b (..., n, k), n up to `LARGEST`.

    Derivatives are those of the implicit function. A singular matrix gives inf or NaN.
    """
    return jax.lax.custom_linear_solve(
        # A sum of products: accelerators round the factors of a float32 matrix product to fewer bits.
        lambda x: jnp.sum(A[..., :, :, None] * x[..., None, :, :], axis=-2),
        b,
        lambda _, right: _substituted(A, right),
        lambda _, right: _substituted(jnp.swapaxes(A, -1, -2), right),
    )


def _substituted(A: jax.Array, b: jax.Array) -> jax.Array:
    n = A.shape[-1]
    left = [[A[..., i, j] for j in range(n)] for i in range(n)]
    right = [b[..., i, :] for i in range(n)]
    for k in range(n):
        for i in range(k + 1, n):
            swap = jnp.abs(left[i][k]) > jnp.abs(left[k][k])
            for j in range(k, n):
                left[k][j], left[i][j] = _swapped(swap, left[k][j], left[i][j])
            right[k], right[i] = _swapped(swap[..., None], right[k], right[i])
        for i in range(k + 1, n):
            factor = left[i][k] / left[k][k]
            for j in range(k + 1, n):
                left[i][j] = left[i][j] - factor * left[k][j]
            right[i] = right[i] - factor[..., None] * right[k]
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            right[i] = right[i] - left[i][j][..., None] * right[j]
        right[i] = right[i] / left[i][i][..., None]
    return jnp.stack(right, axis=-2)


def _swapped(swap: jax.Array, a: jax.Array, b: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(b, a) where swap, else (a, b)."""
    return jnp.where(swap, b, a), jnp.where(swap, a, b)
