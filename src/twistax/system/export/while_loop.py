"""Loops of unknown length as scalar programs of their condition and of an iteration."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import ModelError
from ...jax_inside import ClosedJaxpr, Literal, closed
from ...scalar.graph import Limits, OpaqueCall, ScalarGraph
from ...scalar.primitives.interface import Nodes, flat, nodes
from ...scalar.program import ScalarProgram, called_names
from ...scalar.reader import JaxprReader, emitted_form, scalarize


def is_while(call: OpaqueCall) -> bool:
    """Whether a call is a `while_loop`."""
    return [eqn.primitive.name for eqn in call.jaxpr.jaxpr.eqns] == ["while"]


@dataclasses.dataclass(frozen=True)
class WhileLoop:
    """A `while_loop` of JAX. Entries of its state that keep their first value, such as zeros, are numbers in it.

    Attributes:
        start: for each array of the state the nodes of its first values, in the graph that calls it.
        types: of these arrays.
        fixed: nodes of that graph for the arrays that the condition and the iteration read and do not change.
        numbers: for each array of the state its entries that are numbers; None for others.
        condition, iteration: of the fixed arrays and the state.
    """

    start: list[Nodes]
    types: list[np.dtype[Any]]
    fixed: tuple[list[Nodes], list[Nodes]]
    numbers: list[list[Any]]
    condition: ScalarProgram
    iteration: ScalarProgram

    @classmethod
    def of(cls, call: OpaqueCall, g: ScalarGraph, limits: Limits) -> WhileLoop:
        """The loop of a call in a graph.

        Raises:
            ModelError: a part of it has no scalar form.
        """
        (eqn,), p = call.jaxpr.jaxpr.eqns, call.jaxpr.jaxpr.eqns[0].params
        known = dict(zip(call.jaxpr.jaxpr.invars, call.arguments, strict=True))
        known |= {v: g.array(c) for v, c in zip(call.jaxpr.jaxpr.constvars, call.jaxpr.consts, strict=True)}
        avals: list[Any] = [v.aval for v in eqn.invars]
        every = [
            g.array(np.asarray(v.val, aval.dtype)) if isinstance(v, Literal) else known[v]
            for v, aval in zip(eqn.invars, avals, strict=True)
        ]
        asking, count = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
        start, fixed = every[count:], (every[:asking], every[asking:count])
        types = [np.dtype(aval.dtype) for aval in avals[count:]]
        parts = [_program(closed(p[name]), g.checked, limits) for name in ("cond_jaxpr", "body_jaxpr")]
        numbers = _numbers(g, start)
        while True:
            condition, iteration = (
                _with_numbers(one, [*_numbers(g, at), *numbers]) for one, at in zip(parts, fixed, strict=True)
            )
            kept = [
                [old if old == new else None for old, new in zip(before, after, strict=True)]
                for before, after in zip(numbers, _numbers(iteration.graph, iteration.outputs), strict=True)
            ]
            if kept == numbers:
                return cls(start, types, fixed, numbers, condition, iteration)
            numbers = kept


def _numbers(g: ScalarGraph, arrays: Sequence[Nodes]) -> list[list[Any]]:
    """The entries that are numbers; None for others."""
    return [[g.numbers[i] for i in flat(array)] for array in arrays]


def _program(body: ClosedJaxpr, checked: bool, limits: Limits) -> ScalarProgram:
    form = emitted_form(scalarize(body, checked=checked), limits)
    foreign = [call for call in form.calls if not is_while(call)]
    if foreign:
        raise ModelError(f"a loop calls {called_names(foreign)}, without a scalar form.\n  fix: other nodes in it")
    return form


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
