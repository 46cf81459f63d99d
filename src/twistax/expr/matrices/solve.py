"""Inverses and linear systems; systems of up to `LARGEST` unknowns by elimination, without branches and library calls.

The error of the adjugate grows with the square of the condition number, that of elimination with the number itself.
A 3x3 solve takes 61 operations on scalars, 57 by the adjugate; an inverse 100, by the adjugate 42.
Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), ch. 9.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ShapeError
from ...groups.arrays import multiply
from ..bases import expect_square
from ..fields import Operand
from ..graph import leaves_of
from ..kinds import rules
from ..leaves import Constant, Parameter
from ..node import Expr, Shape
from ..operations.arithmetic import Div, MatMul, is_identity
from .linalg import Diag

#: Above this condition number a constant matrix is not inverted beforehand: a solve leaves the smaller residual.
WORST_CONDITION = 1e8

#: Larger matrices are eliminated again for every right-hand side.
LARGEST_INVERTED = 16

#: Larger systems are LAPACK's: unrolled they would not gain.
LARGEST = 3


def eliminate(A: jax.Array, b: jax.Array) -> jax.Array:
    """The x with A x = b: A (..., n, n), b (..., n, k), n up to `LARGEST`.

    Derivatives are those of the implicit function theorem. For a singular matrix the result is inf or NaN.
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


def inverse(A: jax.Array) -> jax.Array:
    """A^-1 of matrices (..., n, n)."""
    if A.shape[-1] > LARGEST:
        return jnp.linalg.inv(A)
    return eliminate(A, jnp.broadcast_to(jnp.eye(A.shape[-1], dtype=A.dtype), A.shape))


def solve(A: jax.Array, b: jax.Array) -> jax.Array:
    """The x with A x = b: A (n, n), b (n,) or (n, k)."""
    if A.shape[-1] > LARGEST:
        return jnp.linalg.solve(A, b)
    return eliminate(A, b[:, None])[:, 0] if b.ndim == 1 else eliminate(A, b)


def solve_again(A: jax.Array, b: jax.Array) -> jax.Array:
    """The x with A x = b by the inverse of A, for an A that is constant over all iterations of a loop.

    Two steps of iterative refinement reduce the residual to that of an elimination: each multiplies the error of an
    inverse by eps times the condition number. After a single step it is up to 400 times as large at a condition number
    of 1e10. Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), ch. 12.
    """
    inverted = inverse(A)
    x = multiply(inverted, b)
    for _ in range(2):
        x = x + multiply(inverted, b - multiply(A, x))
    return x


def _well_conditioned(n: int) -> np.ndarray:
    return n * np.eye(n) + np.arange(n * n, dtype=float).reshape(n, n) ** 1.5 / n**2


class Inv(Expr):
    """Inverse $A^-1$. Shapes: (..., n, n) -> the same. To solve A x = b use Solve, which is cheaper and more accurate.

    For a singular matrix the result is inf or NaN.

    Raises: ShapeError if the operand is not a square matrix.
    """

    kinds = rules.INVERSE
    of_numbers = True
    operand: Operand
    function = inverse
    formula = "{<0:60>}^{-1}"
    cases = (
        *({"operand": _well_conditioned(n)} for n in (1, 2, 3, 4)),
        {"operand": np.stack([_well_conditioned(3), 2.0 * _well_conditioned(3).T])},
    )

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_square(self, "operand", shapes[0], stacks=True)
        return shapes[0]

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        return [[(self.operand, -1), (self, -2)], [(self.operand, -2), (self, -1)]]

    def simplify(self) -> Expr:
        """Inverses, diagonal matrices, Ad and Ad* have a simpler inverse."""
        known = self.operand.inverted()
        return self if known is None else known

    def inverted(self) -> Expr | None:
        return self.operand


class LinearSystem(Expr):
    """The x with $A x = b$. Shapes: A (n, n), b (n,) -> (n,); b (n, k) -> (n, k). Its unit is that of b over that of A.

    Attributes:
        A: the matrix, an inertia for example.
        b: the right-hand side, one or several columns.
    """

    kinds = rules.SOLVE
    abstract = True
    of_numbers = True
    A: Operand
    b: Operand
    precedence = 20
    formula = r"{<0:60>}^{-1} \, <1:21>"

    def infer_shape(self, *shapes: Shape) -> Shape:
        A, b = shapes
        expect_square(self, "A", A)
        if len(b) not in (1, 2) or b[0] != A[0]:
            raise ShapeError(f"{type(self).__name__} expects b with shape ({A[0]},) or ({A[0]}, k), got {b}")
        return b

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        rows = -self.b.ndim
        columns = [[(self.b, -1), (self, -1)]] if rows == -2 else []
        return [[(self.A, -2), (self.b, rows)], [(self.A, -1), (self, rows)], *columns]


class Solve(LinearSystem):
    """The x with $A x = b$. Shapes: A (n, n), b (n,) -> (n,); b (n, k) -> (n, k). Its unit is that of b over that of A.

    For a singular matrix the result is inf or NaN.

    Attributes:
        A: the matrix, an inertia for example.
        b: the right-hand side, one or several columns.
    Raises: ShapeError if A is not a square matrix, or b has another number of rows.
    """

    cases = (
        *({"A": _well_conditioned(n), "b": [1.0, -2.0, 0.5, 3.0][:n]} for n in (1, 2, 3, 4)),
        {"A": _well_conditioned(3), "b": [[1.0, -2.0], [0.5, 3.0], [0.0, 1.0]]},
    )

    def evaluate(self, *values: jax.Array) -> jax.Array:
        stays = all(isinstance(leaf, (Constant, Parameter)) for leaf in leaves_of(self.A))
        return solve_again(*values) if stays and 3 < self.A.shape[0] <= LARGEST_INVERTED else solve(*values)

    def simplify(self) -> Expr:
        """I x = b is x = b; a diagonal matrix divides; a known inverse multiplies; a well-conditioned constant is
        inverted once.
        """
        A, b = self.A, self.b
        if is_identity(A):
            return b
        if isinstance(A, Diag):
            return Div(b, A.operand if len(b.shape) == 1 else A.operand[:, None])
        known = A.inverted()
        if known is not None:
            return MatMul(known, b)
        if isinstance(A, Constant) and np.linalg.cond(A.value) <= WORST_CONDITION:
            return MatMul(Constant(np.linalg.inv(A.value)), b)
        return self
