"""Loops and branches of JAX, and functions with loops, as scalar programs, for languages that have them."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...jax_inside import ClosedJaxpr, Literal, closed, scan_parts
from ...scalar.graph import Limits, OpaqueCall, ScalarGraph
from ...scalar.primitives.interface import Nodes, flat, kernel_of, nodes
from ...scalar.program import ScalarProgram
from ...scalar.reader import JaxprReader, emitted_form, scalarize

#: LU with pivots is unrolled up to the size that Cholesky is. Languages with loops call functions with loops.
LIMITS = Limits(pivoted=12, table=256, equations=100_000)


@dataclasses.dataclass(frozen=True)
class CalledLoop:
    """A `while_loop` or a `scan` of JAX. Entries of its state that keep their first value are numbers in it.

    Attributes:
        start: for each array of the state the nodes of its first values, in the graph that calls it.
        types: of these arrays.
        fixed: nodes of that graph for the arrays that the condition and the iteration read and do not change.
        rows: nodes for the arrays of which an iteration of a `scan` reads one row.
        numbers: for each array of the state its entries that are numbers; None for others.
        condition: of the first fixed arrays and the state; None for a `scan`.
        iteration: of the other fixed arrays, the state and the rows, to the state and rows of further results.
        length: the iterations of a `scan`, 0 for others.
        reverse: whether it begins with the last row.
    """

    start: list[Nodes]
    types: list[np.dtype[Any]]
    fixed: tuple[list[Nodes], list[Nodes]]
    rows: list[Nodes]
    numbers: list[list[Any]]
    condition: ScalarProgram | None
    iteration: ScalarProgram
    length: int = 0
    reverse: bool = False

    @property
    def programs(self) -> list[ScalarProgram]:
        return [self.iteration] if self.condition is None else [self.condition, self.iteration]

    @classmethod
    def of(cls, call: OpaqueCall, g: ScalarGraph) -> CalledLoop:
        """The loop of a call in a graph."""
        (eqn,), every = call.jaxpr.jaxpr.eqns, _operands(call, g)
        p, avals = eqn.params, [*map(_aval, eqn.invars)]
        if eqn.primitive.name == "while":
            asking, count = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
            last, parts, ends = len(every), ["cond_jaxpr", "body_jaxpr"], (0, False)
        else:
            asking, (count, carried) = 0, scan_parts(eqn)
            last, parts, ends = count + carried, ["jaxpr"], (p["length"], p["reverse"])
        start, rows = every[count:last], every[last:]
        fixed = every[:asking], every[asking:count]
        types = [np.dtype(aval.dtype) for aval in avals[count:last]]
        *before, body = (_program(closed(p[name]), g.checked) for name in parts)
        changing = [[None] * (array[0].size if len(array) else 0) for array in rows]
        numbers = _numbers(g, start)
        while True:
            condition = _with_numbers(before[0], [*_numbers(g, fixed[0]), *numbers]) if before else None
            iteration = _with_numbers(body, [*_numbers(g, fixed[1]), *numbers, *changing])
            kept = [
                [old if old == new else None for old, new in zip(before, after, strict=True)]
                for before, after in zip(
                    numbers, _numbers(iteration.graph, iteration.outputs[: len(start)]), strict=True
                )
            ]
            if kept == numbers:
                return cls(start, types, fixed, rows, numbers, condition, iteration, *ends)
            numbers = kept


@dataclasses.dataclass(frozen=True)
class Branches:
    """A `cond` of JAX.

    Attributes:
        index: the node of the number of the branch, in the graph that calls it; numbers beyond are the nearest one.
        operands: nodes of that graph for the arguments of all branches.
        programs: the branches.
    """

    index: int
    operands: list[Nodes]
    programs: list[ScalarProgram]

    @classmethod
    def of(cls, call: OpaqueCall, g: ScalarGraph) -> Branches:
        """The branches of a call in a graph."""
        (eqn,), (index, *operands) = call.jaxpr.jaxpr.eqns, _operands(call, g)
        branches = [_program(closed(branch), g.checked) for branch in eqn.params["branches"]]
        return cls(int(index), operands, [_with_numbers(branch, _numbers(g, operands)) for branch in branches])


@dataclasses.dataclass(frozen=True)
class CalledFunction:
    """A function with loops that stays a call.

    Attributes:
        program: the function.
    """

    program: ScalarProgram

    @property
    def programs(self) -> list[ScalarProgram]:
        return [self.program]


#: What has been read of calls.
_READ: weakref.WeakKeyDictionary[OpaqueCall, CalledLoop | Branches | CalledFunction] = weakref.WeakKeyDictionary()


def structure(call: OpaqueCall, g: ScalarGraph) -> CalledLoop | Branches | CalledFunction | None:
    """The loop, the branches or the function of a call in a graph; None if it is none of them."""
    if call not in _READ:
        names = [eqn.primitive.name for eqn in call.jaxpr.jaxpr.eqns]
        if kernel_of(call) is not None:
            _READ[call] = CalledFunction(_program(call.jaxpr, g.checked, functions=False))
        elif names == ["cond"]:
            _READ[call] = Branches.of(call, g)
        elif names in (["while"], ["scan"]):
            _READ[call] = CalledLoop.of(call, g)
    return _READ.get(call)


def foreign_calls(form: ScalarProgram, loops: bool) -> list[OpaqueCall]:
    """The calls in a program in emitted form, also in loops and branches, that a language cannot have.

    Args:
        loops: whether it has loops.
    """
    foreign = []
    for call in form.calls:
        inside = structure(call, form.graph) if loops else None
        foreign += [call] if inside is None else [one for p in inside.programs for one in foreign_calls(p, loops)]
    return foreign


def _operands(call: OpaqueCall, g: ScalarGraph) -> list[Nodes]:
    """The nodes of the operands of the equation that is called."""
    known = dict(zip(call.jaxpr.jaxpr.invars, call.arguments, strict=True))
    known |= {v: g.array(c) for v, c in zip(call.jaxpr.jaxpr.constvars, call.jaxpr.consts, strict=True)}
    every = [(v, _aval(v)) for v in call.jaxpr.jaxpr.eqns[0].invars]
    return [g.array(np.asarray(v.val, aval.dtype)) if isinstance(v, Literal) else known[v] for v, aval in every]


def _aval(variable: Any) -> Any:
    """The shape and type of a variable."""
    return variable.aval


def _numbers(g: ScalarGraph, arrays: Sequence[Nodes]) -> list[list[Any]]:
    """The entries that are numbers; None for others."""
    return [[g.numbers[i] for i in flat(array)] for array in arrays]


def _program(body: ClosedJaxpr, checked: bool, functions: bool = True) -> ScalarProgram:
    # Loops and branches are calls at first, which emitters write out where they contain no other calls.
    program = scalarize(body, checked=checked, limits=Limits(equations=0))
    return emitted_form(program, dataclasses.replace(LIMITS, functions=functions))


def _with_numbers(program: ScalarProgram, numbers: Sequence[Sequence[Any]]) -> ScalarProgram:
    """The program with some entries of its arguments as numbers."""
    old = program.graph
    g = ScalarGraph(old.dtype, old.checked, old.largest, old.limits, old.signed_zeros)
    inputs = []
    for k, (array, known) in enumerate(zip(program.inputs, numbers, strict=True)):
        entries = [
            g.input(k, j, old.dtypes[i]) if number is None else g.constant(number, old.dtypes[i])
            for j, (i, number) in enumerate(zip(flat(array), known, strict=True))
        ]
        inputs.append(nodes(entries, array.shape))
    return ScalarProgram(g, tuple(inputs), tuple(JaxprReader(g).inlined(program, inputs)), program.types)
