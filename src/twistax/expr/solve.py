"""Inverses and linear systems. Up to 3x3 they are unrolled, which in a loop is many times faster than a call."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ShapeError
from ..groups.arrays import multiply
from .arithmetic import Div, MatMul, is_identity
from .fields import Operand
from .graph import leaves_of
from .indexing import Index
from .leaves import Constant, Parameter, State
from .linalg import Diag
from .node import Example, Expr, Shape
from .printing import wrap_latex
from .shapes import expect_square

#: Above this condition number a constant matrix is not inverted beforehand: a solve leaves the smaller residual.
WORST_CONDITION = 1e8

#: A larger matrix is eliminated anew for every right-hand side.
LARGEST_INVERTED = 16


def adjugate(A: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The adjugate and the determinant of matrices (..., n, n) with n = 1, 2 or 3: A^-1 = adjugate / determinant."""
    a = [[A[..., i, j] for j in range(A.shape[-1])] for i in range(A.shape[-1])]
    n = len(a)
    if n == 1:
        rows = [[jnp.ones_like(a[0][0])]]
    elif n == 2:
        rows = [[a[1][1], -a[0][1]], [-a[1][0], a[0][0]]]
    else:
        rows = [[_cofactor(a, j, i) for j in range(3)] for i in range(3)]
    determinant = sum((a[0][k] * rows[k][0] for k in range(1, n)), start=a[0][0] * rows[0][0])
    return jnp.stack([entry for row in rows for entry in row], axis=-1).reshape(A.shape), determinant


def _cofactor(a: list[list[jax.Array]], i: int, j: int) -> jax.Array:
    """Cofactor of entry (i, j) of a 3x3 matrix; with cyclic indices its sign is built in."""
    down, further, right, beyond = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
    return a[down][right] * a[further][beyond] - a[down][beyond] * a[further][right]


def inverse(A: jax.Array) -> jax.Array:
    """A^-1 of matrices (..., n, n)."""
    if A.shape[-1] > 3:
        return jnp.linalg.inv(A)
    scale = _size(A)
    adjoint, determinant = adjugate(A / scale)
    return adjoint / (determinant[..., None, None] * scale)


def solve(A: jax.Array, b: jax.Array) -> jax.Array:
    """The x with A x = b: A (n, n), b (n,) or (n, k)."""
    if A.shape[-1] > 3:
        return jnp.linalg.solve(A, b)
    scale = _size(A)[0, 0]
    adjoint, determinant = adjugate(A / scale)
    return multiply(adjoint, b) / (determinant * scale)


def solve_again(A: jax.Array, b: jax.Array) -> jax.Array:
    """The x with A x = b by the inverse of A, for an A that stays while b changes: a loop inverts it only once.

    One step of refinement brings the residual near that of an elimination. Source: Higham, Accuracy and Stability of
    Numerical Algorithms (2002), ch. 12.
    """
    inverted = inverse(A)
    x = multiply(inverted, b)
    return x + multiply(inverted, b - multiply(A, x))


def _size(A: jax.Array) -> jax.Array:
    """The largest entry of each matrix, so that products of three neither over- nor underflow. It cancels exactly."""
    return jax.lax.stop_gradient(jnp.max(jnp.abs(A), axis=(-2, -1), keepdims=True))


class Inv(Expr):
    """Inverse A^-1. Shapes: (..., n, n) -> the same. To solve A x = b use Solve, which is cheaper and more accurate.

    A singular matrix gives inf or NaN.

    Raises:
        ShapeError: the operand is no square matrix.
    """

    operand: Operand

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_square(self, "operand", shapes[0], stacks=True)
        return shapes[0]

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        return [[(self.operand, -1), (self, -2)], [(self.operand, -2), (self, -1)]]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return inverse(values[0])

    def simplify(self) -> Expr:
        """Some matrices know their inverse: inverses, diagonal matrices, Ad and Ad*."""
        known = self.operand.inverted()
        return self if known is None else known

    def inverted(self) -> Expr | None:
        return self.operand

    def to_latex(self, *operands: str) -> str:
        return rf"{{{wrap_latex(self.operand, operands[0], 60)}}}^{{-1}}"

    @classmethod
    def example(cls) -> list[Example]:
        stack = np.stack([_well_conditioned(3), 2.0 * _well_conditioned(3).T])
        matrices = [*(_well_conditioned(n) for n in (1, 2, 3, 4)), stack]
        return [Example(Inv(State("m", shape=m.shape)), {"m": m}) for m in matrices]


class Solve(Expr):
    """The x with A x = b. Shapes: A (n, n), b (n,) -> (n,); b (n, k) -> (n, k). Its unit is that of b over that of A.

    A singular matrix gives inf or NaN.

    Attributes:
        A: the matrix, an inertia for example.
        b: the right-hand side, one or several columns.
    Raises:
        ShapeError: A is no square matrix, or b has another number of rows.
    """

    A: Operand
    b: Operand
    precedence = 20

    def infer_shape(self, *shapes: Shape) -> Shape:
        A, b = shapes
        expect_square(self, "A", A)
        if len(b) not in (1, 2) or b[0] != A[0]:
            raise ShapeError(f"Solve expects b with shape ({A[0]},) or ({A[0]}, k), got {b}")
        return b

    def evaluate(self, *values: jax.Array) -> jax.Array:
        stays = all(isinstance(leaf, (Constant, Parameter)) for leaf in leaves_of(self.A))
        return solve_again(*values) if stays and 3 < self.A.shape[0] <= LARGEST_INVERTED else solve(*values)

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        rows = -self.b.ndim
        columns = [[(self.b, -1), (self, -1)]] if rows == -2 else []
        return [[(self.A, -2), (self.b, rows)], [(self.A, -1), (self, rows)], *columns]

    def simplify(self) -> Expr:
        """I x = b is x = b; a diagonal divides; a known inverse multiplies; a good constant is inverted once."""
        A, b = self.A, self.b
        if is_identity(A):
            return b
        if isinstance(A, Diag):
            return Div(b, A.operand if len(b.shape) == 1 else Index(A.operand, (slice(None), None)))
        known = A.inverted()
        if known is not None:
            return MatMul(known, b)
        if isinstance(A, Constant) and np.linalg.cond(A.value) <= WORST_CONDITION:
            return MatMul(Constant(np.linalg.inv(A.value)), b)
        return self

    def to_latex(self, *operands: str) -> str:
        return rf"{{{wrap_latex(self.A, operands[0], 60)}}}^{{-1}} \, {wrap_latex(self.b, operands[1], 21)}"

    @classmethod
    def example(cls) -> list[Example]:
        b, columns = np.array([1.0, -2.0, 0.5, 3.0]), np.array([[1.0, -2.0], [0.5, 3.0], [0.0, 1.0]])
        values = [{"A": _well_conditioned(n), "b": b[:n]} for n in (1, 2, 3, 4)]
        values.append({"A": _well_conditioned(3), "b": columns})
        return [Example(Solve(*(State(name, shape=v.shape) for name, v in case.items())), case) for case in values]


def _well_conditioned(n: int) -> np.ndarray:
    return n * np.eye(n) + np.arange(n * n, dtype=float).reshape(n, n) ** 1.5 / n**2
