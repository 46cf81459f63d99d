"""A product of matrices in a long program: a loop over columns in memory.

For one member the columns of the loop are computed side by side in a vector.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ....graph import OpaqueCall
from ..code import NAMES, Code
from .pieces import Scratch

#: Rows of the right factor whose entries of a column wait in registers; of more each is loaded where it is multiplied.
_LOADED = 16


def write_product(code: Code, scratch: Scratch, call: OpaqueCall, value: Callable[[int], str]) -> None:
    """Add the loop.

    Args:
        value: the value of a node, read where it is needed.
    """
    g, kind = scratch.graph, NAMES[scratch.graph.dtype]
    (left, right), (result,) = call.arguments, call.results
    count, size = right.shape[1], 8 * code.lanes
    side = code
    if code.lanes == 1 and g.dtype == np.float64:
        side = code.of(min(code.module.processor.lanes(g.dtype), 1 << count.bit_length() - 1))
    width = side.lanes if code.lanes == 1 else 1
    vector = side.vector(kind)

    def at(base: str, slot: int) -> str:
        return code.emit(f"getelementptr i8, ptr {base}, i64 {size * slot}")

    starts, copied = list[int](), 0
    for row in right.tolist():
        start = scratch.row(row)
        if start is None:
            start = scratch.further(copied + count - 1) - count + 1
            copied += count
            for j, node in enumerate(row):
                code.lines.append(f"store {code.vector(kind)} {value(node)}, ptr {at('%scratch', start + j)}, align 8")
        starts.append(start)
    block = code.name()
    end = code.loop([(block, "i64", "0")])
    first = code.emit(f"mul i64 {block}, {width}")
    if count % width:  # the last block reaches back
        first = code.call("i64", "llvm.umin.i64", ("i64", first), ("i64", str(count - width)))
    columns = code.emit(f"getelementptr i8, ptr %scratch, i64 {code.emit(f'mul i64 {first}, {size}')}")

    def load(k: int) -> str:
        return code.emit(f"load {vector}, ptr {at(columns, starts[k])}, align 8")

    loaded = [load(k) for k in range(len(starts))] if len(starts) <= _LOADED else []
    for nodes, row in zip(left.tolist(), result.tolist(), strict=True):
        total, place = "", scratch.row(row)
        assert place is not None
        for k, node in enumerate(nodes):
            if node == g.zero:
                continue
            a, b = value(node), loaded[k] if loaded else load(k)
            if side is not code:
                a = side.spread(kind, a) if side.lanes > 1 else a
            total = side.multiply_add(kind, a, b, total) if total else side.instruction("fmul", kind, a, b)
        code.lines.append(f"store {vector} {total}, ptr {at(columns, place)}, align 8")
    following = code.emit(f"add i64 {block}, 1")
    end([following], code.emit(f"icmp ult i64 {following}, {-(-count // width)}"))


def product_by_numpy(call: OpaqueCall, values: dict[int, NDArray]) -> dict[int, NDArray]:
    """The results of a product of matrices, whose entries are arrays of members."""
    left, right = ([[values[i] for i in row] for row in factor.tolist()] for factor in call.arguments)
    product = np.einsum("ikn,kjn->ijn", np.array(left), np.array(right))
    return {i: product[place] for place, i in np.ndenumerate(call.results[0])}
