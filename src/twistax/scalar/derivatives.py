"""Derivatives on the graph, without entries that are structurally zero."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Concatenate, ParamSpec, TypeVar

import jax
import jax.numpy as jnp

from ..jax_inside import ClosedJaxpr, jaxpr_as_fun
from .graph import OpaqueCall, ScalarGraph
from .primitives.cotangents import Cotangent, Cotangents
from .primitives.interface import Nodes, flat, kernel_of, nodes
from .program import ScalarProgram
from .reader import JaxprReader

Own = ParamSpec("Own")
Made = TypeVar("Made")


def _alone(
    derivative: Callable[Concatenate[ScalarProgram, Own], Made],
) -> Callable[Concatenate[ScalarProgram, Own], Made]:
    """A context in which one thread at a time adds to the graph of a program."""

    @functools.wraps(derivative)
    def locked(program: ScalarProgram, *args: Own.args, **kwargs: Own.kwargs) -> Made:
        g = program.graph
        with g.lock:
            before, g.differentiating = g.differentiating, True
            try:
                return derivative(program, *args, **kwargs)
            finally:
                g.differentiating = before

    return locked


def is_real(dtype: Any) -> bool:
    """Whether results of a type have derivatives."""
    return bool(jnp.issubdtype(dtype, jnp.floating))


@_alone
def tangent_program(program: ScalarProgram, active: Sequence[int]) -> ScalarProgram:
    """The derivative along tangents of the arguments `active`: (arguments, their tangents) -> tangents of the results.

    Results that are no floating-point numbers have none and are left out.
    """
    g, inputs = program.graph, list(program.inputs)
    seeds: dict[int, dict[int, int]] = {}
    for k in active:
        inputs.append(_new_inputs(g, len(inputs), program.inputs[k]))
        seeds |= {node: {0: tangent} for node, tangent in zip(flat(program.inputs[k]), flat(inputs[-1]), strict=True)}
    tangents = {node: row[0] for node, row in _carried(program, seeds).items()}
    outputs = tuple(
        _gathered(g, tangents, a) for a, dtype in zip(program.outputs, program.types, strict=True) if is_real(dtype)
    )
    return ScalarProgram(g, tuple(inputs), outputs, tuple(filter(is_real, program.types)))


@_alone
def cotangent_program(program: ScalarProgram, active: Sequence[int]) -> ScalarProgram:
    """The transpose: (arguments, cotangents of the floating-point results) -> cotangents of the arguments `active`."""
    g, cotangents = program.graph, Cotangents(program.graph)
    inputs, weights = _with_cotangents(program)
    for i, c in zip(program.flat, weights, strict=True):
        cotangents.add(i, Cotangent(c, g.one))
    _pull(g, program.live, cotangents, _moving(program, active))
    return _by_arguments(program, inputs, cotangents, active)


@_alone
def contracted_program(program: ScalarProgram, active: Sequence[int]) -> ScalarProgram:
    """The result of `cotangent_program` by way of all derivatives: for few arguments, or functions without reverse
    derivative.
    """
    g, cotangents = program.graph, Cotangents(program.graph)
    inputs, weights = _with_cotangents(program)
    columns = flat(*(program.inputs[k] for k in active))
    for (place, column), entry in jacobian(program, active).items():
        cotangents.add(columns[column], Cotangent(g.mul(entry, weights[place]), g.one))
    return _by_arguments(program, inputs, cotangents, active)


def _moving(program: ScalarProgram, active: Sequence[int]) -> set[int]:
    """The needed nodes that have a derivative by the arguments `active`, and these."""
    g, moving = program.graph, set(flat(*(program.inputs[k] for k in active)))
    for i in program.live:
        call = g.call_of(i)
        if kernel_of(call) is None and not moving.isdisjoint(g.sources(i)):
            moving.add(i)
    return moving


def _with_cotangents(program: ScalarProgram) -> tuple[list[Nodes], list[int]]:
    """The arguments and new ones for cotangents of real results, and the cotangent of each entry of all results."""
    g, inputs, weights = program.graph, list(program.inputs), list[int]()
    for output, dtype in zip(program.outputs, program.types, strict=True):
        if is_real(dtype):
            inputs.append(_new_inputs(g, len(inputs), output))
        weights += flat(inputs[-1]) if is_real(dtype) else [g.zero] * output.size
    return inputs, weights


def _by_arguments(
    program: ScalarProgram, inputs: Sequence[Nodes], values: Mapping[int, int], active: Sequence[int]
) -> ScalarProgram:
    """The values of the entries of the arguments `active`, as a program."""
    g, arguments = program.graph, [program.inputs[k] for k in active]
    outputs = tuple(_gathered(g, values, a) for a in arguments)
    return ScalarProgram(g, tuple(inputs), outputs, tuple(map(g.dtype_of, arguments)))


def jacobian(program: ScalarProgram, active: Sequence[int]) -> dict[tuple[int, int], int]:
    """All derivatives that are not structurally zero: (place in the results, place in the arguments) -> node.

    Places count through all results and through the arguments `active`, one after the other.
    """
    columns = flat(*(program.inputs[k] for k in active))
    return columns_of(program, {node: {column: program.graph.one} for column, node in enumerate(columns)})


@_alone
def columns_of(
    program: ScalarProgram, seeds: Mapping[int, Mapping[int, int]], wanted: Mapping[int, int] | None = None
) -> dict[tuple[int, int], int]:
    """The derivatives along several tangents at once, by sparse forward accumulation.

    Args:
        seeds: input node -> (tangent -> its entry there), zeros left out.
        wanted: node -> the tangents it may carry, as `needed` gives them; all if None.
    Returns:
        (place in the results, tangent) -> node, zeros left out. Each node carries only tangents that reach it.
    """
    carried = _carried(program, seeds, wanted)
    return {
        (place, column): node
        for place, output in enumerate(program.flat)
        for column, node in sorted(carried.get(output, {}).items())
    }


def reached(program: ScalarProgram, seeds: Mapping[int, Mapping[int, int]]) -> dict[int, int]:
    """node -> the tangents on which it may depend, as a bit mask."""
    tangents_of = {node: sum(1 << tangent for tangent in row) for node, row in seeds.items()}
    for i in program.live:
        if i not in tangents_of:
            sources = program.graph.sources(i)
            tangents_of[i] = functools.reduce(operator.or_, (tangents_of.get(a, 0) for a in sources), 0)
    return tangents_of


def needed(program: ScalarProgram, wanted: Mapping[int, int]) -> dict[int, int]:
    """node -> the tangents that it must propagate so that some nodes have the required ones, as a bit mask."""
    tangents_of = dict(wanted)
    for i in reversed(program.live):
        if tangents := tangents_of.get(i, 0):
            for a in program.graph.sources(i):
                tangents_of[a] = tangents_of.get(a, 0) | tangents
    return tangents_of


# ---- forward ---------------------------------------------------------------------------------------------------------


def _carried(
    program: ScalarProgram, seeds: Mapping[int, Mapping[int, int]], wanted: Mapping[int, int] | None = None
) -> dict[int, dict[int, int]]:
    """node -> (tangent -> derivative), for all needed nodes, without zeros."""
    g = program.graph
    carried: dict[int, dict[int, int]] = {node: dict(row) for node, row in seeds.items()}
    called: set[int] = set()
    for i in program.live:
        if i in carried:
            continue
        call, operation, arguments = g.call_of(i), g.operation(i), g.arguments(i)
        if call is not None and id(call) not in called:
            called.add(id(call))
            _carry_call(g, call, carried, wanted)
        touched = _allowed({column for a in arguments for column in carried.get(a, ())}, [i], wanted)
        if operation is None or not touched:
            continue
        rows = [carried.get(a, {}) for a in arguments]
        values = operation.tangents(g, arguments, i, [[row.get(column) for row in rows] for column in touched])
        nonzero = {c: v for c, v in zip(touched, values, strict=True) if v is not None and v != g.zero}
        if nonzero:
            carried[i] = nonzero
    return carried


def _allowed(columns: set[int], reached_nodes: Sequence[int], wanted: Mapping[int, int] | None) -> list[int]:
    """The bit mask of the columns of some nodes."""
    if wanted is None:
        return sorted(columns)
    mask = functools.reduce(operator.or_, (wanted.get(i, 0) for i in reached_nodes), 0)
    return sorted(column for column in columns if mask >> column & 1)


def _carry_call(
    g: ScalarGraph, call: OpaqueCall, carried: dict[int, dict[int, int]], wanted: Mapping[int, int] | None
) -> None:
    """The derivatives of the results of a call, column by column."""
    if kernel_of(call) is not None:
        return
    inputs = flat(*call.arguments)
    for column in _allowed({c for i in inputs for c in carried.get(i, ())}, flat(*call.results), wanted):
        seeds = {i: carried[i][column] for i in inputs if column in carried.get(i, ())}
        active = tuple(k for k, a in enumerate(call.arguments) if any(i in seeds for i in flat(a)))
        program = _tangents(_function(g, call), active)
        arguments = [*call.arguments, *(_gathered(g, seeds, call.arguments[k]) for k in active)]
        for i, tangent in zip(flat(*call.results), flat(*JaxprReader(g).read(program, arguments)), strict=True):
            if tangent != g.zero and jnp.issubdtype(g.dtypes[i], jnp.inexact):
                carried.setdefault(i, {})[column] = tangent


@functools.lru_cache(512)
def _tangents(called: _Called, active: tuple[int, ...]) -> ClosedJaxpr:
    """The derivative of the function of a call: (arguments, tangents of the active ones)."""

    def along(arguments: list[Any], tangents: list[Any]) -> list[Any]:
        return jax.jvp(_of_some(called.jaxpr, active, arguments), [arguments[k] for k in active], tangents)[1]

    return jax.make_jaxpr(along)(list(called.arguments), [called.arguments[k] for k in active])


# ---- reverse ---------------------------------------------------------------------------------------------------------


def _pull(g: ScalarGraph, live: Sequence[int], cotangents: Cotangents, depending: Collection[int]) -> None:
    """Add to `cotangents` those of all nodes that depend on active inputs, last ones first."""
    done: set[int] = set()
    for i in reversed(live):
        if i not in cotangents or i not in depending:
            continue
        call, operation, arguments = g.call_of(i), g.operation(i), g.arguments(i)
        pairs: Any = ()
        if operation is not None:
            terms = [operation.cotangents(g, arguments, i, term) for term in cotangents.of(i)]
            pairs = [pair for by_argument in terms for pair in zip(arguments, by_argument, strict=True)]
        elif call is not None and id(call) not in done:
            # Every node that reads a result of the call comes later in the order: the cotangents are complete.
            done.add(id(call))
            pairs = _pulled_call(g, call, cotangents, depending)
        for a, c in pairs:
            if c is not None and a in depending:
                cotangents.add(a, c)


def _pulled_call(
    g: ScalarGraph, call: OpaqueCall, known_cotangents: Mapping[int, int], depending: Collection[int]
) -> list[tuple[int, Cotangent]]:
    """The arguments of a call and their cotangents."""
    real = [k for k, r in enumerate(call.results) if jnp.issubdtype(g.dtype_of(r), jnp.inexact)]
    active = tuple(
        k
        for k, a in enumerate(call.arguments)
        if jnp.issubdtype(g.dtype_of(a), jnp.inexact) and any(i in depending for i in flat(a))
    )
    arguments = [*call.arguments, *(_gathered(g, known_cotangents, call.results[k]) for k in real)]
    results = JaxprReader(g).read(_cotangents(_function(g, call), active, tuple(real)), arguments)
    cotangents = [Cotangent(c, g.one) for c in flat(*results)]
    return list(zip(flat(*(call.arguments[k] for k in active)), cotangents, strict=True))


@functools.lru_cache(512)
def _cotangents(called: _Called, active: tuple[int, ...], real: tuple[int, ...]) -> ClosedJaxpr:
    """The transpose of the function of a call: (arguments, cotangents of the real results)."""

    def back(values: list[Any], cotangents: list[Any]) -> list[Any]:
        moving = _of_some(called.jaxpr, active, values)
        primals = [values[k] for k in active]
        return list(jax.vjp(lambda *some: [moving(*some)[k] for k in real], *primals)[1](cotangents))

    return jax.make_jaxpr(back)(list(called.arguments), [called.results[k] for k in real])


# ---- the functions of calls ------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Called:
    """The function of a call. Equal for calls that do the same in any graph, so that derivatives are traced once."""

    key: Any
    arguments: tuple[jax.ShapeDtypeStruct, ...]
    results: tuple[jax.ShapeDtypeStruct, ...]
    jaxpr: ClosedJaxpr = dataclasses.field(compare=False)


def _function(g: ScalarGraph, call: OpaqueCall) -> _Called:
    arguments, results = (tuple(_shape(g, a) for a in arrays) for arrays in (call.arguments, call.results))
    return _Called(call.key, arguments, results, call.jaxpr)


# ---- arrays of nodes -------------------------------------------------------------------------------------------------


def _of_some(jaxpr: ClosedJaxpr, active: Sequence[int], values: Sequence[Any]) -> Callable[..., Any]:
    """A function of the arguments `active` only."""

    def function(*some: Any) -> Any:
        replaced = dict(zip(active, some, strict=True))
        return jaxpr_as_fun(jaxpr)(*(replaced.get(k, value) for k, value in enumerate(values)))

    return function


def _new_inputs(g: ScalarGraph, argument: int, like: Nodes) -> Nodes:
    return nodes([g.input(argument, j, g.dtypes[i]) for j, i in enumerate(flat(like))], like.shape)


def _gathered(g: ScalarGraph, values: Mapping[int, int], array: Nodes) -> Nodes:
    """The value of each node of an array, zero of its type where there is none."""
    return nodes([values[i] if i in values else g.constant(0.0, g.dtypes[i]) for i in flat(array)], array.shape)


def _shape(g: ScalarGraph, array: Nodes) -> Any:
    return jax.ShapeDtypeStruct(array.shape, g.dtype_of(array))
