"""A program that is run on its own results, iteration by iteration, as one function of as many bodies as lanes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scalar.in_llvm import NAMES
from ..scalar.program import ScalarProgram
from .code import Code, Module
from .scalars import Scalars
from .tile import Signature, Tile, by_numpy, rows_of, shapes_of

__all__ = ["Iterations"]

#: Places of the first arguments: the number of the first iteration, and the number at which to stop.
_FIRST, _STOP = 0, 1


class Iterations(Tile):
    """state = step(k, fixed, state) for k = first, first + 1, ..., stop - 1, or until it ends as `Repeated` says.

    Takes (first, stop, *fixed, *state), gives (*state, k): the state, and the number of the next iteration. Each body
    iterates as long as it must. What stays the same is computed once.

    Args:
        step: from `native_form`; takes (k, *fixed, *state), gives (*state) or (*state, more), all states of the
            program's precision.
        state: how many arguments are the state.
    """

    def __init__(self, step: ScalarProgram, state: int, lanes: int) -> None:
        self.step = step
        self.lanes = lanes
        number, *rest = shapes_of(step)
        self.arguments = [number, number, *rest]
        self.results = [*rest[len(rest) - state :], number]
        g = step.graph
        needed = {place[0] + 1 for i in step.live if (place := g.input_of(i)) is not None}
        needed |= {_FIRST, _STOP, *range(len(self.arguments) - state, len(self.arguments))}
        self.signature = Signature(rows_of(self.arguments, needed), rows_of(self.results))
        #: The first argument of the step that is state.
        self._first_state = len(rest) - state + 1
        #: Whether the step says if another iteration follows.
        self._says = len(step.outputs) > state
        self.chunk = lanes  # many iterations are much work

    def write(self, module: Module) -> None:
        step, g = self.step, self.step.graph
        code, reads, writes = self.begin(module)
        counter, kind = NAMES[self.arguments[_FIRST][1]], NAMES[g.dtype]
        counters, numbers, flags = code.vector(counter), code.vector(kind), code.vector("i1")
        first, stop = reads[_FIRST].read(0), reads[_STOP].read(0)
        states = [(k, j) for k in range(self._first_state, len(step.inputs)) for j in range(step.inputs[k].size)]
        starts = [reads[k + 1].read(j) for k, j in states]
        now = {place: code.name() for place in states}
        count, live = code.name(), code.name()

        def read(argument: int, entry: int) -> str:
            return count if argument == 0 else now.get((argument, entry)) or reads[argument + 1].read(entry)

        scalars = Scalars(code, step, read)
        changing = step.depending([0, *range(self._first_state, len(step.inputs))])
        scalars.compute([i for i in step.live if i not in changing])
        going = code.emit(f"icmp slt {counters} {first}, {stop}")
        before, loop, latch, done = (code.label() for _ in range(4))
        code.lines += [f"br label %{before}", f"{before}:", f"br label %{loop}", f"{loop}:"]
        # What comes round is known at the end of the loop.
        heads = len(code.lines)
        found = scalars.compute(step.flat)
        more = found.pop() if self._says else _finite(code, kind, found)
        good = live if self._says else code.binary("and", "i1", live, more)
        after = [code.select(kind, good, new, now[place]) for place, new in zip(states, found, strict=True)]
        next_count = code.binary("add", counter, count, code.convert("zext", "i1", counter, good))
        going_on = code.binary("and", "i1", code.emit(f"icmp slt {counters} {next_count}, {stop}"), good)
        if self._says:
            going_on = code.binary("and", "i1", going_on, more)
        module.declarations.add(f"declare i1 @llvm.vector.reduce.or.v{code.lanes}i1({flags})")
        any_left = code.emit(f"call i1 @llvm.vector.reduce.or.v{code.lanes}i1({flags} {going_on})")
        code.lines += [f"br label %{latch}", f"{latch}:", f"br i1 {any_left}, label %{loop}, label %{done}", f"{done}:"]

        def comes_round(name: str, own: str, start: str, end: str) -> str:
            return f"{name} = phi {own} [ {start}, %{before} ], [ {end}, %{latch} ]"

        code.lines[heads:heads] = [
            comes_round(count, counters, first, next_count),
            comes_round(live, flags, going, going_on),
            *(comes_round(now[p], numbers, a, b) for p, a, b in zip(states, starts, after, strict=True)),
        ]
        ends = iter([*after, next_count])
        for k, rows in writes.items():
            rows.write([next(ends) for _ in range(self.signature.results[k].size)])
        self.end(code)

    def exercised(self, arguments: list[NDArray[Any]]) -> list[NDArray[Any]]:
        """One iteration, two, none, and so on."""
        first, _, *rest = arguments
        counts = np.arange(1, len(first) + 1, dtype=first.dtype)[:, None] % 3
        return [first, first + counts, *rest]

    def plain(self, arguments: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        first, stop, *rest = arguments
        fixed, state, k = rest[: self._first_state - 1], rest[self._first_state - 1 :], first.copy()
        live = k < stop
        while live.any():
            found = by_numpy(self.step, [k, *fixed, *state])
            more = found.pop() if self._says else live
            for values in [] if self._says else found:
                live = live & np.isfinite(values).all(1, keepdims=True)
            state = [np.where(live, new, old) for new, old in zip(found, state, strict=True)]
            k = k + live
            live = live & more & (k < stop)
        return [*state, k]


def _finite(code: Code, kind: str, values: Sequence[str]) -> str:
    """Whether all values are: zero times each of them is then zero."""
    zero = code.constant(kind, 0.0)
    total = zero
    for value in values:
        total = code.multiply_add(kind, value, zero, total)
    return code.emit(f"fcmp ord {code.vector(kind)} {total}, {total}")
