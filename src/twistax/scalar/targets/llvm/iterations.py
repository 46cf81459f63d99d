"""A loop over a step as one function, in which each batch member iterates until its loop ends; and rows that the loop
fills.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...loops import decides
from ...program import ScalarProgram
from .code import NAMES, Code
from .kernel_body import KernelBody, Rounded, Scalars, arguments_of, by_numpy, needed_by
from .lanes import COUNT, Array, Rows

#: Distances of the marks of rows from the end of a step in the self-test of a kernel: before it, at it, beyond it.
_MARK_OFFSETS = np.array([-1e-3, 0.0, 1e3])


class Iterations(KernelBody):
    """The loop state = step(k, fixed, state) for k = first, first + 1, ..., stop - 1, or until it ends, as documented
    in `repeat`.

    Takes (first, stop, *fixed, *state), gives (*state, k): the state, and the number of the next iteration. Each member
    iterates as long as it must. What stays the same is computed once. The program takes (k, *fixed, *state), and gives
    (*state) or (*state, more), with `more` a boolean and all states of its precision; `state` arguments are the state.

    With rows it takes (length, first, stop, number, *fixed, *state, marks, table) and gives (*state, k, number, table);
    the results of the program end with (reach, *record). After an iteration rows number, number + 1, ... whose marks
    are not beyond `reach` are filled, in the table that came in; `number` is then that of the next row, at most
    `length`.

    Args:
        row: takes (reach, *record, mark), gives a row.
    """

    tried = len(_MARK_OFFSETS)

    def __init__(self, program: ScalarProgram, lanes: int, state: int, row: ScalarProgram | None = None) -> None:
        number, *rest = arguments_of(program)
        self._row = row
        heads, tails = [number, number], list[Array]()
        results = [*rest[len(rest) - state :], number]
        if row is not None:
            marks = Array((), row.graph.dtype_of(row.inputs[-1]), long=True)
            table = Array(row.outputs[0].shape, row.types[0], long=True)
            # The length of the rows comes first, as in all functions of long arrays.
            heads, tails = [COUNT, *heads, number], [marks, table]
            results += [number, table]
        #: The argument with the number of the first iteration; the next argument is the one to stop at.
        self._first = 0 if row is None else 1
        #: The offset of the step's arguments.
        self._shift = len(heads) - 1
        #: The first argument of the step that is state.
        self._first_state = len(rest) - state + 1
        #: Whether a result of the step decides if another iteration follows; its first result that rows are made from.
        self._decides = decides(program.types[state:])
        self._first_record = state + self._decides
        arguments = [*heads, *rest, *tails]
        always = {*range(len(heads)), *range(self._first_state + self._shift, len(arguments))}
        needed = {k + self._shift for k in needed_by(program) if k > 0}
        super().__init__(program, lanes, arguments, results, needed | always)
        if row is not None:
            self.in_place = {len(results) - 1: len(arguments) - 1}

    def body(self, code: Code, rows: Mapping[str, Rows]) -> None:
        def read(argument: int, entry: int = 0) -> str:
            return rows[f"a{argument}"].read(entry)

        step, g = self.program, self.program.graph
        counter, kind = NAMES[self.arguments[self._first].dtype], NAMES[g.dtype]
        counters, numbers, flags = code.vector(counter), code.vector(kind), code.vector("i1")
        first, stop = read(self._first), read(self._first + 1)
        states = [(k, j) for k in range(self._first_state, len(step.inputs)) for j in range(step.inputs[k].size)]
        starts = [read(k + self._shift, j) for k, j in states]
        now = {place: code.name() for place in states}
        count, live = code.name(), code.name()

        def value_of(argument: int, entry: int) -> str:
            return count if argument == 0 else now.get((argument, entry)) or read(argument + self._shift, entry)

        scalars = Scalars(code, step, value_of)
        changing = step.depending([0, *range(self._first_state, len(step.inputs))])
        scalars.compute([i for i in step.live if i not in changing])
        filling = None if self._row is None else _Filling(code, self._row, rows, self.arguments, len(self.results) - 1)
        carried = [(now[place], numbers, start) for place, start in zip(states, starts, strict=True)]
        carried.append((count, counters, first))
        if filling is not None:
            carried.append((number := code.name(), counters, filling.first))
        carried.append((live, flags, code.emit(f"icmp slt {counters} {first}, {stop}")))
        end = code.loop(carried)
        values = scalars.compute(step.flat)
        new_states, record = values[: len(states)], values[len(states) :]
        more = record.pop(0) if self._decides else _finite(code, kind, new_states)
        good = live if self._decides else code.instruction("and", "i1", live, more)
        ends = [code.select(kind, good, new, now[place]) for place, new in zip(states, new_states, strict=True)]
        ends.append(code.instruction("add", counter, count, code.convert("zext", "i1", counter, good)))
        going_on = code.instruction("and", "i1", code.emit(f"icmp slt {counters} {ends[-1]}, {stop}"), good)
        if self._decides:
            going_on = code.instruction("and", "i1", going_on, more)
        if filling is not None:
            ends.append(filling.write(number, good, record))
        end([*ends, going_on], code.any(going_on))
        left = iter(ends)
        for k in self.written:
            if k not in self.in_place:
                rows[f"r{k}"].write([next(left) for _ in range(self.results[k].size)])

    def exercised(self, arguments: list[NDArray[Any]]) -> list[NDArray[Any]]:
        """Arguments for one iteration, two, none, and so on; marks about where the first iteration ends."""
        changed = list(arguments)
        first = changed[self._first]
        changed[self._first + 1] = first + np.arange(1, len(first) + 1, dtype=first.dtype)[:, None] % 3
        if self._row is not None:
            changed[0] = np.full_like(changed[0], self.tried)
            changed[3] = np.zeros_like(changed[3])
            after = by_numpy(self.program, [first, *changed[4:-2]])
            changed[-2] = (after[self._first_record] + _MARK_OFFSETS).astype(changed[-2].dtype)
        return changed

    def plain(self, arguments: Sequence[NDArray[Any]], rounded: Rounded = np.asarray) -> list[NDArray[Any]]:
        first, stop = arguments[self._first : self._first + 2]
        rest = list(arguments[self._shift + 1 :])
        count = len(self.program.inputs) - self._first_state
        fixed, state = rest[: self._first_state - 1], rest[self._first_state - 1 :][:count]
        k, live, filled = first.copy(), first < stop, list[NDArray[Any]]()
        if self._row is not None:
            filled = [arguments[3], rest[-1]]
        while live.any():
            results = by_numpy(self.program, [k, *fixed, *state], rounded)
            more = results[count] if self._decides else live
            for values in [] if self._decides else results[:count]:
                live = live & np.isfinite(values).all(1, keepdims=True)
            state = [np.where(live, new, old) for new, old in zip(results, state, strict=False)]
            if self._row is not None:
                record = results[self._first_record :]
                filled = _rows_by_numpy(self._row, record, live, rest[-2], filled, rounded)
            k = k + live
            live = live & more & (k < stop)
        return [*state, k, *filled]


class _Filling:
    """The loop over the rows that become due in one iteration."""

    def __init__(
        self, code: Code, row: ScalarProgram, rows: Mapping[str, Rows], arguments: Sequence[Array], table: int
    ) -> None:
        self._code, self._row = code, row
        self._marks, self._table = rows[f"a{len(arguments) - 2}"], rows[f"r{table}"]
        marks = arguments[-2].dtype
        self._mark, self._row_array = Array((), marks), Array(row.outputs[0].shape, row.types[0])
        self._not_beyond = "fcmp ole" if marks.kind == "f" else "icmp sle"
        self._counter = NAMES[arguments[3].dtype]
        length = rows["a0"].read(0)
        self._length = length if self._counter == "i32" else code.convert("sext", "i32", self._counter, length)
        self._last = code.instruction("sub", self._counter, self._length, code.constant(self._counter, 1))
        #: The number of the first row.
        self.first = rows["a3"].read(0)

    def write(self, number: str, live: str, record: list[str]) -> str:
        """Add the loop after an iteration, from row `number` on; gives the number of the next row that is not filled.

        Args:
            live: which members took the iteration.
            record: the further results of the iteration, from which rows are made; the first is how far it came.
        """
        code, counter, kind = self._code, self._counter, self._row_array.kind
        places = [(k, j) for k, array in enumerate(self._row.inputs[:-1]) for j in range(array.size)]
        known = dict(zip(places, record, strict=True))
        before, head, fill, latch, done = (code.label() for _ in range(5))
        now, following = code.name(), code.name()
        counters = code.vector(counter)
        code.lines += [f"br label %{before}", f"{before}:", f"br label %{head}", f"{head}:"]
        code.lines.append(f"{now} = phi {counters} [ {number}, %{before} ], [ {following}, %{latch} ]")
        there = code.instruction("icmp slt", counter, now, self._length)
        place = code.select(counter, there, now, self._last)
        mark = self._marks.window(self._starts(place, 1), self._mark).read(0)
        due = code.instruction(self._not_beyond, self._mark.kind, mark, record[0])
        due = code.instruction("and", "i1", code.instruction("and", "i1", there, live), due)
        code.lines += [f"br i1 {code.any(due)}, label %{fill}, label %{done}", f"{fill}:"]
        scalars = Scalars(code, self._row, lambda argument, entry: known.get((argument, entry), mark))
        values = scalars.compute(self._row.flat)
        window = self._table.window(self._starts(place, self._row_array.size), self._row_array)
        if code.lanes > 1:
            values = [code.select(kind, due, value, window.read(j)) for j, value in enumerate(values)]
        window.write(values)
        code.lines.append(f"{following} = add {counters} {now}, {code.convert('zext', 'i1', counter, due)}")
        code.lines += [f"br label %{latch}", f"{latch}:", f"br label %{head}", f"{done}:"]
        return now

    def _starts(self, place: str, size: int) -> list[str]:
        """The first entry of the row at a place, for each lane."""
        code, counter = self._code, self._counter
        wide = place if counter == "i64" else code.convert("sext", counter, "i64", place)
        start = code.instruction("mul", "i64", wide, code.constant("i64", size))
        return [code.entry("i64", start, lane) for lane in range(code.lanes)]


def _rows_by_numpy(
    row: ScalarProgram,
    record: list[NDArray[Any]],
    live: NDArray[Any],
    marks: NDArray[Any],
    filled: list[NDArray[Any]],
    rounded: Rounded,
) -> list[NDArray[Any]]:
    """The number of the next row, and the table, after an iteration, by NumPy."""
    number, table = filled
    every, last, size = np.arange(len(table)), marks.shape[1] - 1, row.outputs[0].size
    table = table.copy()
    while True:
        place = np.minimum(number[:, 0], last)
        mark = marks[every, place][:, None]
        due = live & (number <= last) & (mark <= record[0])
        if not due.any():
            return [number, table]
        (values,) = by_numpy(row, [*record, mark], rounded)
        for member in every[due[:, 0]]:
            table[member, place[member] * size : (place[member] + 1) * size] = values[member]
        number = number + due


def _finite(code: Code, kind: str, values: Sequence[str]) -> str:
    """Whether all values are finite: zero times each of them is zero."""
    zero = code.constant(kind, 0.0)
    total = zero
    for value in values:
        total = code.multiply_add(kind, value, zero, total)
    return code.instruction("fcmp ord", kind, total, total)
