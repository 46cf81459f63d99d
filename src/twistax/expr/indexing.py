"""Parts of arrays."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from ..errors import ShapeError
from .array import Concat, Stack
from .fields import ExprLike, Operand
from .leaves import State
from .node import Example, Expr, Numbers, Shape
from .printing import wrap, wrap_latex


class Index(Expr):
    """Part of an array: base[index], NumPy's rules.

    Attributes:
        base: expression of any shape but ().
        index: whole numbers, slices, `...`, None, arrays of whole numbers or masks, or a tuple of these. It is fixed
            when the expression is built; a negative number counts from the end.
    Raises:
        ShapeError: an index out of bounds, too many of them, or a part without entries.
        TypeError: an index that is an expression or no index at all.
    """

    base: Operand
    index: Any
    by_operators = True

    def __init__(self, base: ExprLike, index: Any) -> None:
        parts = tuple(map(_static, index)) if isinstance(index, tuple) else (_static(index),)
        super().__init__(base, parts[0] if len(parts) == 1 else parts)

    def infer_shape(self, *shapes: Shape) -> Shape:
        (shape,) = shapes
        try:
            found = np.broadcast_to(np.empty(()), shape)[self.index].shape
        except IndexError as error:
            raise ShapeError(
                f"Index expects an index into shape {shape}, got [{index_text(self.index)}]",
                hint="a scalar has no entries: use it as it is" if not shape else str(error),
            ) from None
        if 0 in found:
            raise ShapeError(
                f"Index expects at least one entry, got none of shape {shape} at [{index_text(self.index)}]",
                hint="start and stop must lie inside the array, start before stop",
            )
        return found

    @property
    def boolean(self) -> bool:
        return self.base.boolean

    def evaluate(self, *values: Numbers) -> Numbers:
        return values[0][self.index]

    def makes_group_element(self, *operands: bool) -> bool:
        if not operands[0] or self.base.shape != (4, 4) or self.shape != (3, 3):
            return False
        return bool((_positions((4, 4), self.index) == _ROTATION_BLOCK).all())

    def simplify(self) -> Expr:
        """Everything of x is x; a part of stacked or joined rows is that row; a part of a part is one part."""
        base, index = self.base, self.index
        if self.shape == base.shape and (_positions(base.shape, index) == _positions(base.shape, ...)).all():
            return base
        first, rest = (index[0], index[1:]) if isinstance(index, tuple) and index else (index, ())
        if isinstance(base, Stack) and isinstance(first, int):
            row = base.rows[first]
            return Index(row, rest) if rest else row
        if isinstance(base, Concat) and not rest:
            return _part_of_concat(self, base, first)
        if isinstance(base, Index) and len(base.base.shape) == 1 and isinstance(base.index, slice):
            return _part_of_slice(self, base, index)
        plain = _plain(index, base.shape)
        return self if index_text(plain) == index_text(index) else Index(base, plain)

    def details(self) -> list[str]:
        return [f"[{index_text(self.index)}]"]

    def to_text(self, *operands: str) -> str:
        return f"{wrap(self.base, operands[0], 6)}[{index_text(self.index)}]"

    def to_latex(self, *operands: str) -> str:
        return f"{{{wrap_latex(self.base, operands[0], 100)}}}_{{[{index_text(self.index)}]}}"

    @classmethod
    def example(cls) -> list[Example]:
        m, v = State("m", shape=(3, 4)), State("v", shape=(5,))
        values = {"m": np.arange(12.0).reshape(3, 4), "v": np.array([1.0, -2.0, 3.0, 0.5, 4.0])}
        picks = [m[1:, 2], m[-1], m[..., None, :2], m[[0, 2]], v[3], v[::2]]
        return [Example(pick, values) for pick in picks]


def _static(index: Any) -> Any:
    """One part of an index as plain data: ints, slices of ints, `...`, None, or arrays of whole numbers or masks."""
    if index is None or index is Ellipsis:
        return index
    if isinstance(index, slice):
        return slice(*(None if part is None else _whole(part) for part in (index.start, index.stop, index.step)))
    if isinstance(index, (list, np.ndarray, jax.Array)) and np.ndim(index) > 0:
        array = np.array(index)
        if array.dtype.kind not in "iub":
            raise TypeError(f"Index expects whole numbers or a mask, got an array of {array.dtype}")
        array.setflags(write=False)
        return array
    return _whole(index)


def _whole(index: Any) -> int:
    if isinstance(index, Expr):
        raise TypeError(
            f"an index is fixed when the expression is built; {index!r} is an expression.\n"
            "  fix: choose entries at run time with tx.Where, or look values up with tx.Linterp"
        )
    if isinstance(index, (bool, np.bool_)):
        raise TypeError("Index expects whole numbers, got a truth value")
    try:
        return index.__index__()
    except (AttributeError, TypeError):
        raise TypeError(f"Index expects whole numbers, slices, ... or None, got {index!r}") from None


def index_text(index: Any) -> str:
    """The index as one would type it between brackets."""
    if isinstance(index, tuple):
        return ", ".join(map(index_text, index)) if index else "()"
    if isinstance(index, slice):
        text = ":".join("" if part is None else str(part) for part in (index.start, index.stop))
        return text if index.step is None else f"{text}:{index.step}"
    if isinstance(index, np.ndarray):
        return str(index.tolist())
    return "..." if index is Ellipsis else str(index)


def _plain(index: Any, shape: Shape) -> Any:
    """One way of writing an index of whole numbers and slices: none negative, starts and stops in full."""
    parts = index if isinstance(index, tuple) else (index,)
    if not all(isinstance(part, (int, slice)) for part in parts):
        return index
    plain = tuple(_run(range(n)[p]) if isinstance(p, slice) else range(n)[p] for n, p in zip(shape, parts))
    return plain if isinstance(index, tuple) else plain[0]


def _positions(shape: Shape, index: Any) -> Any:
    """Where the chosen entries stand in the flattened array."""
    return np.arange(int(np.prod(shape))).reshape(shape)[index]


#: Where the rotation stands in a pose.
_ROTATION_BLOCK = _positions((4, 4), np.s_[:3, :3])


def _part_of_slice(node: Index, base: Index, index: Any) -> Expr:
    """(x[a:b])[c] as one index of x, for a vector x."""
    if not isinstance(index, (int, slice)):
        return node
    chosen = _positions(base.base.shape, base.index)[index]
    return Index(base.base, _run(chosen) if isinstance(index, slice) else int(chosen))


def _run(chosen: Any) -> slice:
    """Evenly spaced positions as a slice."""
    step = int(chosen[1] - chosen[0]) if len(chosen) > 1 else 1
    stop = int(chosen[-1]) + (1 if step > 0 else -1)
    return slice(int(chosen[0]), None if stop < 0 else stop, None if step == 1 else step)


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
        return Index(piece, _run(chosen - offset))
    along = np.array_equal(chosen, np.arange(starts[first], starts[last + 1]))
    return Concat(*base.exprs[first : last + 1]) if along and len(chosen) < starts[-1] else node
