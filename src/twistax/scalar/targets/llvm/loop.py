"""A loop of JAX, `scan` or `while_loop`, as one function with all iterations, for a vector of batch members."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...loops import Ring
from ...primitives.interface import flat
from ...program import ScalarProgram
from .code import NAMES, Code
from .kernel_body import KernelBody, Rounded, Scalars, arguments_of, by_numpy, needed_by
from .lanes import COUNT, Array, Rows

#: The most operations that LLVM puts into vectors within one member, which takes twice as long to compile.
_PACKED = 3000
#: Functions of many instructions without a branch. Four of them pay off in vectors; sixteen fill wide ones.
_LONG = {"exp", "expm1", "logistic", "tanh"}
#: The least share of carried values with the same operations for vectors to pay off: products of matrices have it.
_MOST = 0.75


class LoopBody(KernelBody):
    """The kernel body of a loop, from (count, *fixed, *state, *rows) to (*state, *rows).

    The count of a scan is its length, at least one, which no kernel depends on. That of a `while_loop` bounds the
    iterations; -1: nothing does.

    Args:
        program: one iteration.
    """

    tried = 3

    def __init__(self, program: ScalarProgram, lanes: int, ring: Ring) -> None:
        self.ring = ring
        inputs = arguments_of(program)
        self._rows = inputs[ring.fixed + ring.state :]
        arguments = [COUNT, *inputs[: ring.fixed + ring.state], *(_long(a) for a in self._rows)]
        outputs = [Array(a.shape, t) for a, t in zip(program.outputs, program.types, strict=True)]
        outputs = outputs[ring.length is None :]
        self._results = outputs[ring.state :]
        results = [*outputs[: ring.state], *(_long(a) for a in self._results)]
        states = range(ring.fixed + 1, ring.fixed + ring.state + 1)
        carried = [i for nodes in program.outputs[ring.length is None :][: ring.state] for i in flat(nodes)]
        self.packed = _width(program, carried)
        super().__init__(program, lanes, arguments, results, {k + 1 for k in needed_by(program)} | {0, *states})

    def body(self, code: Code, rows: Mapping[str, Rows]) -> None:
        step, ring = self.program, self.ring
        first_row = ring.fixed + ring.state
        states = [(k, j) for k in range(ring.fixed, first_row) for j in range(step.inputs[k].size)]
        kinds = [NAMES[self.arguments[k + 1].dtype] for k, _ in states]
        starts = [rows[f"a{k + 1}"].read(j) for k, j in states]
        now = {place: code.name() for place in states}
        windows: dict[int, Rows] = {}

        def read(argument: int, entry: int) -> str:
            if argument in windows:
                return windows[argument].read(entry)
            return now.get((argument, entry)) or rows[f"a{argument + 1}"].read(entry)

        scalars = Scalars(code, step, read)
        changing = step.depending(range(ring.fixed, len(step.inputs)))
        scalars.compute([i for i in step.live if i not in changing])
        one = code.entry("i32", rows["a0"].read(0), 0)
        count, k, live = code.emit(f"sext i32 {one} to i64"), code.name(), code.name()
        last = code.emit(f"sub i64 {count}, 1")
        carried = [(k, "i64", "0")]
        if ring.length is None:
            carried.append((live, code.vector("i1"), code.constant("i1", True)))
        carried += [(now[p], code.vector(kind), start) for p, kind, start in zip(states, kinds, starts, strict=True)]
        end = code.loop(carried)
        place = code.emit(f"sub i64 {last}, {k}") if ring.reverse else k

        def window(name: str, array: Array) -> Rows:
            return rows[name].window([code.emit(f"mul i64 {place}, {array.size}")] * code.lanes, array)

        windows |= {n: window(f"a{n + 1}", a) for n, a in enumerate(self._rows, first_row) if n + 1 in self.read}
        outputs = scalars.compute(step.flat)
        after = outputs[ring.length is None :][: len(states)]
        following, flags = code.emit(f"add i64 {k}, 1"), list[str]()
        again = code.emit(f"icmp ult i64 {following}, {count}")
        if ring.length is None:
            flags.append(going := code.instruction("and", "i1", live, outputs[0]))
            after = [code.select(kind, going, new, now[p]) for kind, p, new in zip(kinds, states, after, strict=True)]
            again = code.emit(f"and i1 {again}, {code.any(going)}")
        for n, array in enumerate(self._results, ring.state):
            if array.size:
                window(f"r{n}", array).write(scalars.compute(flat(step.outputs[n])))
        end([following, *flags, *after], again)
        ends = iter(after)
        for n in range(ring.state):
            values = [next(ends) for _ in range(self.results[n].size)]
            if values:
                rows[f"r{n}"].write(values)

    def exercised(self, arguments: list[NDArray[Any]]) -> list[NDArray[Any]]:
        return [np.full_like(arguments[0], self.tried), *arguments[1:]]

    def plain(self, arguments: Sequence[NDArray[Any]], rounded: Rounded = np.asarray) -> list[NDArray[Any]]:
        ring, (count, *rest) = self.ring, arguments
        length = int(count[0, 0])
        fixed, state = rest[: ring.fixed], rest[ring.fixed : ring.fixed + ring.state]
        longer = rest[ring.fixed + ring.state :]
        rows = [np.zeros((len(count), length * a.size), a.dtype) for a in self._results]
        live = np.ones((len(count), 1), bool)
        for k in range(length):
            place = length - 1 - k if ring.reverse else k
            here = [_part(a, place, array.size) for a, array in zip(longer, self._rows, strict=True)]
            outputs = by_numpy(self.program, [*fixed, *state, *here], rounded)
            if ring.length is None:
                live = live & outputs.pop(0)
            state = [np.where(live, new, old) for new, old in zip(outputs, state, strict=False)]
            for a, array, new in zip(rows, self._results, outputs[ring.state :], strict=True):
                _part(a, place, array.size)[:] = new
        return [*state, *rows]


def _width(program: ScalarProgram, carried: Sequence[int]) -> int:
    """Bits of vectors within one member; 0 where they do not pay off."""
    long = sum(count for name, count in program.counts().items() if name in _LONG)
    if program.operations > _PACKED:
        return 0
    return 512 if long >= 16 else 256 if long >= 4 or _alike(program, carried) else 0


def _alike(program: ScalarProgram, nodes: Sequence[int]) -> bool:
    """Whether most nodes, at least four, have the same last operations, three levels of them; sums are differences."""
    g = program.graph

    def names(i: int, levels: int) -> list[str]:
        operation = g.operation(i)
        if operation is None or levels == 0:
            return []
        kind = "add" if operation.name == "sub" else operation.name
        return sorted([kind, *(name for a in g.arguments(i) for name in names(a, levels - 1))])

    count = max(Counter(tuple(names(i, 3)) for i in nodes).values(), default=0)
    return count >= max(4, _MOST * len(nodes))


def _long(array: Array) -> Array:
    return Array(array.shape, array.dtype, long=True)


def _part(a: NDArray[Any], place: int, size: int) -> NDArray[Any]:
    return a[:, place * size : (place + 1) * size]
