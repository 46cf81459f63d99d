"""Products of matrices: blocks of their sums stay in registers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..code import NAMES, Code, NotNative
from .memory import View, known
from .reductions import reduced
from .sweep import ArrayCode, reshaped

if TYPE_CHECKING:
    from .reader import Reading

#: Rows and vectors of a block of a product: as many sums as a processor works on at a time.
_ROWS, _VECTORS = 4, 2


def _dot_general(own: Reading, eqn: Any, a: View, b: View) -> View:
    (contract_a, contract_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]
    dtype = np.dtype(eqn.outvars[0].aval.dtype)
    if a.dtype != b.dtype or a.dtype != dtype or dtype.kind != "f":
        raise NotNative(f"a product of {a.dtype} and {b.dtype} has no native form")
    shape = eqn.outvars[0].aval.shape
    free_a = [d for d in range(a.array.ndim) if d not in (*contract_a, *batch_a)]
    free_b = [d for d in range(b.array.ndim) if d not in (*contract_b, *batch_b)]
    batch, sums = [a.shape[d] for d in batch_a], [a.shape[d] for d in contract_a]
    rows, columns = [a.shape[d] for d in free_a], [b.shape[d] for d in free_b]
    count, inner = math.prod(batch), math.prod(sums)
    left = a.seen(a.array.transpose([*batch_a, *free_a, *contract_a]))
    right = b.seen(b.array.transpose([*batch_b, *contract_b, *free_b]))
    if a.known and b.known:
        parts = [
            x.array.reshape(count, *own_shape)
            for x, own_shape in ((left, (math.prod(rows), inner)), (right, (inner, math.prod(columns))))
        ]
        return known((parts[0] @ parts[1]).reshape(shape))
    if 0 in shape:
        return own.code.new(shape, dtype)
    if inner == 0:
        return known(np.zeros(shape, dtype))
    left = reshaped(own.code, left, (count, math.prod(rows), inner))
    right = reshaped(own.code, right, (count, inner, math.prod(columns)))
    found = _product(own.code, own.code.stored(left), own.code.stored(right))
    return reshaped(own.code, found, shape)


def _product(own: ArrayCode, a: View, b: View) -> View:
    """(count, rows, inner) by (count, inner, columns)."""
    count, rows, _ = a.shape
    columns, item = b.shape[2], a.dtype.itemsize
    along_columns = columns > 1 and b.array.strides[2] == item
    along_rows = rows > 1 and a.array.strides[1] == item
    if along_rows and (not along_columns or columns < own.lanes <= rows):
        turned = _product(own, b.seen(b.array.swapaxes(1, 2)), a.seen(a.array.swapaxes(1, 2)))
        return turned.seen(turned.array.swapaxes(1, 2))
    if min(rows, columns) == 1 and not along_columns:
        return _inner_products(own, a, b)
    if not along_columns:
        b = own.copied(b)
    found = own.new((count, rows, columns), a.dtype)
    own.nested([count], [a, b, found], lambda views: _matrix(own, *views))
    return found


def _matrix(own: ArrayCode, a: View, b: View, to: View) -> None:
    """One product of matrices, b and the result with entries of a row side by side."""
    (rows, _), columns = a.shape, b.shape[1]
    width = own.lanes * _VECTORS
    blocks, rest = divmod(columns, width)

    def block_of_columns(index: str, first: int, size: int) -> None:
        here = [own.at(v, index, width * v.array.strides[1]) for v in (b, to)]
        right, result = (v.seen(v.array[:, first : first + size]) for v in here)
        whole, others = divmod(rows, _ROWS)

        def block_of_rows(row: str, height: int, start: int) -> None:
            mine = [own.at(v, row, _ROWS * v.array.strides[0]) for v in (a, result)]
            left, to_here = (v.seen(v.array[start : start + height]) for v in mine)
            _block(own, left, to_here, right)

        def several(row: str, _: list[str]) -> list[str]:
            block_of_rows(row, _ROWS, 0)
            return []

        own.counted(whole, several)
        if others:
            block_of_rows("0", others, whole * _ROWS)

    def one(index: str, _: list[str]) -> list[str]:
        block_of_columns(index, 0, width)
        return []

    own.counted(blocks, one)
    if rest:
        block_of_columns("0", blocks * width, rest)


def _block(own: ArrayCode, a: View, to: View, b: View) -> None:
    """Some rows and columns of a product, their sums in registers."""
    rows, inner = a.shape
    kind = NAMES[a.dtype]
    starts = range(0, b.shape[1], own.lanes)
    codes = [own.code.of(min(own.lanes, b.shape[1] - start)) for start in starts]
    sums = [(code.vector(kind), "zeroinitializer" if code.lanes > 1 else "0.0") for _ in range(rows) for code in codes]

    def add(index: str, values: list[str]) -> list[str]:
        line, column = own.along(b, 0, index), own.along(a, 1, index)
        right = [own.read(code, line, start) for code, start in zip(codes, starts, strict=True)]
        found = []
        for row in range(rows):
            number = own.read(own.code, column, row)
            for k, code in enumerate(codes):
                left = number if code.lanes == 1 else code.spread(kind, number)
                found.append(code.multiply_add(kind, left, right[k], values[row * len(codes) + k]))
        return found

    values = own.counted(inner, add, sums)
    for row in range(rows):
        line = to.seen(to.array[row])
        for k, (code, start) in enumerate(zip(codes, starts, strict=True)):
            own.write(code, line, start, values[row * len(codes) + k])


def _inner_products(own: ArrayCode, a: View, b: View) -> View:
    """Where rows or columns are one: sums of products along what may lie side by side."""
    count, rows, _ = a.shape
    columns = b.shape[2]
    shape = (count, rows, columns, a.shape[2])
    left = a.seen(np.broadcast_to(a.array[:, :, None, :], shape))
    right = b.seen(np.broadcast_to(b.array.swapaxes(1, 2)[:, None], shape))
    found = own.new(shape[:3], a.dtype)

    def further(code: Code, kind: str, values: Sequence[str]) -> str:
        return code.multiply_add(kind, *values)

    reduced(own, [left, right], found, (3,), "add", further)
    return found


#: By primitive.
PRODUCTS: dict[str, Callable[..., View]] = {"dot_general": _dot_general}
