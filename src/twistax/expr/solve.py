"""Inverses and linear systems."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ShapeError
from ..groups.arrays import multiply
from .arithmetic import Div, MatMul, is_identity
from .elimination import LARGEST, eliminate
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
    """The x with A x = b by the inverse of A, for an A that stays while b changes: a loop inverts it only once.

    One step of refinement brings the residual near that of an elimination. Source: Higham, Accuracy and Stability of
    Numerical Algorithms (2002), ch. 12.
    """
    inverted = inverse(A)
    x = multiply(inverted, b)
    return x + multiply(inverted, b - multiply(A, x))


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
