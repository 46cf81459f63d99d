"""Matrices of blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ShapeError
from .fields import Operands
from .leaves import State
from .node import Example, Expr, Shape
from .printing import matrix_latex


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

    def replace(self, **changes: Any) -> Block:
        return Block(**({"blocks": self.blocks} | changes))

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


__all__ = ["Block"]
