"""Products of matrices and reductions: sums along axes, in blocks that stay in registers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scalar.entry import Operation
from ...scalar.table import OPERATIONS
from ..code import NAMES, Code, NotNative
from .memory import View, known
from .sweep import ArrayCode, merged, reshaped

if TYPE_CHECKING:
    from .reader import Reading

#: Rows and vectors of a block of a product: as many sums as a processor works on at a time.
_ROWS, _VECTORS = 4, 2

# ---- products --------------------------------------------------------------------------------------------------------


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

    def products(code: Code, kind: str, values: Sequence[str]) -> str:
        return code.multiply_add(kind, *values)

    _sums(own, [left, right], found, (3,), OPERATIONS["add"], 0.0, products)
    return found


# ---- reductions ------------------------------------------------------------------------------------------------------

#: What takes a sum further: given the values that were read, then the sum so far.
Further = Callable[[Code, str, Sequence[str]], str]


def _sums(
    own: ArrayCode,
    sources: Sequence[View],
    to: View,
    axes: Sequence[int],
    operation: Operation,
    neutral: Any,
    further: Further,
) -> None:
    """The reduction of what is read along axes, written where the others lead."""
    kind = NAMES[to.dtype]
    keep = [d for d in range(sources[0].array.ndim) if d not in axes]
    kept = merged([to, *(_first_of(v, keep, axes) for v in sources)], to.array)
    order = sorted(range(len(keep)), key=lambda d: -abs(to.array.strides[d]))
    moved = [v.seen(v.array.transpose([*(keep[d] for d in order), *axes])) for v in sources]
    ends = merged([v.seen(v.array[(0,) * len(keep)]) for v in moved])
    sides = kept[0].array.ndim
    # Views whose axes are first those that stay, then those that go, both as few as can be.
    views = [
        View(
            v.base,
            v.origin,
            np.lib.stride_tricks.as_strided(
                v.array, (*k.shape, *e.shape), (*k.array.strides, *e.array.strides), writeable=False
            ),
            v.place,
        )
        for v, k, e in zip(moved, kept[1:], ends, strict=True)
    ]
    item = to.dtype.itemsize
    side_by_side = sides > 0 and any(v.array.strides[sides - 1] == item for v in views)
    turns = ends[0].shape

    def total(
        code: Code, read: Callable[[Code, View], str], own_views: Sequence[View], shape: Sequence[int], start: str
    ) -> str:
        """The sum over axes, the first ones of views."""
        if not shape:
            return further(code, kind, [*(read(code, v) for v in own_views), start])

        def inner(index: str, values: list[str]) -> list[str]:
            return [total(code, read, [own.along(v, 0, index) for v in own_views], shape[1:], values[0])]

        return own.counted(shape[0], inner, [(code.vector(kind), start)])[0]

    if side_by_side or not turns:

        def lines(these: list[View]) -> None:
            result, *rest = these
            if not sides:
                result = result.seen(result.array.reshape(1))
                rest = [v.seen(v.array.reshape(1, *v.shape)) for v in rest]

            def piece(code: Code, index: str, first: int) -> None:
                mine = [own.at(v, index, own.lanes * v.array.strides[0]) for v in (result, *rest)]
                forward = [v.seen(np.moveaxis(v.array, 0, -1)) for v in mine[1:]]
                read = lambda code, v: own.read(code, v, first)  # noqa: E731
                value = total(code, read, forward, turns, code.constant(kind, neutral))
                own.write(code, mine[0], first, value)

            own.pieces(result.shape[0], piece)

        own.nested(kept[0].shape[:-1], [kept[0], *views], lines)
        return

    def single(these: list[View]) -> None:
        result, *rest = these
        full, left = divmod(turns[-1], own.lanes)
        code = own.code.of(own.lanes)
        value = code.constant(kind, neutral)

        def line(index: str, values: list[str], first: int, width: int) -> list[str]:
            here = [own.at(v, index, own.lanes * v.array.strides[-1]) for v in rest]
            narrow = own.code.of(width)
            read = lambda code, v: own.read(code, v, first)  # noqa: E731
            begin = values[0] if width == own.lanes else narrow.constant(kind, neutral)
            return [total(narrow, read, here, turns[:-1], begin)]

        if full:
            value = own.counted(full, lambda k, v: line(k, v, 0, own.lanes), [(code.vector(kind), value)])[0]
        found = _across(own, kind, value, own.lanes, operation) if full else None
        if left:
            (tail,) = line("0", [], full * own.lanes, left)
            last = _across(own, kind, tail, left, operation)
            found = last if found is None else _combined(own.code, kind, operation, found, last)
        own.write(own.code, result.seen(result.array.reshape(1)), 0, found or own.code.constant(kind, neutral))

    own.nested(kept[0].shape, [kept[0], *views], single)


def _first_of(view: View, keep: Sequence[int], axes: Sequence[int]) -> View:
    """Without some axes, at their first entry."""
    array = view.array.transpose([*axes, *keep])
    return view.seen(array[(0,) * len(axes)] if keep else array.reshape(-1)[:1].reshape(()))


def _combined(code: Code, kind: str, operation: Operation, a: str, b: str) -> str:
    form = operation.llvm.of(np.dtype({"double": np.float64, "float": np.float32, "i1": bool}.get(kind, np.int64)))
    return str(form(code, kind, a, b))


def _across(own: ArrayCode, kind: str, vector: str, lanes: int, operation: Operation) -> str:
    """The reduction of the lanes of a vector: halves of it with each other, as long as they are even."""
    while lanes > 1 and lanes % 2 == 0:
        wide, half = own.code.of(lanes), lanes // 2
        parts = []
        for first in (0, half):
            order = ", ".join(f"i32 {k}" for k in range(first, first + half))
            parts.append(
                wide.emit(
                    f"shufflevector {wide.vector(kind)} {vector}, {wide.vector(kind)} poison, <{half} x i32> <{order}>"
                )
            )
        if half == 1:
            # A vector of one is not a number.
            parts = [wide.emit(f"extractelement <1 x {kind}> {p}, i32 0") for p in parts]
        vector, lanes = _combined(own.code.of(half), kind, operation, *parts), half
    wide = own.code.of(lanes)
    entries = [wide.entry(kind, vector, k) for k in range(lanes)]
    found = entries[0]
    for entry in entries[1:]:
        found = _combined(own.code, kind, operation, found, entry)
    return found


def _least(dtype: np.dtype[Any]) -> Any:
    return -np.inf if dtype.kind == "f" else False if dtype.kind == "b" else np.iinfo(dtype).min


def _most(dtype: np.dtype[Any]) -> Any:
    return np.inf if dtype.kind == "f" else True if dtype.kind == "b" else np.iinfo(dtype).max


def _reduction(name: str, neutral: Callable[[np.dtype[Any]], Any], numbers: Any) -> Callable[..., View]:
    operation = OPERATIONS[name]

    def reduce(own: Reading, eqn: Any, a: View) -> View:
        axes = tuple(eqn.params["axes"])
        shape = eqn.outvars[0].aval.shape
        if a.known:
            return known(np.asarray(numbers(a.array, axis=axes, initial=neutral(a.dtype)), a.dtype))
        if 0 in shape:
            return own.code.new(shape, a.dtype)
        if 0 in a.shape:
            return known(np.full(shape, neutral(a.dtype), a.dtype))

        def further(code: Code, kind: str, values: Sequence[str]) -> str:
            return _combined(code, kind, operation, values[1], values[0])

        found = own.code.new(shape, a.dtype)
        _sums(own.code, [a], found, axes, operation, neutral(a.dtype), further)
        return found

    return reduce


def any_of(own: ArrayCode, flags: View) -> View:
    """Whether a truth value holds anywhere."""
    if not flags.shape:
        return flags
    if flags.known:
        return known(flags.array.any())
    found = own.new((), bool)
    combined = lambda code, kind, values: _combined(code, kind, OPERATIONS["or"], *values)  # noqa: E731
    _sums(own, [flags], found, tuple(range(flags.array.ndim)), OPERATIONS["or"], False, combined)
    return found


#: By primitive.
SUMS: dict[str, Callable[..., Any]] = {
    "dot_general": _dot_general,
    "reduce_sum": _reduction("add", lambda dtype: dtype.type(0), np.sum),
    "reduce_prod": _reduction("mul", lambda dtype: dtype.type(1), np.prod),
    "reduce_max": _reduction("max", _least, np.max),
    "reduce_min": _reduction("min", _most, np.min),
    "reduce_and": _reduction("and", lambda dtype: dtype.type(-1) if dtype.kind == "i" else True, np.bitwise_and.reduce),
    "reduce_or": _reduction("or", lambda dtype: dtype.type(0), np.bitwise_or.reduce),
}
