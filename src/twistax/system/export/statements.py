"""Statements of C99 that compute scalar programs, with loops, branches and functions that are called."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...scalar.graph import OpaqueCall, ScalarGraph
from ...scalar.primitives.entry import Operation
from ...scalar.primitives.interface import Nodes, flat
from ...scalar.primitives.table_load import Table
from ...scalar.program import ScalarProgram
from ...scalar.targets.c import c_type, expression
from .control_flow import Branches, CalledFunction, CalledLoop, structure

_STEP = "    "
#: Entries of arrays in a line.
_ACROSS = 6


@dataclasses.dataclass(frozen=True)
class _Defined:
    """The name of a C function of arrays, and the numbers of the arguments that it reads."""

    name: str
    read: list[int]


class Definitions:
    """The tables and functions of a file, each defined once.

    Attributes:
        tables: the tables that statements read.
        functions: the texts of the functions that statements call.
    """

    def __init__(self) -> None:
        self.tables: dict[Table, None] = {}
        self.functions: list[str] = []
        self._by_key: dict[Any, _Defined] = {}
        self._by_text: dict[str, _Defined] = {}

    def defined(self, called: CalledFunction, call: OpaqueCall, g: ScalarGraph) -> _Defined:
        """The function of a call. Equal functions are one.

        Raises:
            ModelError: C does not have a type, or an operation of this type.
        """
        if call.key not in self._by_key:
            program, statements, read = called.program, Statements(self), set[int]()

            def entry(argument: int, place: int) -> str:
                read.add(argument)
                return f"a{argument}[{place}]"

            values = statements.computed(program, entry)
            types = [c_type(dtype).name for dtype in program.types]
            for k, array in enumerate(program.outputs):
                statements.lines += [f"r{k}[{j}] = {values[i]};" for j, i in enumerate(flat(array))]
            inputs = [f"const {c_type(g.dtype_of(call.arguments[k])).name} *a{k}" for k in sorted(read)]
            results = [f"{kind} *r{k}" for k, kind in enumerate(types) if program.outputs[k].size]
            lines = "".join(f"{_STEP}{line}\n" for line in statements.lines)
            text = f"({', '.join([*inputs, *results])})\n{{\n{lines}}}\n"
            if text not in self._by_text:
                function = self._by_text[text] = _Defined(f"function_{len(self.functions)}", sorted(read))
                self.functions.append(f"static void {function.name}{text}")
            self._by_key[call.key] = self._by_text[text]
        return self._by_key[call.key]


class Statements:
    """The statements of a function: values have numbers, in the order in which they are computed."""

    def __init__(self, definitions: Definitions) -> None:
        self.lines: list[str] = []
        self._definitions = definitions
        self._values = self._calls = 0
        #: The values that are read.
        self._read = set[str]()

    def computed(self, program: ScalarProgram, entry: Callable[[int, int], str]) -> dict[int, str]:
        """Add the statements that compute a program, and name the values of its nodes.

        Raises:
            ModelError: C does not have a type, or an operation of this type.
        """
        g = program.graph
        self._definitions.tables.update(dict.fromkeys(program.tables))
        arrays = set[str]()

        def operation(operation: Operation, node: int, *values: str) -> str:
            self._read.update(values)
            result_type, argument_type = c_type(g.dtypes[node]), c_type(g.dtypes[g.arguments(node)[-1]])
            return self._value(result_type.name, expression(operation, argument_type, result_type, values))

        def call(called: OpaqueCall, values: dict[int, str]) -> dict[int, str]:
            def value(i: int) -> str:
                name = values.get(i) or c_type(g.dtypes[i]).literal(g.numbers[i])
                self._read.add(name)
                return name

            inside = structure(called, g)
            if isinstance(inside, CalledFunction):
                names = self._called(inside, called, g, value)
            elif isinstance(inside, Branches):
                names = self._branched(inside, called, g, value)
            else:
                assert inside is not None  # callers refuse other calls before
                names = self._looped(inside, called, g, value)
            results = dict(zip(flat(*called.results), names, strict=True))
            arrays.update(name for name in results.values() if "[" in name)
            return results

        values = program.computed(entry, lambda value, dtype: c_type(dtype).literal(value), operation, call)
        self._read.update(values[i] for i in program.flat)
        unread = {_array(name) for name in arrays} - {_array(name) for name in self._read}
        self.lines += [f"(void){name};" for name in sorted(unread)]
        return values

    def _value(self, kind: str, value: str) -> str:
        """Add a constant; gives its name."""
        self._values += 1
        self.lines.append(f"const {kind} v{self._values - 1} = {value};")
        return f"v{self._values - 1}"

    def _number(self) -> int:
        self._calls += 1
        return self._calls - 1

    def _arrays(self, name: str, types: Sequence[np.dtype[Any]], numbers: Sequence[Sequence[Any]]) -> list[list[str]]:
        """Declare arrays, and name their entries; those that are numbers are literals."""
        entries = []
        for k, (dtype, known) in enumerate(zip(types, numbers, strict=True)):
            kind = c_type(dtype)
            entries.append([f"{name}_{k}[{j}]" if x is None else kind.literal(x) for j, x in enumerate(known)])
            if None in known:
                self.lines.append(f"{kind.name} {name}_{k}[{len(known)}];")
        return entries

    def _looped(self, loop: CalledLoop, call: OpaqueCall, g: ScalarGraph, value: Callable[[int], str]) -> list[str]:
        """Add a loop, whose state is in arrays; gives the names of its results."""
        number, count = self._number(), len(loop.start)
        counter = f"k{number}"
        state = self._arrays(f"w{number}", loop.types, loop.numbers)
        known = [x for numbers in loop.numbers for x in numbers]
        entries = [name for names in state for name in names]
        types = zip(state, loop.types, strict=True)
        kinds = {name: c_type(kind).name for names, kind in types for name in names if "[" in name}
        first = [value(i) for i in flat(*loop.start)]
        self.lines += [
            f"{name} = {x};" for name, x, number in zip(entries, first, known, strict=True) if number is None
        ]
        results = call.results[count:]
        stacked = self._arrays(f"s{number}", [g.dtype_of(a) for a in results], [[None] * a.size for a in results])
        before, self.lines, rows = self.lines, [], dict[int, Nodes]()

        def reader(fixed: Sequence[Nodes]) -> Callable[[int, int], str]:
            arrays = [*map(flat, fixed)]

            def read(argument: int, place: int) -> str:
                if argument < len(arrays):
                    return value(arrays[argument][place])
                k = argument - len(arrays)
                if k < count:
                    return state[k][place]
                rows[k - count] = array = loop.rows[k - count]
                return f"r{number}_{k - count}[{_place(counter, array, place)}]"

            return read

        if loop.condition is not None:
            (going,) = flat(*loop.condition.outputs)
            flag = self.computed(loop.condition, reader(loop.fixed[0]))[going]
            self.lines.append(f"if (!{flag}) break;")
        after, outputs = self.computed(loop.iteration, reader(loop.fixed[1])), loop.iteration.outputs
        for k, array in enumerate(outputs[count:]):
            places = [_place(counter, results[k], j) for j in range(array.size)]
            self.lines += [f"s{number}_{k}[{at}] = {after[i]};" for at, i in zip(places, flat(array), strict=True)]
        moved = zip(entries, (after[i] for i in flat(*outputs[:count])), known, strict=True)
        changed = [(name, new) for name, new, x in moved if x is None and new != name]
        # Entries that take the place of others are read before any is written.
        copies = {new: self._value(kinds[new], new) for _, new in changed if new in kinds}
        self.lines += [f"{name} = {copies.get(new, new)};" for name, new in changed]
        head = "for (;;) {" if loop.condition is not None else _times(counter, loop)
        inside, self.lines = self.lines, before
        for k, array in rows.items():
            self._constant(f"r{number}_{k}", array, g, value)
        self.lines += [head, *(_STEP + line for line in inside), "}"]
        return [*entries, *(name for names in stacked for name in names)]

    def _branched(self, branches: Branches, call: OpaqueCall, g: ScalarGraph, value: Callable[[int], str]) -> list[str]:
        """Add branches, whose results are in arrays; gives their names."""
        programs, number = branches.programs, self._number()
        values = zip(*([p.graph.numbers[i] for i in p.flat] for p in programs), strict=True)
        same = iter([x[0] if x.count(x[0]) == len(x) else None for x in values])
        known = [[next(same) for _ in flat(array)] for array in call.results]
        types = [g.dtype_of(array) if array.size else np.dtype(bool) for array in call.results]
        entries = [name for names in self._arrays(f"b{number}", types, known) for name in names]
        operands = [*map(flat, branches.operands)]
        for k, program in enumerate(programs):
            before, self.lines = self.lines, []
            after = self.computed(program, lambda argument, place: value(operands[argument][place]))
            assigned = zip(entries, program.flat, (x for numbers in known for x in numbers), strict=True)
            self.lines += [f"{name} = {after[i]};" for name, i, x in assigned if x is None]
            test = f"if ({value(branches.index)} <= {k}) {{"
            head = "} else {" if k == len(programs) - 1 else test if k == 0 else f"}} else {test}"
            self.lines = [*before, head, *(_STEP + line for line in self.lines)]
        self.lines.append("}")
        return entries

    def _called(
        self, called: CalledFunction, call: OpaqueCall, g: ScalarGraph, value: Callable[[int], str]
    ) -> list[str]:
        """Add the call of a function; gives the names of its results."""
        function, number = self._definitions.defined(called, call, g), self._number()
        names = [f"c{number}_{k}" for k in function.read]
        for name, k in zip(names, function.read, strict=True):
            self._constant(name, call.arguments[k], g, value)
        types = [g.dtype_of(array) if array.size else np.dtype(bool) for array in call.results]
        results = self._arrays(f"d{number}", types, [[None] * array.size for array in call.results])
        names += [f"d{number}_{k}" for k, array in enumerate(call.results) if array.size]
        self.lines.append(f"{function.name}({', '.join(names)});")
        return [name for entries in results for name in entries]

    def _constant(self, name: str, array: Nodes, g: ScalarGraph, value: Callable[[int], str]) -> None:
        """Declare an array that does not change."""
        entries = [*map(value, flat(array))]
        static = "static " if all(g.numbers[i] is not None for i in flat(array)) else ""
        self.lines.append(f"{static}const {c_type(g.dtype_of(array)).name} {name}[{len(entries)}] = {{")
        starts = range(0, len(entries), _ACROSS)
        self.lines += [f"{_STEP}{', '.join(entries[k : k + _ACROSS])}," for k in starts]
        self.lines.append("};")


def _array(name: str) -> str:
    """The name of the array of an entry."""
    return name.partition("[")[0]


def _place(counter: str, array: Nodes, entry: int) -> str:
    """The place of an entry of a row, in an array of rows."""
    size = array.size // len(array)
    return counter if size == 1 else f"{size} * {counter} + {entry}"


def _times(counter: str, loop: CalledLoop) -> str:
    if loop.reverse:
        return f"for (int32_t {counter} = {loop.length - 1}; {counter} >= 0; {counter}--) {{"
    return f"for (int32_t {counter} = 0; {counter} < {loop.length}; {counter}++) {{"
