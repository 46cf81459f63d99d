"""Linear systems with a symmetric positive definite matrix, such as an inertia: elimination from the last row, without
pivoting.

In a mechanism that is a tree, row i of the matrix has entries only for the degrees of freedom before i. Elimination
from the last row then preserves the sparsity, so structural zeros have no cost.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), section 6.5.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ..bases import expect_square
from ..fields import Operand
from ..kinds import rules
from ..node import Expr, Shape
from .solve import LinearSystem


def solve_positive(A: jax.Array, b: jax.Array) -> jax.Array:
    """The x (n, k) with A x = b by A = L' D L, with L unit lower triangular; entries of A above its diagonal are not
    read.
    """
    n, left, right = A.shape[-1], A, b
    factors, pivots, rows = [], [], []
    for k in reversed(range(n)):
        pivots.append(1.0 / left[k, k])
        factors.append(left[k, :k] * pivots[-1])
        rows.append(right[k])
        left = left[:k, :k] - factors[-1][:, None] * left[None, k, :k]
        right = right[:k] - factors[-1][:, None] * right[None, k]
    x: list[jax.Array] = []
    for factor, pivot, row in zip(reversed(factors), reversed(pivots), reversed(rows), strict=True):
        entry = row * pivot
        x.append(entry - jnp.sum(factor[:, None] * jnp.stack(x), axis=0) if x else entry)
    return jnp.stack(x)


def inverse_factor(A: jax.Array) -> jax.Array:
    """V (n, n), lower triangular, with A^-1 = V V^T; entries of A above its diagonal are not read.

    For A = L' D L it is L^-1 D^(-1/2), whose sparsity is that of L: row i has entries only for the degrees of freedom
    before i.
    """
    left, factors = A, list[tuple[jax.Array, jax.Array]]()
    for k in reversed(range(A.shape[-1])):
        pivot = 1.0 / left[k, k]
        factors.append((left[k, :k] * pivot, jnp.sqrt(pivot)))
        left = left[:k, :k] - factors[-1][0][:, None] * left[None, k, :k]
    V = jnp.zeros((0, 0), A.dtype)
    for factor, root in reversed(factors):
        row = jnp.concatenate([-(factor @ V), root[None]])
        V = jnp.concatenate([jnp.pad(V, ((0, 0), (0, 1))), row[None]])
    return V


def inverse_positive(A: jax.Array) -> jax.Array:
    """A^-1, exactly symmetric: the half below the diagonal is not computed."""
    V = inverse_factor(A)
    above = V @ V.T
    return jnp.where(np.tri(A.shape[-1], dtype=bool), above.T, above)


class SolvePositive(LinearSystem):
    """The x with $A x = b$, A symmetric positive definite. Shapes: A (n, n), b (n,) -> (n,); b (n, k) -> (n, k).

    Only the lower half of A is read. For a matrix that is not positive definite the result is inexact, inf or NaN.

    Attributes:
        A: the matrix, an inertia for example.
        b: the right-hand side, one or several columns.
    Raises: ShapeError if A is not a square matrix, or b has another number of rows.
    """

    cases = (
        {"A": [[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]], "b": [1.0, -2.0, 0.5]},
        {"A": [[4.0, 1.0], [1.0, 3.0]], "b": [[1.0, -2.0, 0.0], [0.5, 3.0, 1.0]]},
    )

    def evaluate(self, *values: jax.Array) -> jax.Array:
        A, b = values
        return solve_positive(A, b[:, None])[:, 0] if b.ndim == 1 else solve_positive(A, b)


class _OfPositive(Expr):
    """Base of functions of a symmetric positive definite matrix. Shape: (n, n) -> (n, n)."""

    abstract = True
    of_numbers = True
    operand: Operand
    cases = ({"operand": [[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]]},)

    def infer_shape(self, *shapes: Shape) -> Shape:
        (A,) = shapes
        expect_square(self, "the operand", A)
        return A


class InversePositive(_OfPositive):
    """$A^-1$ of a symmetric positive definite matrix. Shape: (n, n) -> (n, n). To solve A x = b use SolvePositive.

    Raises: ShapeError if the operand is not a square matrix.
    """

    kinds = rules.INVERSE
    function = inverse_positive
    formula = "{<0:60>}^{-1}"


class InverseFactor(_OfPositive):
    """V, lower triangular, with $A^-1 = V V^T$ of a symmetric positive definite A. Shape: (n, n) -> (n, n).

    For many sparse right-hand sides: $x = V (V^T b)$ omits structural zeros of intermediate results.

    Raises: ShapeError if the operand is not a square matrix.
    """

    kinds = rules.OPEN
    function = inverse_factor
    formula = "{<0:60>}^{-1/2}"
