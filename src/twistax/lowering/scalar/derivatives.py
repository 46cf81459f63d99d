"""Derivatives on the graph: what is structurally zero in them is never computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import jaxpr_as_fun
from .entry import Nodes
from .graph import Call, Graph
from .program import ScalarProgram
from .reader import Reader, trace

__all__ = ["columns_of", "cotangent_program", "is_real", "jacobian", "tangent_program"]


def tangent_program(program: ScalarProgram, active: Sequence[int]) -> ScalarProgram:
    """The derivative along tangents of the arguments `active`: (arguments, their tangents) -> tangents of the results.

    Results that are no floating-point numbers have none and are left out.
    """
    g = program.graph
    inputs = list(program.inputs)
    seeds: dict[int, dict[int, int]] = {}
    for k in active:
        tangents = _new_inputs(g, len(inputs), program.inputs[k])
        inputs.append(tangents)
        flat = zip(program.inputs[k].reshape(-1).tolist(), tangents.reshape(-1).tolist(), strict=True)
        seeds |= {node: {0: tangent} for node, tangent in flat}
    found = {node: row[0] for node, row in _carried(program, seeds).items()}
    outputs = _read(g, found, program)
    return ScalarProgram(g, tuple(inputs), outputs, tuple(filter(is_real, program.types)))


def cotangent_program(program: ScalarProgram, active: Sequence[int]) -> ScalarProgram:
    """The transpose: (arguments, cotangents of the floating-point results) -> cotangents of the arguments `active`."""
    g, inputs = program.graph, list(program.inputs)
    found: dict[int, int] = {}
    for nodes, dtype in zip(program.outputs, program.types, strict=True):
        if not is_real(dtype):
            continue
        cotangents = _new_inputs(g, len(inputs), nodes)
        inputs.append(cotangents)
        for i, c in zip(nodes.reshape(-1).tolist(), cotangents.reshape(-1).tolist(), strict=True):
            _accumulate(g, found, i, c)
    _pulled(g, program.live, found, program.depending(active))
    outputs = tuple(_gathered(g, found, program.inputs[k]) for k in active)
    return ScalarProgram(g, tuple(inputs), outputs, tuple(_dtype(g, program.inputs[k]) for k in active))


def jacobian(program: ScalarProgram, active: Sequence[int]) -> dict[tuple[int, int], int]:
    """All derivatives that are not structurally zero: (place in the results, place in the arguments) -> node.

    Places count through all results and through the arguments `active`, one after the other.
    """
    columns = [i for k in active for i in program.inputs[k].reshape(-1).tolist()]
    return columns_of(program, {node: {column: program.graph.one} for column, node in enumerate(columns)})


def columns_of(program: ScalarProgram, seeds: Mapping[int, Mapping[int, int]]) -> dict[tuple[int, int], int]:
    """The derivatives along several tangents at once, by sparse forward accumulation.

    Args:
        seeds: input node -> (tangent -> its entry there), zeros left out.
    Returns:
        (place in the results, tangent) -> node, zeros left out. Each node carries only tangents that reach it.
    """
    carried = _carried(program, seeds)
    return {
        (place, column): node
        for place, output in enumerate(program.flat)
        for column, node in sorted(carried.get(output, {}).items())
    }


# ---- forward ---------------------------------------------------------------------------------------------------------


def _carried(program: ScalarProgram, seeds: Mapping[int, Mapping[int, int]]) -> dict[int, dict[int, int]]:
    """node -> (tangent -> its entry there), of all nodes that are needed, zeros left out."""
    g = program.graph
    carried: dict[int, dict[int, int]] = {node: dict(row) for node, row in seeds.items()}
    called: set[int] = set()
    for i in program.live:
        if i in carried:
            continue
        call = g.call_of(i)
        if call is not None:
            if id(call) not in called:
                called.add(id(call))
                _call_columns(g, call, carried)
            continue
        operation, arguments = g.operation(i), g.arguments(i)
        touched = sorted({column for a in arguments for column in carried.get(a, ())})
        if operation is None or not touched:
            continue
        rows = [carried.get(a, {}) for a in arguments]
        along = operation.tangents(g, arguments, i, [[row.get(column) for row in rows] for column in touched])
        found = {c: v for c, v in zip(touched, along, strict=True) if v is not None and v != g.zero}
        if found:
            carried[i] = found
    return carried


def _call_tangents(g: Graph, call: Call, found: Mapping[int, int]) -> dict[int, int]:
    """The tangents of the results of a call, from the derivative of its function."""
    active = [k for k, a in enumerate(call.arguments) if any(i in found for i in a.reshape(-1).tolist())]
    if not active:
        return {}
    shapes = [_shape(g, a) for a in call.arguments]

    def along(values: list[Any], tangents: list[Any]) -> list[Any]:
        return jax.jvp(_of_some(call, active, values), [values[k] for k in active], tangents)[1]

    key = tuple(active)
    if key not in call.tangents:
        call.tangents[key] = trace(along, shapes, [shapes[k] for k in active])
    jaxpr = call.tangents[key]
    tangents = [_gathered(g, found, call.arguments[k]) for k in active]
    results = Reader(g).read(jaxpr, [*call.arguments, *tangents])
    return {
        i: t
        for nodes, values in zip(call.results, results, strict=True)
        for i, t in zip(nodes.reshape(-1).tolist(), values.reshape(-1).tolist(), strict=True)
        if t != g.zero and jnp.issubdtype(g.dtypes[i], jnp.inexact)
    }


def _call_columns(g: Graph, call: Call, carried: dict[int, dict[int, int]]) -> None:
    """The derivatives of the results of a call, column by column."""
    inputs = [i for a in call.arguments for i in a.reshape(-1).tolist()]
    columns = sorted({column for i in inputs for column in carried.get(i, ())})
    for column in columns:
        seeds = {i: carried[i][column] for i in inputs if column in carried.get(i, ())}
        for i, tangent in _call_tangents(g, call, seeds).items():
            carried.setdefault(i, {})[column] = tangent


# ---- reverse ---------------------------------------------------------------------------------------------------------


def _pulled(g: Graph, live: Sequence[int], found: dict[int, int], depending: set[int]) -> None:
    """Add to `found`, node -> its cotangent, those of all nodes that depend on active inputs, last ones first."""
    done: set[int] = set()
    for i in reversed(live):
        if i not in found or i not in depending:
            continue
        call = g.call_of(i)
        if call is not None:
            # All results of a call stand before whatever reads them: their cotangents are complete.
            if id(call) not in done:
                done.add(id(call))
                _pull_call(g, call, found, depending)
            continue
        operation = g.operation(i)
        if operation is None:
            continue
        arguments = g.arguments(i)
        for a, c in zip(arguments, operation.cotangents(g, arguments, i, found[i]), strict=True):
            if c is not None and a in depending:
                _accumulate(g, found, a, c)


def _pull_call(g: Graph, call: Call, found: dict[int, int], depending: set[int]) -> None:
    active = [
        k
        for k, a in enumerate(call.arguments)
        if jnp.issubdtype(_dtype(g, a), jnp.inexact) and any(i in depending for i in a.reshape(-1).tolist())
    ]
    shapes = [_shape(g, a) for a in call.arguments]
    real = [k for k, r in enumerate(call.results) if jnp.issubdtype(_dtype(g, r), jnp.inexact)]

    def back(values: list[Any], cotangents: list[Any]) -> list[Any]:
        moving = _of_some(call, active, values)
        return list(
            jax.vjp(lambda *some: [moving(*some)[k] for k in real], *[values[k] for k in active])[1](cotangents)
        )

    jaxpr = trace(back, shapes, [_shape(g, call.results[k]) for k in real])
    cotangents = [_gathered(g, found, call.results[k]) for k in real]
    results = Reader(g).read(jaxpr, [*call.arguments, *cotangents])
    for k, values in zip(active, results, strict=True):
        for i, c in zip(call.arguments[k].reshape(-1).tolist(), values.reshape(-1).tolist(), strict=True):
            if i in depending:
                _accumulate(g, found, i, c)


# ---- small things ----------------------------------------------------------------------------------------------------


def _of_some(call: Call, active: Sequence[int], values: Sequence[Any]) -> Callable[..., Any]:
    """The function of a call, of its arguments `active` alone."""

    def function(*some: Any) -> Any:
        given = dict(zip(active, some, strict=True))
        return jaxpr_as_fun(call.jaxpr)(*(given.get(k, value) for k, value in enumerate(values)))

    return function


def _accumulate(g: Graph, found: dict[int, int], node: int, term: int) -> None:
    if term != g.zero:
        found[node] = g.joined(found[node], term) if node in found else term


def _new_inputs(g: Graph, argument: int, like: Nodes) -> Nodes:
    flat = [g.input(argument, j, g.dtypes[i]) for j, i in enumerate(like.reshape(-1).tolist())]
    return np.array(flat, np.int64).reshape(like.shape)


def _read(g: Graph, found: Mapping[int, int], program: ScalarProgram) -> tuple[Nodes, ...]:
    return tuple(
        _gathered(g, found, nodes)
        for nodes, dtype in zip(program.outputs, program.types, strict=True)
        if is_real(dtype)
    )


def is_real(dtype: Any) -> bool:
    """Whether results of a type have derivatives."""
    return bool(jnp.issubdtype(dtype, jnp.floating))


def _gathered(g: Graph, found: Mapping[int, int], nodes: Nodes) -> Nodes:
    """What was found of each node, else zero of its type."""
    flat = [found[i] if i in found else g.constant(0.0, g.dtypes[i]) for i in nodes.reshape(-1).tolist()]
    return np.array(flat, np.int64).reshape(nodes.shape)


def _dtype(g: Graph, nodes: Nodes) -> np.dtype[Any]:
    return g.dtypes[int(nodes.reshape(-1)[0])] if nodes.size else g.dtype


def _shape(g: Graph, nodes: Nodes) -> Any:
    return jax.ShapeDtypeStruct(nodes.shape, jnp.dtype(_dtype(g, nodes)))
