"""Arrays made of parts: joined along an axis, stacked along a new one, or matrices of blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ShapeError
from .fields import ExprLike, Operands
from .leaves import Constant, State
from .node import Example, Expr, Shape
from .printing import matrix_latex


def gathered(operands: Sequence[Any]) -> Sequence[Any]:
    """The operands, given one by one or as a single list."""
    return operands[0] if len(operands) == 1 and isinstance(operands[0], (list, tuple)) else operands


class Concat(Expr):
    """Pieces joined along the first axis. A scalar counts as a vector of one entry.

    Shapes: (), (n,), (m,) -> (1 + n + m,); (n, k), (m, k) -> (n + m, k). Takes the pieces one by one or in a list.

    Attributes:
        exprs: one or more expressions that agree in all axes but the first.
    Raises:
        ShapeError: the pieces differ in rank or beyond the first axis.
    """

    exprs: Operands
    associative = True
    cases = (
        {"exprs": [0.3, [1.0, -2.0], Constant(4.0)]},
        {"exprs": [np.eye(2), Constant(np.ones((1, 2)))]},
        {"exprs": [0.3, -0.5]},
    )

    def __init__(self, *exprs: ExprLike | Sequence[ExprLike]) -> None:
        super().__init__(*gathered(exprs))

    @property
    def boolean(self) -> bool:
        return all(piece.boolean for piece in self.exprs)

    def infer_shape(self, *shapes: Shape) -> Shape:
        return _joined(self, [shape or (1,) for shape in shapes], 0)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        if all(value.ndim == 0 for value in values):
            return jnp.stack(values)
        return jnp.concatenate([jnp.atleast_1d(value) for value in values])

    def simplify(self) -> Expr:
        """A single vector is itself. Joined pieces of joined pieces are joined once, before."""
        return self.exprs[0] if len(self.exprs) == 1 and self.exprs[0].shape else self

    def to_latex(self, *operands: str) -> str:
        return matrix_latex([[operand] for operand in operands])


class Stack(Expr):
    """Rows of equal shape stacked along a new first axis.

    Shapes: k rows of shape s -> (k, *s). Takes the rows in a list or one by one.

    Attributes:
        rows: one or more expressions of equal shape.
    Raises:
        ShapeError: the rows differ in shape.
    """

    rows: Operands
    cases = (
        {"rows": [[1.0, -2.0, 0.5], Constant(np.ones(3)), [0.3, 1.5, -1.0]]},
        {"rows": [2.0, Constant(0.0)]},
    )

    def __init__(self, *rows: ExprLike | Sequence[ExprLike]) -> None:
        super().__init__(*gathered(rows))

    @property
    def boolean(self) -> bool:
        return all(row.boolean for row in self.rows)

    def infer_shape(self, *shapes: Shape) -> Shape:
        for i, shape in enumerate(shapes):
            if shape != shapes[0]:
                raise ShapeError(
                    f"Stack expects rows of one shape, got row 0 with shape {shapes[0]} and row {i} with shape {shape}",
                    hint="tx.Concat joins pieces of different length",
                )
        return (len(shapes), *shapes[0])

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.stack(values)

    def to_latex(self, *operands: str) -> str:
        return matrix_latex(
            [[row if not self.rows[i].shape else rf"{{{row}}}^{{\top}}"] for i, row in enumerate(operands)]
        )


class Hstack(Expr):
    """Arrays side by side: joined along the second axis, vectors and scalars along the first.

    Shapes: (n, j), (n, k) -> (n, j + k); (j,), (k,) -> (j + k,). Takes the arrays in a list or one by one.

    Attributes:
        arrays: one or more expressions that agree in all axes but the joined one.
    Raises:
        ShapeError: the arrays differ in rank or beyond the joined axis.
    """

    arrays: Operands
    cases = (
        {"arrays": [np.arange(6.0).reshape(2, 3), Constant(np.ones((2, 1)))]},
        {"arrays": [[1.0, -2.0], Constant(1.0), [0.3, 0.5]]},
    )

    def __init__(self, *arrays: ExprLike | Sequence[ExprLike]) -> None:
        super().__init__(*gathered(arrays))

    def infer_shape(self, *shapes: Shape) -> Shape:
        shapes = tuple(shape or (1,) for shape in shapes)
        return _joined(self, shapes, min(len(shapes[0]) - 1, 1))

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.hstack(values)

    def simplify(self) -> Expr:
        """Of vectors and scalars it is Concat; a single matrix is itself."""
        if len(self.shape) == 1:
            return Concat(*self.arrays)
        return self.arrays[0] if len(self.arrays) == 1 else self

    def to_latex(self, *operands: str) -> str:
        return matrix_latex([list(operands)])


class Vstack(Expr):
    """Arrays on top of each other: joined along the first axis, a vector or scalar being one row.

    Shapes: (j, n), (k, n) -> (j + k, n); (n,), (n,) -> (2, n). Takes the arrays in a list or one by one.

    Attributes:
        arrays: one or more expressions that agree in all axes but the first.
    Raises:
        ShapeError: the arrays differ in rank or beyond the first axis.
    """

    arrays: Operands
    cases = (
        {"arrays": [np.arange(6.0).reshape(2, 3), [1.0, -2.0, 0.5]]},
        {"arrays": [[1.0, -2.0, 0.5], [0.3, 1.5, -1.0]]},
    )

    def __init__(self, *arrays: ExprLike | Sequence[ExprLike]) -> None:
        super().__init__(*gathered(arrays))

    def infer_shape(self, *shapes: Shape) -> Shape:
        return _joined(self, [(1,) * (2 - len(shape)) + shape for shape in shapes], 0)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.vstack(values)

    def simplify(self) -> Expr:
        """Of vectors it is Stack, of matrices Concat."""
        ranks = {len(array.shape) for array in self.arrays}
        if ranks <= {1}:
            return Stack(*self.arrays)
        return self if ranks & {0, 1} else Concat(*self.arrays)

    def to_latex(self, *operands: str) -> str:
        return matrix_latex([[operand] for operand in operands])


def _joined(node: Expr, shapes: Sequence[Shape], axis: int) -> Shape:
    """The shape of arrays joined along an axis."""
    name, first = type(node).__name__, shapes[0]
    for i, shape in enumerate(shapes):
        if len(shape) != len(first):
            raise ShapeError(
                f"{name} expects operands of one rank, got operand 0 with shape {first} and operand {i} with {shape}"
            )
        if shape[:axis] + shape[axis + 1 :] != first[:axis] + first[axis + 1 :]:
            raise ShapeError(
                f"{name} expects operands that agree in all axes but axis {axis}, "
                f"got operand 0 with shape {first} and operand {i} with {shape}"
            )
    return (*first[:axis], sum(shape[axis] for shape in shapes), *first[axis + 1 :])


class Block(Expr):
    """A matrix of blocks: `Block([[A, B], [C, D]])`. Scalars are 1x1 blocks, vectors are rows.

    Blocks with more than two axes are joined along the first two. A flat list is one row of blocks.

    Attributes:
        entries: all blocks, row by row.
        columns: blocks in a row.
    Raises:
        ShapeError: heights within a row, widths within a column, or further axes differ.
        ValueError: no blocks, or rows with different numbers of blocks.
    """

    entries: Operands
    columns: int

    def __init__(self, blocks: Sequence[Any]) -> None:
        if not blocks:
            raise ValueError("Block requires at least one row of blocks")
        rows = blocks if isinstance(blocks[0], (list, tuple)) else [blocks]
        widths = {len(row) for row in rows}
        if len(widths) > 1 or 0 in widths:
            raise ValueError(f"Block requires rows with the same number of blocks, got {[len(row) for row in rows]}")
        super().__init__(*(block for row in rows for block in row), columns=len(rows[0]))

    @property
    def blocks(self) -> list[list[Expr]]:
        """The rows of blocks."""
        return _rows(self.entries, self.columns)

    def infer_shape(self, *shapes: Shape) -> Shape:
        rows = _rows(_block_shapes(shapes), self.columns)
        for i, row in enumerate(rows):
            for j, shape in enumerate(row):
                if shape[0] != row[0][0]:
                    raise self._mismatch("heights", f"row {i}", [block[0] for block in row])
                if shape[1] != rows[0][j][1]:
                    raise self._mismatch("widths", f"column {j}", [other[j][1] for other in rows])
                if shape[2:] != rows[0][0][2:]:
                    raise self._mismatch("further axes", "all rows", [rows[0][0][2:], shape[2:]])
        return (sum(row[0][0] for row in rows), sum(shape[1] for shape in rows[0]), *rows[0][0][2:])

    @staticmethod
    def _mismatch(what: str, where: str, got: list[Any]) -> ShapeError:
        return ShapeError(
            f"Block expects equal {what} in {where}, got {got}", hint="a vector is a row; for a column use v[:, None]"
        )

    def evaluate(self, *values: jax.Array) -> jax.Array:
        if all(value.ndim == 0 for value in values):
            return jnp.stack(values).reshape(-1, self.columns)
        blocks = [value.reshape(shape) for value, shape in zip(values, _block_shapes([v.shape for v in values]))]
        rows = [row[0] if len(row) == 1 else jnp.concatenate(row, axis=1) for row in _rows(blocks, self.columns)]
        return jnp.concatenate(rows, axis=0)

    def simplify(self) -> Expr:
        """A single block of full rank is itself."""
        return self.entries[0] if len(self.entries) == 1 and len(self.entries[0].shape) > 1 else self

    def to_text(self, *operands: str) -> str:
        return f"Block([{', '.join('[' + ', '.join(row) + ']' for row in _rows(operands, self.columns))}])"

    def to_latex(self, *operands: str) -> str:
        return matrix_latex(_rows(operands, self.columns))

    @classmethod
    def example(cls) -> list[Example]:
        a, v, s = State("a", shape=(2, 2)), State("v", shape=(2,)), State("s")
        values = {"a": np.array([[1.0, -2.0], [0.5, 3.0]]), "v": np.array([1.0, -2.0]), "s": 0.5}
        return [
            Example(Block([[a, v[:, None]], [v, s]]), values),
            Example(Block([[s, 0.0], [1.0, -s]]), values),
            Example(Block([a[:, :, None], a[:, :, None]]), values),
        ]


def _rows(entries: Sequence[Any], columns: int) -> list[list[Any]]:
    return [list(entries[i : i + columns]) for i in range(0, len(entries), columns)]


def _block_shapes(shapes: Sequence[Shape]) -> list[Shape]:
    """The shapes padded in front to one rank of two or more."""
    rank = max(2, *map(len, shapes))
    return [(1,) * (rank - len(shape)) + shape for shape in shapes]
