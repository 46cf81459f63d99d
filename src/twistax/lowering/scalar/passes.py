"""A program written anew before it is emitted: calls written out, reciprocals shared."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from .graph import LIMITS, Call, Graph, Limits, Nodes
from .operations import Extreme, by_primitive
from .program import ScalarProgram
from .reader import Reader

__all__ = ["emitted_form", "one_by_one", "substituted"]

_ALGEBRA: dict[object, Callable[..., int]] = {
    by_primitive["add"]: Graph.add,
    by_primitive["sub"]: Graph.sub,
    by_primitive["mul"]: Graph.mul,
    by_primitive["div"]: Graph.div,
    by_primitive["neg"]: Graph.neg,
    by_primitive["select"]: Graph.select,
}
_DIV = by_primitive["div"]


def emitted_form(program: ScalarProgram, limits: Limits = LIMITS) -> ScalarProgram:
    """The program that an emitter writes: calls that are functions of scalars are written out, and x / d, y / d, ...
    become products with one 1 / d, unless the program is checked.

    A shared reciprocal costs one more rounding, half a unit in the last place.

    Args:
        limits: up to which size parts are written out; larger for emitters that cannot call a library.
    """
    expanded = _rebuilt(program, {}, whole=False, limits=limits)
    if program.graph.checked:
        return expanded
    g = expanded.graph
    uses = Counter(g.arguments(i)[1] for i in expanded.live if g.operation(i) is _DIV and g.dtypes[i] == g.dtype)
    shared = {divisor for divisor, count in uses.items() if count > 1}
    return _rebuilt(expanded, {_DIV: shared}, whole=False, limits=limits) if shared else expanded


def substituted(program: ScalarProgram, graph: Graph, arguments: tuple[Nodes, ...]) -> list[Nodes]:
    """The results of a program on nodes of another graph."""
    known = {
        i: j
        for own, given in zip(program.inputs, arguments, strict=True)
        for i, j in zip(own.reshape(-1).tolist(), given.reshape(-1).tolist(), strict=True)
    }
    return _copied(program, graph, known, set(), whole=True)


def one_by_one(program: ScalarProgram) -> ScalarProgram:
    """The program in another order: one result after the other, each with what is not there yet.

    Derivatives along many tangents come side by side. In this order compilers keep fewer numbers at a time, and pieces
    of the program need fewer of one another.
    """
    return _rebuilt(program, {}, True, program.graph.limits, program.graph.in_turn(program.flat))


def _rebuilt(
    program: ScalarProgram,
    divisors: dict[object, set[int]],
    whole: bool,
    limits: Limits,
    order: Sequence[int] | None = None,
) -> ScalarProgram:
    """The program in a graph of its own; `order` is that of its nodes, as they are if None."""
    old = program.graph
    new = Graph(old.dtype, old.checked, old.largest, limits)
    inputs: list[Nodes] = []
    known: dict[int, int] = {}
    for k, nodes in enumerate(program.inputs):
        flat = [new.input(k, j, old.dtypes[i]) for j, i in enumerate(nodes.reshape(-1).tolist())]
        known.update(zip(nodes.reshape(-1).tolist(), flat, strict=True))
        inputs.append(np.array(flat, np.int64).reshape(nodes.shape))
    outputs = _copied(program, new, known, divisors.get(_DIV, set()), whole, order)
    return ScalarProgram(new, tuple(inputs), tuple(outputs), program.types)


def _copied(
    program: ScalarProgram,
    new: Graph,
    known: dict[int, int],
    shared: set[int],
    whole: bool,
    order: Sequence[int] | None = None,
) -> list[Nodes]:
    """The outputs of a program as nodes of `new`, from what is known of its inputs.

    Args:
        shared: divisors of which the reciprocal is taken once.
        order: of the nodes.
    """
    old, reader = program.graph, Reader(new, whole)
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
            elif operation in _ALGEBRA:
                known[i] = _ALGEBRA[operation](new, *arguments)
            else:
                known[i] = new.node(operation, *arguments)
    return [np.array([known[i] for i in o.reshape(-1).tolist()], np.int64).reshape(o.shape) for o in program.outputs]


def _copy_call(new: Graph, reader: Reader, call: Call, known: dict[int, int], whole: bool) -> None:
    arguments = [
        np.array([known[i] for i in a.reshape(-1).tolist()], np.int64).reshape(a.shape) for a in call.arguments
    ]
    # What was a call for its size may fit a graph that writes out more.
    if not whole and (call.inline or new.limits != LIMITS):
        results = reader.read(call.jaxpr, arguments)
    else:
        results = list(new.call(call.jaxpr, call.key, arguments, call.inline).results)
    for mine, theirs in zip(call.results, results, strict=True):
        known.update(zip(mine.reshape(-1).tolist(), theirs.reshape(-1).tolist(), strict=True))
