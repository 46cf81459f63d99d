"""Nodes of linear algebra: transpose, diagonal, sums, norms, and products of vectors."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError, ShapeError
from ...groups.arrays import cross, unpack, vector
from ..bases import expect_square
from ..fields import ExprLike, Operand
from ..kinds import array_rules, rules
from ..node import Expr, Numbers, Shape, expect
from ..operations.arithmetic import Div, Neg, is_constant, zeros_of
from ..operations.elementwise import Abs, absolute

_A, _B, _MATRIX = [1.0, -2.0, 0.5], [0.3, 1.0, 2.0], [[1.0, -2.0, 0.5], [3.0, 0.25, -1.0]]


class Transpose(Expr):
    """Transpose: the last two axes are exchanged. Scalars and vectors are unchanged."""

    operand: Operand
    kinds = rules.TRANSPOSE
    by_operators = by_values = True
    formula = r"{<0:60>}^{\top}"
    cases = ({"operand": np.arange(6.0).reshape(2, 3)}, {"operand": np.arange(12.0).reshape(2, 2, 3)})

    def infer_shape(self, *shapes: Shape) -> Shape:
        (shape,) = shapes
        return shape if len(shape) < 2 else (*shape[:-2], shape[-1], shape[-2])

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        rank = min(self.ndim, 2)
        return [[(self.operand, -1 - i), (self, i - rank)] for i in range(rank)]

    def evaluate(self, *values: Numbers) -> Numbers:
        return values[0] if values[0].ndim < 2 else values[0].swapaxes(-1, -2)

    def makes_group_element(self, *operands: bool) -> bool:
        return operands[0] and self.shape == (3, 3)

    def transposed(self) -> Expr | None:
        return self.operand

    def simplify(self) -> Expr:
        """A vector is its own transpose; transposes, diagonal matrices, Ad and Ad* have a simpler form."""
        if len(self.shape) < 2:
            return self.operand
        known = self.operand.transposed()
        return self if known is None else known

    def to_text(self, *operands: str) -> str:
        return f"({operands[0]}).T"


class Diag(Expr):
    """The diagonal matrix of a vector. Shapes: (n,) -> (n, n).

    Raises: ShapeError if the operand is not a vector.
    """

    operand: Operand
    kinds = rules.DIAGONAL
    cases = ({"operand": _A},)

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        return [[(self.operand, -1), (self, -1), (self, -2)]]

    def infer_shape(self, *shapes: Shape) -> Shape:
        (shape,) = shapes
        if len(shape) != 1:
            raise ShapeError(
                f"Diag expects a vector, got shape {shape}",
                hint="for the diagonal of a matrix use A[np.arange(n), np.arange(n)]",
            )
        return shape + shape

    def transposed(self) -> Expr | None:
        return self

    def inverted(self) -> Expr | None:
        return Diag(Div(1.0, self.operand))

    def evaluate(self, *values: jax.Array) -> jax.Array:
        (entries,) = values
        return jnp.where(np.eye(entries.shape[0], dtype=bool), entries[:, None], 0.0)


class Sum(Expr):
    """Sum of all entries. Shapes: any -> ()."""

    kinds = array_rules.REDUCED
    of_numbers = True
    operand: Operand
    function = jnp.sum
    formula = r"\sum <0:20>"
    cases = ({"operand": _MATRIX},)

    def infer_shape(self, *shapes: Shape) -> Shape:
        return ()

    def simplify(self) -> Expr:
        """The sum of a scalar is the scalar."""
        return self if self.operand.shape else self.operand


class Trace(Expr):
    """Sum of the diagonal entries. Shapes: (n, n) -> ().

    Raises: ShapeError if the operand is not a square matrix.
    """

    kinds = array_rules.REDUCED
    of_numbers = True
    operand: Operand
    function = jnp.trace
    latex_name = r"\operatorname{tr}"
    cases = ({"operand": np.arange(9.0).reshape(3, 3)},)

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_square(self, "operand", shapes[0])
        return ()

    def simplify(self) -> Expr:
        """The trace of a transpose is that of the matrix; of a diagonal matrix, the sum of its entries."""
        if isinstance(self.operand, Diag):
            return Sum(self.operand.operand)
        return Trace(self.operand.operand) if isinstance(self.operand, Transpose) else self


def _root_of_squares(x: jax.Array) -> jax.Array:
    """The root of the sum of squares of all entries, where no square is in range too."""
    from ...scalar.primitives.in_range import norm  # not at import: it loads much of JAX that `import jax` does not

    return norm(x)


def vector_norm(x: jax.Array, order: Any) -> jax.Array:
    """The norm of a vector: "inf", "-inf", 1 or another number above 1."""
    sizes = absolute(x)
    if isinstance(order, str):
        return jnp.max(sizes) if order == "inf" else jnp.min(sizes)
    return jnp.sum(sizes) if order == 1 else jnp.sum(sizes**order) ** (1.0 / float(order))


def matrix_norm(x: jax.Array, order: Any) -> jax.Array:
    """The norm of a matrix: its largest row sum ("inf"), column sum (1) or singular value (2)."""
    return jnp.linalg.norm(x, ord=2) if order == 2 else jnp.max(jnp.sum(absolute(x), axis=int(order == "inf")))


class Norm(Expr):
    """Norm of a vector or matrix, in its unit. Shapes: any -> ().

    At zero the derivative is defined as 0, to all orders.

    Attributes:
        ord: "fro", the default, the root of the sum of squares for any shape. For vectors also "inf" (largest |x_i|),
            "-inf" (smallest), or a number p >= 1 for $(sum_i |x_i|^p)^(1/p)$. For matrices also "inf" (largest row sum
            of |a_ij|), 1 (largest column sum) or 2 (largest singular value).
    Raises:
        ModelError: an unknown order.
        ShapeError: the order is not defined for the operand's rank.
    """

    kinds = array_rules.REDUCED
    of_numbers = True
    operand: Operand
    ord: Any = "fro"
    cases = (
        *({"operand": _A, "ord": ord} for ord in ("fro", 1, 3.5, "inf", "-inf")),
        *({"operand": _MATRIX, "ord": ord} for ord in ("fro", 1, 2, "inf")),
        {"operand": -0.5, "ord": "fro"},
    )
    kinks = (
        *({"operand": np.zeros(3), "ord": ord} for ord in ("fro", 1, 3.5, "inf")),
        {"operand": np.zeros((2, 3)), "ord": 2},
    )

    def __init__(self, operand: ExprLike, ord: Any = "fro") -> None:
        super().__init__(operand, {None: "fro", np.inf: "inf", -np.inf: "-inf"}.get(ord, ord))

    def validate(self) -> None:
        number = isinstance(self.ord, (int, float)) and not isinstance(self.ord, bool) and self.ord >= 1
        if not number and self.ord not in ("fro", "inf", "-inf"):
            raise ModelError(f'Norm expects ord to be "fro", "inf", "-inf" or a number >= 1, got {self.ord!r}')

    def infer_shape(self, *shapes: Shape) -> Shape:
        rank = len(shapes[0])
        if self.ord != "fro" and (rank > 2 or (rank == 2 and self.ord not in (1, 2, "inf"))):
            raise ShapeError(f"Norm with ord={self.ord!r} is not defined for shape {shapes[0]}", hint='use ord="fro"')
        return ()

    def evaluate(self, *values: jax.Array) -> jax.Array:
        (x,) = values
        if self.ord == "fro" or (self.ord == 2 and x.ndim < 2):
            return _root_of_squares(x)
        zero = jnp.all(x == 0.0)
        safe = jnp.where(zero, 1.0, jnp.atleast_1d(x))
        norm = matrix_norm if x.ndim == 2 else vector_norm
        return jnp.where(zero, 0.0, norm(safe, self.ord))

    def simplify(self) -> Expr:
        """The norm of -x is that of x; of a scalar, its absolute value."""
        if not self.operand.shape:
            return Abs(self.operand)
        return Norm(self.operand.operand, self.ord) if isinstance(self.operand, Neg) else self

    def to_latex(self, *operands: str) -> str:
        order = {"fro": "", "inf": r"_{\infty}", "-inf": r"_{-\infty}"}.get(self.ord, f"_{{{self.ord}}}")
        return rf"\left\|{operands[0]}\right\|{order}"


class Dot(Expr):
    """Scalar product $a . b$ of two vectors. Shapes: (n,), (n,) -> ().

    Raises: ShapeError for operands that are not vectors, or of different length.
    """

    kinds = rules.MATRIX_PRODUCT
    of_numbers = True
    by_values = True
    left: Operand
    right: Operand
    precedence = 20
    formula = r"<0:21> \cdot <1:21>"
    cases = ({"left": _A, "right": _B},)

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        return [[(self.left, -1), (self.right, -1)]]

    def infer_shape(self, *shapes: Shape) -> Shape:
        left, right = shapes
        if len(left) != 1 or left != right:
            raise ShapeError(f"Dot expects two vectors of equal length, got shapes {left} and {right}")
        return ()

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.sum(values[0] * values[1])


def cross_columns(a: jax.Array, b: jax.Array) -> jax.Array:
    """a x b of a vector (3,) with a vector (3,) or with each column of (3, k)."""
    return vector(cross(unpack(a), tuple(jnp.unstack(b))))


class Cross(Expr):
    """Vector product $a x b$. Shapes: (3,), (3,) -> (3,); the unit is the product of both.

    With k columns on the right, a x b_i column by column: (3,), (3, k) -> (3, k).

    Raises: ShapeError for an operand of another shape.
    """

    kinds = rules.CROSS
    of_numbers = True
    left: Operand
    right: Operand
    function = cross_columns
    precedence = 20
    formula = r"<0:21> \times <1:21>"
    cases = ({"left": _A, "right": _B}, {"left": _A, "right": -np.arange(6.0).reshape(3, 2)})

    def infer_shape(self, *shapes: Shape) -> Shape:
        left, right = shapes
        expect(self, "left", left, (3,))
        if len(right) != 2 or right[0] != 3:
            expect(self, "right", right, (3,), "k columns have shape (3, k)" if len(right) == 2 else None)
        return right

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        return [[(self.right, -1), (self, -1)]]

    def simplify(self) -> Expr:
        """a x a and a x 0 are 0; (-a) x b and a x (-b) are -(a x b)."""
        left, right = self.left, self.right
        if is_constant(left, 0.0) or is_constant(right, 0.0) or left.key() == right.key():
            return zeros_of(self)
        if isinstance(left, Neg):
            return Neg(Cross(left.operand, right))
        return Neg(Cross(left, right.operand)) if isinstance(right, Neg) else self


class Outer(Expr):
    """The matrix $a b^T$ of all products. Shapes: (m,), (n,) -> (m, n).

    Raises: ShapeError if an operand is not a vector.
    """

    kinds = rules.OUTER
    of_numbers = True
    by_values = True
    left: Operand
    right: Operand
    precedence = 20
    formula = r"<0:60> \, {<1:60>}^{\top}"
    cases = ({"left": _A, "right": [0.3, 1.0]},)

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        return [[(self.left, -1), (self, -2)], [(self.right, -1), (self, -1)]]

    def infer_shape(self, *shapes: Shape) -> Shape:
        left, right = shapes
        if len(left) != 1 or len(right) != 1:
            raise ShapeError(f"Outer expects two vectors, got shapes {left} and {right}")
        return left + right

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return values[0][:, None] * values[1][None, :]
