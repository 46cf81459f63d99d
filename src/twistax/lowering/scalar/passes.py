"""A program written anew before it is emitted: calls unrolled, reciprocals shared."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Sequence

from .entry import Nodes, nodes
from .graph import LIMITS, Call, Graph, Limits
from .operation import Extreme
from .program import ScalarProgram
from .reader import Reader
from .table.arithmetic import ARITHMETIC

__all__ = ["emitted_form", "one_by_one"]

_DIV = ARITHMETIC["div"]


def emitted_form(program: ScalarProgram, limits: Limits = LIMITS) -> ScalarProgram:
    """The program that an emitter writes: calls that are functions of scalars are unrolled, and x / d, y / d, ...
    become products with one 1 / d, unless the program is checked.

    A shared reciprocal costs one more rounding, half a unit in the last place.

    Args:
        limits: up to which size parts are unrolled; larger for emitters that cannot call a library.
    """
    expanded = _rebuilt(program, set(), whole=False, limits=limits)
    if program.graph.checked:
        return expanded
    g = expanded.graph
    uses = Counter(g.arguments(i)[1] for i in expanded.live if g.operation(i) is _DIV and g.dtypes[i] == g.dtype)
    shared = {divisor for divisor, count in uses.items() if count > 1}
    return _rebuilt(expanded, shared, whole=False, limits=limits) if shared else expanded


def one_by_one(program: ScalarProgram) -> ScalarProgram:
    """The program in another order: one result after the other, each with what is not there yet.

    Derivatives along many tangents come side by side. In this order compilers keep fewer numbers at a time, and pieces
    of the program need fewer of one another.
    """
    return _rebuilt(program, set(), True, program.graph.limits, program.graph.one_by_one(program.flat))


def _rebuilt(
    program: ScalarProgram, shared: set[int], whole: bool, limits: Limits, order: Sequence[int] | None = None
) -> ScalarProgram:
    """The program in a graph of its own.

    Args:
        shared: divisors of which the reciprocal is taken once.
        whole: keep calls.
        order: of the nodes; as they are if None.
    """
    old = program.graph
    new = Graph(old.dtype, old.checked, old.largest, limits)
    inputs: list[Nodes] = []
    known: dict[int, int] = {}
    for k, own in enumerate(program.inputs):
        flat = [new.input(k, j, old.dtypes[i]) for j, i in enumerate(own.reshape(-1).tolist())]
        known.update(zip(own.reshape(-1).tolist(), flat, strict=True))
        inputs.append(nodes(flat, own.shape))
    reader = Reader(new, whole)
    done: set[int] = set()
    for i in program.live if order is None else order:
        if i in known:
            continue
        call, operation = old.call_of(i), old.operation(i)
        if call is not None:
            if id(call) not in done:
                done.add(id(call))
                _copy_call(new, reader, call, known, whole)
        elif operation is None:
            known[i] = new.constant(old.numbers[i], old.dtypes[i])
        else:
            arguments = [known[a] for a in old.arguments(i)]
            if operation is _DIV and old.arguments(i)[1] in shared:
                known[i] = new.mul(arguments[0], new.div(new.one, arguments[1]))
            elif isinstance(operation, Extreme) and not whole:
                known[i] = functools.reduce(functools.partial(new.node, operation.pair), arguments)
            else:
                known[i] = operation.on(new)(*arguments)
    outputs = tuple(_renamed(known, own) for own in program.outputs)
    return ScalarProgram(new, tuple(inputs), outputs, program.types)


def _copy_call(new: Graph, reader: Reader, call: Call, known: dict[int, int], whole: bool) -> None:
    arguments = [_renamed(known, own) for own in call.arguments]
    # What was a call for its size may fit a graph that unrolls more.
    if not whole and (call.inline or new.limits != LIMITS):
        results = reader.read(call.jaxpr, arguments)
    else:
        results = list(new.call(call.jaxpr, call.key, arguments, call.inline).results)
    for mine, theirs in zip(call.results, results, strict=True):
        known.update(zip(mine.reshape(-1).tolist(), theirs.reshape(-1).tolist(), strict=True))


def _renamed(known: dict[int, int], own: Nodes) -> Nodes:
    """An array of nodes of the old graph, in the new one."""
    return nodes([known[i] for i in own.reshape(-1).tolist()], own.shape)
