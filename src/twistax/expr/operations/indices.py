"""Indices as plain data: parsing, printing, and conversion to positions."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from ...errors import OperationError
from ..node import Expr, Shape


def static_index(index: Any) -> Any:
    """One part of an index as plain data: ints, slices of ints, `...`, None, or arrays of whole numbers or masks."""
    if index is None or index is Ellipsis:
        return index
    if isinstance(index, slice):
        return slice(*(None if part is None else _whole(part) for part in (index.start, index.stop, index.step)))
    if isinstance(index, (list, np.ndarray, jax.Array)) and np.ndim(index) > 0:
        array = np.array(index)
        if array.dtype.kind not in "iub":
            raise OperationError(f"Index expects whole numbers or a mask, got an array of {array.dtype}")
        array.setflags(write=False)
        return array
    return _whole(index)


def _whole(index: Any) -> int:
    if isinstance(index, Expr):
        raise OperationError(
            f"an index is fixed when the expression is built; {index!r} is an expression.\n"
            "  fix: select entries at run time with tx.Where, or look up values with tx.Linterp"
        )
    if isinstance(index, (bool, np.bool_)):
        raise OperationError(f"Index expects whole numbers, got a truth value: {index}")
    try:
        return index.__index__()
    except (AttributeError, TypeError):
        raise OperationError(f"Index expects whole numbers, slices, ... or None, got {index!r}") from None


def index_text(index: Any) -> str:
    """The text of the index between brackets."""
    if isinstance(index, tuple):
        return ", ".join(map(index_text, index)) if index else "()"
    if isinstance(index, slice):
        text = ":".join("" if part is None else str(part) for part in (index.start, index.stop))
        return text if index.step is None else f"{text}:{index.step}"
    if isinstance(index, np.ndarray):
        return str(index.tolist())
    return "..." if index is Ellipsis else str(index)


def plain_index(index: Any, shape: Shape) -> Any:
    """A canonical form of an index of whole numbers and slices, without negative or missing numbers."""
    parts = index if isinstance(index, tuple) else (index,)
    if not all(isinstance(part, (int, slice)) for part in parts):
        return index
    plain = tuple(as_slice(range(n)[p]) if isinstance(p, slice) else range(n)[p] for n, p in zip(shape, parts))
    return plain if isinstance(index, tuple) else plain[0]


def positions(shape: Shape, index: Any) -> Any:
    """The positions of the selected entries in the flattened array."""
    return np.arange(int(np.prod(shape))).reshape(shape)[index]


def as_slice(chosen: Any) -> slice:
    """Evenly spaced positions as a slice."""
    step = int(chosen[1] - chosen[0]) if len(chosen) > 1 else 1
    stop = int(chosen[-1]) + (1 if step > 0 else -1)
    return slice(int(chosen[0]), None if stop < 0 else stop, None if step == 1 else step)
