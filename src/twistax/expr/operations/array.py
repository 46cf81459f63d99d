"""Construction of arrays: joined, stacked, and block matrices; and indexing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError, ShapeError
from ..bases import Variadic
from ..fields import ExprLike, Operand, Operands
from ..kinds import array_rules
from ..leaves import Constant
from ..node import Expr, Numbers, Shape
from ..printing.text import matrix_latex, wrap, wrap_latex
from .indices import as_slice, index_text, plain_index, positions, static_index


class _Parts(Variadic, init=False):
    """Base of nodes that join their operands, given one by one or in a list."""

    abstract = True
    listed = True

    def makes_boolean(self, *operands: bool) -> bool:
        return all(operands)

    def to_latex(self, *operands: str) -> str:
        return matrix_latex([[operand] for operand in operands])


class Concat(_Parts, init=False):
    """Pieces joined along the first axis. A scalar counts as a vector with one entry.

    Shapes: (), (n,), (m,) -> (1 + n + m,); (n, k), (m, k) -> (n + m, k). The pieces are passed one by one or in a list.

    Attributes:
        exprs: one or more expressions that agree in all axes but the first.
    Raises: ShapeError if the pieces differ in rank or beyond the first axis.
    """

    exprs: Operands
    associative = True
    kinds = array_rules.PIECES
    cases = (
        {"exprs": [0.3, [1.0, -2.0], Constant(4.0)]},
        {"exprs": [np.eye(2), Constant(np.ones((1, 2)))]},
        {"exprs": [0.3, -0.5]},
    )

    def infer_shape(self, *shapes: Shape) -> Shape:
        return _joined(self, [shape or (1,) for shape in shapes], 0)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        if all(value.ndim == 0 for value in values):
            return jnp.stack(values)
        return jnp.concatenate([jnp.atleast_1d(value) for value in values])

    def simplify(self) -> Expr:
        """A single vector is itself. Nested Concats are already joined."""
        return self.exprs[0] if len(self.exprs) == 1 and self.exprs[0].shape else self


class Stack(_Parts, init=False):
    """Rows of equal shape stacked along a new first axis.

    Shapes: k rows of shape s -> (k, *s). The rows are passed in a list or one by one.

    Attributes:
        rows: one or more expressions of equal shape.
    Raises: ShapeError if the rows differ in shape.
    """

    rows: Operands
    kinds = array_rules.ROWS
    cases = (
        {"rows": [[1.0, -2.0, 0.5], Constant(np.ones(3)), [0.3, 1.5, -1.0]]},
        {"rows": [2.0, Constant(0.0)]},
    )

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


class Hstack(_Parts, init=False):
    """Arrays side by side: joined along the second axis, vectors and scalars along the first.

    Shapes: (n, j), (n, k) -> (n, j + k); (j,), (k,) -> (j + k,). The arrays are passed in a list or one by one.

    Attributes:
        arrays: one or more expressions that agree in all axes but the joined one.
    Raises: ShapeError if the arrays differ in rank or beyond the joined axis.
    """

    arrays: Operands
    kinds = array_rules.PIECES
    cases = (
        {"arrays": [np.arange(6.0).reshape(2, 3), Constant(np.ones((2, 1)))]},
        {"arrays": [[1.0, -2.0], Constant(1.0), [0.3, 0.5]]},
    )

    def infer_shape(self, *shapes: Shape) -> Shape:
        shapes = tuple(shape or (1,) for shape in shapes)
        return _joined(self, shapes, min(len(shapes[0]) - 1, 1))

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.hstack(values)

    def simplify(self) -> Expr:
        """For vectors and scalars it is Concat; a single matrix is itself."""
        if len(self.shape) == 1:
            return Concat(*self.arrays)
        return self.arrays[0] if len(self.arrays) == 1 else self

    def to_latex(self, *operands: str) -> str:
        return matrix_latex([list(operands)])


class Vstack(_Parts, init=False):
    """Arrays on top of each other: joined along the first axis, a vector or scalar being one row.

    Shapes: (j, n), (k, n) -> (j + k, n); (n,), (n,) -> (2, n). The arrays are passed in a list or one by one.

    Attributes:
        arrays: one or more expressions that agree in all axes but the first.
    Raises: ShapeError if the arrays differ in rank or beyond the first axis.
    """

    arrays: Operands
    kinds = array_rules.ROWS
    cases = (
        {"arrays": [np.arange(6.0).reshape(2, 3), [1.0, -2.0, 0.5]]},
        {"arrays": [[1.0, -2.0, 0.5], [0.3, 1.5, -1.0]]},
    )

    def infer_shape(self, *shapes: Shape) -> Shape:
        return _joined(self, [(1,) * (2 - len(shape)) + shape for shape in shapes], 0)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.vstack(values)

    def simplify(self) -> Expr:
        """For vectors it is Stack, for matrices Concat."""
        ranks = {len(array.shape) for array in self.arrays}
        if ranks <= {1}:
            return Stack(*self.arrays)
        return self if ranks & {0, 1} else Concat(*self.arrays)


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
    """A block matrix: `Block([[A, B], [C, D]])`. Scalars are 1x1 blocks, vectors are rows.

    Blocks with more than two axes are joined along the first two. A flat list is one row of blocks.

    Attributes:
        entries: all blocks, row by row.
        columns: the number of blocks in a row.
    Raises:
        ShapeError: heights within a row, widths within a column, or further axes differ.
        ModelError: no blocks, or rows with different numbers of blocks.
    """

    entries: Operands
    columns: int
    by_values = True
    kinds = array_rules.PIECES
    cases = (
        (
            lambda cls, a, v, s: cls([[a, v[:, None]], [v, s]]),
            {"a": [[1.0, -2.0], [0.5, 3.0]], "v": [1.0, -2.0], "s": 0.5},
        ),
        (lambda cls, s: cls([[s, 0.0], [1.0, -s]]), {"s": 0.5}),
        (lambda cls, a: cls([a[:, :, None], a[:, :, None]]), {"a": [[1.0, -2.0], [0.5, 3.0]]}),
    )

    def __init__(self, blocks: Sequence[Any]) -> None:
        if not blocks:
            raise ModelError(f"Block expects at least one row of blocks, got {blocks!r}")
        rows = blocks if isinstance(blocks[0], (list, tuple)) else [blocks]
        widths = {len(row) for row in rows}
        if len(widths) > 1 or 0 in widths:
            raise ModelError(f"Block expects rows with the same number of blocks, got {[len(row) for row in rows]}")
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


def _rows(entries: Sequence[Any], columns: int) -> list[list[Any]]:
    return [list(entries[i : i + columns]) for i in range(0, len(entries), columns)]


def _block_shapes(shapes: Sequence[Shape]) -> list[Shape]:
    """The shapes padded in front to one rank of two or more."""
    rank = max(2, *map(len, shapes))
    return [(1,) * (rank - len(shape)) + shape for shape in shapes]


class Index(Expr):
    """Part of an array: base[index], NumPy's rules.

    Attributes:
        base: expression of any shape but ().
        index: whole numbers, slices, `...`, None, arrays of whole numbers or masks, or a tuple of these. It is fixed
            when the expression is built; a negative number counts from the end.
    Raises:
        ShapeError: an index out of bounds, too many indices, or an empty slice.
        OperationError: an index that is an expression, or is not an index.
    """

    base: Operand
    index: Any
    kinds = array_rules.PART
    by_operators = by_values = True
    cases = (
        (lambda cls, m: m[1:, 2], {"m": np.arange(12.0).reshape(3, 4)}),
        (lambda cls, m: m[-1], {"m": np.arange(12.0).reshape(3, 4)}),
        (lambda cls, m: m[..., None, :2], {"m": np.arange(12.0).reshape(3, 4)}),
        (lambda cls, m: m[[0, 2]], {"m": np.arange(12.0).reshape(3, 4)}),
        (lambda cls, v: v[3], {"v": [1.0, -2.0, 3.0, 0.5, 4.0]}),
        (lambda cls, v: v[::2], {"v": [1.0, -2.0, 3.0, 0.5, 4.0]}),
    )

    def __init__(self, base: ExprLike, index: Any) -> None:
        parts = tuple(map(static_index, index)) if isinstance(index, tuple) else (static_index(index),)
        super().__init__(base, parts[0] if len(parts) == 1 else parts)

    def infer_shape(self, *shapes: Shape) -> Shape:
        (shape,) = shapes
        try:
            result = np.broadcast_to(np.empty(()), shape)[self.index].shape
        except IndexError as error:
            raise ShapeError(
                f"Index expects an index into shape {shape}, got [{index_text(self.index)}]",
                hint="a scalar has no entries: use it without an index" if not shape else str(error),
            ) from None
        if 0 in result:
            raise ShapeError(
                f"Index expects at least one entry, got none of shape {shape} at [{index_text(self.index)}]",
                hint="start and stop must lie inside the array, start before stop",
            )
        return result

    def makes_boolean(self, *operands: bool) -> bool:
        return operands[0]

    def evaluate(self, *values: Numbers) -> Numbers:
        return values[0][self.index]

    def makes_group_element(self, *operands: bool) -> bool:
        if not operands[0] or self.base.shape != (4, 4) or self.shape != (3, 3):
            return False
        return bool((positions((4, 4), self.index) == _ROTATION_BLOCK).all())

    def simplify(self) -> Expr:
        """The full index of x is x; an index into stacked or joined rows is that row; nested indices are combined."""
        base, index = self.base, self.index
        if self.shape == base.shape and (positions(base.shape, index) == positions(base.shape, ...)).all():
            return base
        first, rest = (index[0], index[1:]) if isinstance(index, tuple) and index else (index, ())
        # Beside a list a whole number is a list too, for NumPy, which may move axes.
        lists = isinstance(index, tuple) and any(isinstance(part, np.ndarray) for part in index)
        if isinstance(base, Stack) and isinstance(first, int) and not lists:
            row = base.rows[first]
            return Index(row, rest) if rest else row
        if isinstance(base, Concat) and not rest:
            return _part_of_concat(self, base, first)
        if isinstance(base, Index) and len(base.base.shape) == 1 and isinstance(base.index, slice):
            return _part_of_slice(self, base, index)
        plain = plain_index(index, base.shape)
        return self if index_text(plain) == index_text(index) else Index(base, plain)

    def details(self) -> list[str]:
        return [f"[{index_text(self.index)}]"]

    def to_text(self, *operands: str) -> str:
        return f"{wrap(self.base, operands[0], 6)}[{index_text(self.index)}]"

    def to_latex(self, *operands: str) -> str:
        return f"{{{wrap_latex(self.base, operands[0], 100)}}}_{{[{index_text(self.index)}]}}"


#: Where the rotation stands in a pose.
_ROTATION_BLOCK = positions((4, 4), np.s_[:3, :3])


def _part_of_slice(node: Index, base: Index, index: Any) -> Expr:
    """(x[a:b])[c] as one index of x, for a vector x."""
    if not isinstance(index, (int, slice)):
        return node
    chosen = positions(base.base.shape, base.index)[index]
    return Index(base.base, as_slice(chosen) if isinstance(index, slice) else int(chosen))


def _part_of_concat(node: Index, base: Concat, index: Any) -> Expr:
    """An entry, or a range along the seams, of joined pieces as the piece itself."""
    if not isinstance(index, (int, slice)):
        return node
    sizes = [piece.shape[0] if piece.shape else 1 for piece in base.exprs]
    starts = np.cumsum([0, *sizes])
    chosen = np.arange(starts[-1])[index]
    first = int(np.searchsorted(starts, np.min(chosen), side="right")) - 1
    piece, offset = base.exprs[first], starts[first]
    if isinstance(index, int):
        return Index(piece, int(chosen - offset)) if piece.shape else piece
    last = int(np.searchsorted(starts, np.max(chosen), side="right")) - 1
    if first == last and piece.shape:
        return Index(piece, as_slice(chosen - offset))
    is_range = np.array_equal(chosen, np.arange(starts[first], starts[last + 1]))
    return Concat(*base.exprs[first : last + 1]) if is_range and len(chosen) < starts[-1] else node
