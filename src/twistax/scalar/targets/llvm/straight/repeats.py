"""Programs that a program contains several times: functions of all of them at once, side by side in a vector."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from ....graph import OpaqueCall, Repeat, ScalarGraph
from ....jax_primitive import call_program
from ....parts.member_program import MemberProgram
from ....primitives.interface import RepeatedMembers, by_columns, flat, nodes
from ....primitives.operations import OPERATIONS
from ....program import ScalarProgram
from ....reader import renamed, repeats_in_kernels
from ..code import Code
from .pieces import Scratch

_NEG = OPERATIONS["neg"]

#: As functions they are written where no more than this fraction of the operations is left.
_MOST = 0.9


class _Circle(Exception):
    """An argument of a repeated program depends on its results."""


def with_functions(program: ScalarProgram) -> ScalarProgram:
    """The program with calls of the programs that it contains several times; itself where that makes it no shorter."""
    repeats = [repeat for repeat in program.graph.repeats if repeats_in_kernels(repeat.program, program.graph)]
    if not repeats:
        return program
    try:
        shorter = _Exchange(program, repeats).made()
    except _Circle:
        return program
    return shorter if operations_once(shorter) < _MOST * program.operations else program


def operations_once(program: ScalarProgram) -> int:
    """The number of operations, with those of each repeated program once."""
    repeated = [call for call in program.calls if isinstance(call.key, RepeatedMembers)]
    return program.operations - sum((len(c.arguments[0]) - 1) * c.key.program.operations for c in repeated)


class _Exchange:
    """A program, of which results of repeated programs become results of calls.

    Args:
        repeats: the repeated programs.
    """

    def __init__(self, program: ScalarProgram, repeats: Sequence[Repeat]) -> None:
        self._program, self._old, self._repeats = program, program.graph, repeats
        #: The repeated program of which a node is a result.
        self._of: dict[int, int] = {}
        #: Nodes of which the negative is a result: others read them in place of it.
        self._negative: dict[int, int] = {}
        live = set(program.live)
        for number, repeat in enumerate(repeats):
            arguments = set(flat(*repeat.arguments))

            computed = [i for i in flat(*repeat.results) if i >= 0 and i not in arguments]
            for i in computed:
                operation = self._old.operation(i)
                if operation is not None and i in live:
                    self._of.setdefault(i, number)
                inner = self._old.arguments(i)[0] if operation is _NEG else -1
                if inner in live and self._old.operation(inner) is not None and inner not in arguments:
                    self._of.setdefault(i, number)
                    self._negative.setdefault(inner, i)

    def made(self) -> ScalarProgram:
        """The new program. Raises _Circle."""
        old, program = self._old, self._program
        new = ScalarGraph(old.dtype, old.checked, old.largest, old.limits, old.signed_zeros)
        inputs = tuple(
            nodes([new.input(k, j, old.dtypes[i]) for j, i in enumerate(flat(array))], array.shape)
            for k, array in enumerate(program.inputs)
        )
        self._new = new
        self._known = dict(zip(flat(*program.inputs), flat(*inputs), strict=True))
        needed = self._needed()
        for i in program.live:
            if i in needed:
                self._add(i)
        outputs = tuple(renamed(self._known, array) for array in program.outputs)
        return ScalarProgram(new, inputs, outputs, program.types)

    def _sources(self, node: int) -> Sequence[int]:
        number = self._of.get(node)
        if number is None:
            return [self._negative[node]] if node in self._negative else self._old.sources(node)
        return [i for i in flat(*self._repeats[number].arguments) if i >= 0]

    def _needed(self) -> set[int]:
        needed, waiting = set[int](), list(self._program.flat)
        while waiting:
            node = waiting.pop()
            if node not in needed:
                needed.add(node)
                waiting.extend(self._sources(node))
        return needed

    def _add(self, root: int) -> None:
        """Add a node, after all that it needs."""
        waiting, begun = [root], set[int]()
        while waiting:
            node = waiting[-1]
            if node in self._known:
                waiting.pop()
            elif missing := [i for i in self._sources(node) if i not in self._known]:
                if node in begun:
                    raise _Circle
                begun.add(node)
                waiting.extend(missing)
            else:
                self._compute(node)

    def _compute(self, node: int) -> None:
        old, new, known = self._old, self._new, self._known
        call, operation = old.call_of(node), old.operation(node)
        if node in self._of:
            self._call(self._repeats[self._of[node]], self._of[node])
        elif node in self._negative:
            known[node] = new.neg(known[self._negative[node]])
        elif call is not None:
            made = new.call(call.jaxpr, call.key, [renamed(known, a) for a in call.arguments], call.inline)
            known.update(zip(flat(*call.results), flat(*made.results), strict=True))
        elif operation is None:
            known[node] = new.constant(old.numbers[node], old.dtypes[node])
        else:
            known[node] = new.copied(operation, [known[a] for a in old.arguments(node)], old.dtypes[node])

    def _call(self, repeat: Repeat, number: int) -> None:
        new, known = self._new, self._known
        known[-1] = new.zero  # of arguments on which no needed result depends
        arguments = [renamed(known, array) for array in repeat.arguments]
        function = _function(repeat.program, len(arguments[0]))
        made = new.call(function, RepeatedMembers(repeat.program), arguments, True)
        for i, node in zip(flat(*repeat.results), flat(*made.results), strict=True):
            if self._of.get(i) == number:
                known[i] = node


def argument_places(code: Code, scratch: Scratch, call: OpaqueCall, value: Callable[[int], str]) -> list[int]:
    """The places in memory of the arguments of a function, entry by entry; they are written there.

    Args:
        value: the value of a node.
    """
    places, copied = list[int](), 0
    for array in map(by_columns, call.arguments):
        start = scratch.row(array)
        if start is None:
            start = scratch.further(copied + len(array) - 1) - len(array) + 1
            copied += len(array)
            for k, node in enumerate(array):
                there = code.emit(f"getelementptr i8, ptr %scratch, i64 {8 * (start + k)}")
                code.lines.append(f"store double {value(node)}, ptr {there}, align 8")
        places.append(start)
    return places


def _function(program: ScalarProgram, count: int) -> Any:
    """What a call does, from arrays with one row for each time to such arrays."""
    g, member = program.graph, MemberProgram(program)
    shapes = [jax.ShapeDtypeStruct((count, *a.shape), g.dtype_of(a)) for a in program.inputs]
    return jax.make_jaxpr(jax.vmap(functools.partial(call_program, member)))(*shapes)


def repeated_by_numpy(call: OpaqueCall, values: Mapping[int, NDArray[Any]], by_numpy: Any) -> dict[int, NDArray[Any]]:
    """The results of a call, whose entries are arrays of members."""
    arguments = [
        np.concatenate([np.stack([values[i] for i in flat(row)], 1) for row in array]) for array in call.arguments
    ]
    results = by_numpy(call.key.program, arguments)
    return {
        i: part[:, entry]
        for array, result in zip(call.results, results, strict=True)
        for row, part in zip(array, np.split(result, len(array)), strict=True)
        for entry, i in enumerate(flat(row))
    }
