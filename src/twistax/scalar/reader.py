"""Jaxprs read into a graph of scalars, every equation on arrays of nodes."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import (
    ClosedJaxpr,
    Jaxpr,
    Literal,
    Unread,
    all_equations,
    alone,
    inner_jaxprs,
    is_key,
    jaxpr_as_fun,
    on_key_data,
    source_of,
)
from .graph import LIMITS, OpaqueCall, ScalarGraph
from .primitives.interface import Limits, Nodes, flat, nodes
from .primitives.table import OPERATIONS, WHERE, entry_of, say_unread
from .program import ScalarProgram

_DIV = OPERATIONS["div"]

#: The directory of this package.
_PACKAGE = str(Path(__file__).parents[2]) + os.sep


class _OwnDerivative:
    """A key for functions with a custom derivative. Equal if both do the same; derivatives are traced only to compare.

    Those of this package, by name and place, have one derivative, which is not traced for it.
    """

    def __init__(self, name: str, body: ClosedJaxpr, equation: ClosedJaxpr) -> None:
        self._alone = equation
        source = source_of(body) or ""
        self._key = (name, source, _fingerprint(equation))
        self._named = f" at {_PACKAGE}" in source

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, _OwnDerivative) and self._key == other._key and (self._named or self._back == other._back)
        )

    @functools.cached_property
    def _back(self) -> Any:
        avals = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in self._alone.jaxpr.invars]

        def real(*values: Any) -> Any:
            return [r for r in jaxpr_as_fun(self._alone)(*values) if jnp.issubdtype(r.dtype, jnp.inexact)]

        def linear(*values: Any) -> Any:
            results, back = jax.vjp(real, *values)
            return [c for c in back([jnp.ones_like(r) for r in results]) if c.dtype != jax.dtypes.float0]

        return _fingerprint(jax.make_jaxpr(linear)(*avals))


class JaxprReader:
    """Reads jaxprs into one graph.

    Attributes:
        graph: where the scalars go.
        keep_calls: whether functions with a custom derivative stay calls; else they are unrolled.
    """

    def __init__(self, graph: ScalarGraph, keep_calls: bool = True) -> None:
        self.graph = graph
        self.keeps_calls = keep_calls
        self._literals: dict[Any, Nodes] = {}
        self._reading: list[Jaxpr] = []

    def read(self, program: ClosedJaxpr, inputs: Sequence[Nodes]) -> list[Nodes]:
        """The results of a jaxpr on arrays of nodes. Random keys are the arrays of their numbers."""
        jaxpr, g = program.jaxpr, self.graph
        known: dict[Any, Nodes] = {}

        def value(variable: Any) -> Nodes:
            return self._literal(variable) if isinstance(variable, Literal) else known[variable]

        consts = zip(jaxpr.constvars, program.consts, strict=True)
        with jax.ensure_compile_time_eval():
            known.update((v, g.array(jax.random.key_data(c) if is_key(v) else c)) for v, c in consts)
        known.update(zip(jaxpr.invars, inputs, strict=True))
        self._reading.append(jaxpr)
        for eqn in jaxpr.eqns:
            results = self._equation(eqn, [value(v) for v in eqn.invars])
            known.update(zip(eqn.outvars, results, strict=True))
        self._reading.pop()
        return [value(v) for v in jaxpr.outvars]

    def inlined(self, program: ScalarProgram, inputs: Sequence[Nodes]) -> list[Nodes]:
        """The results of a scalar program on arrays of nodes."""
        known = dict(zip(flat(*program.inputs), flat(*inputs), strict=True))
        self.copy(program, known)
        return [renamed(known, array) for array in program.outputs]

    def known(self, arrays: Iterable[Nodes]) -> bool:
        """Whether all entries of arrays are numbers."""
        return all(self.graph.values(a) is not None for a in arrays)

    def call(self, eqn: Any, arrays: Sequence[Nodes], body: ClosedJaxpr | None = None) -> list[Nodes]:
        """An equation as a call of a function.

        Args:
            body: what it does, for a function that is called only because of its custom derivative.
        """
        distinct = {v: a for v, a in zip(eqn.invars, arrays, strict=True) if not isinstance(v, Literal)}
        equation = on_key_data(alone(self._reading[-1], eqn, list(distinct)))
        # What is unrolled for its derivative only has no effects, and is the same wherever it is the same.
        key = object() if body is None else _OwnDerivative(eqn.primitive.name, body, equation)
        return list(self.graph.call(equation, key, distinct.values(), body is not None).results)

    def copy(
        self,
        program: ScalarProgram,
        known: dict[int, int],
        shared: Collection[int] = (),
        order: Sequence[int] | None = None,
    ) -> None:
        """Add the nodes of a program to the graph.

        Args:
            known: node of the program -> node of this graph: at first its inputs, afterwards all that are needed.
            shared: divisors of which the reciprocal is taken once.
            order: of the nodes; as they are if None.
        """
        old, new = program.graph, self.graph
        done: set[int] = set()
        for i in program.live if order is None else order:
            if i in known:
                continue
            call, operation = old.call_of(i), old.operation(i)
            if call is not None:
                if id(call) not in done:
                    done.add(id(call))
                    self._copy_call(call, known)
            elif operation is None:
                known[i] = new.constant(old.numbers[i], old.dtypes[i])
            else:
                arguments = [known[a] for a in old.arguments(i)]
                if operation is _DIV and old.arguments(i)[1] in shared:
                    known[i] = new.mul(arguments[0], new.div(new.one, arguments[1]))
                elif operation.written is not None and not self.keeps_calls:
                    known[i] = operation.written(new)(*arguments)
                else:
                    known[i] = operation.on(new)(*arguments)

    def _copy_call(self, call: OpaqueCall, known: dict[int, int]) -> None:
        arguments = [renamed(known, array) for array in call.arguments]
        # What was a call for its size may fit a graph that unrolls more.
        if not self.keeps_calls and (call.inline or self.graph.limits != LIMITS):
            results = self.read(call.jaxpr, arguments)
        else:
            results = list(self.graph.call(call.jaxpr, call.key, arguments, call.inline).results)
        known.update(zip(flat(*call.results), flat(*results), strict=True))

    def _equation(self, eqn: Any, arrays: list[Nodes]) -> list[Nodes]:
        entry, scalars = entry_of(eqn), None
        if any(map(is_key, (*eqn.invars, *eqn.outvars))) and eqn.primitive.name != "jit":
            return self.call(eqn, arrays)
        if entry is not None and (entry.any_type or not self._foreign(eqn)):
            try:
                scalars = entry.scalars(self, eqn, *arrays)
            except Unread as error:
                say_unread(error)
        return self.call(eqn, arrays) if scalars is None else scalars

    def _literal(self, literal: Any) -> Nodes:
        key = (literal.aval.dtype, np.shape(literal.val), np.asarray(literal.val).tobytes())
        if key not in self._literals:
            self._literals[key] = self.graph.array(np.asarray(literal.val, literal.aval.dtype))
        return self._literals[key]

    def _foreign(self, eqn: Any) -> bool:
        """Whether an equation works in complex numbers, or in a precision that is not the program's."""
        dtypes = (v.aval.dtype for v in (*eqn.invars, *eqn.outvars))
        return any(jnp.issubdtype(dtype, jnp.inexact) and dtype != self.graph.dtype for dtype in dtypes)


#: Parameters of a jitted function on which no computed value depends.
_MOVED = frozenset(WHERE.split())


def _fingerprint(program: ClosedJaxpr) -> Any:
    """Equal for jaxprs that do the same to arguments of the same types."""
    jaxpr = program.jaxpr
    names: dict[Any, int] = {}

    def name(variable: Any) -> Any:
        if isinstance(variable, Literal):
            return (variable.aval, np.asarray(variable.val).tobytes())
        return names.setdefault(variable, len(names))

    head = tuple((name(v), v.aval) for v in (*jaxpr.constvars, *jaxpr.invars))
    body = []
    for eqn in jaxpr.eqns:
        # Callables are the rules of a function with a derivative of its own, which `_OwnDerivative` compares.
        # Elsewhere, as in a callback, they are the operation itself.
        rules = eqn.primitive.name in ("custom_jvp_call", "custom_vjp_call")
        moved = _MOVED if eqn.primitive.name == "jit" else ()
        params = [
            (k, v)
            for k, v in sorted(eqn.params.items())
            if not (k in moved or _holds_jaxprs(v) or (rules and callable(v)))
        ]
        inner = tuple(_fingerprint(jaxpr_inside) for jaxpr_inside in inner_jaxprs(eqn))
        ins, outs = tuple(map(name, eqn.invars)), tuple(map(name, eqn.outvars))
        body.append((eqn.primitive.name, str(params), inner, ins, outs))
    consts = tuple((np.asarray(c).dtype.str, np.asarray(c).tobytes()) for c in program.consts)
    return (head, tuple(body), tuple(map(name, jaxpr.outvars)), consts)


def _holds_jaxprs(parameter: Any) -> bool:
    """Whether a parameter of an equation is a jaxpr or a sequence with one among its entries."""
    entries = parameter if isinstance(parameter, (tuple, list)) else (parameter,)
    return any(hasattr(entry, "eqns") for entry in entries)


def renamed(known: dict[int, int], array: Nodes) -> Nodes:
    """An array of nodes of the old graph, in the new one."""
    return nodes([known[i] for i in flat(array)], array.shape)


def scalarize(
    function: Callable[..., Any] | ClosedJaxpr,
    *shapes: Any,
    checked: bool = False,
    largest: int = 200_000,
    limits: Limits = LIMITS,
) -> ScalarProgram:
    """A function of arrays, results a list of arrays, as a scalar program.

    Args:
        function: traceable; or its jaxpr.
        shapes: of the arguments, with types; left out for a jaxpr.
        checked: keep 0 x, 0 / x and x - x, which differ from zero where x is not finite.
        largest: the most scalars there may be.
        limits: up to which size parts are unrolled.
    Raises:
        TooLarge: more scalars than are good for a compiler.
    """
    closed = function if isinstance(function, ClosedJaxpr) else jax.make_jaxpr(function)(*shapes)
    avals = [v.aval for v in closed.jaxpr.invars]
    types = (np.dtype(a.dtype) for a in [*avals, *(v.aval for v in closed.jaxpr.outvars)])
    precision = next((t for t in types if t.kind == "f"), np.dtype(jax.dtypes.canonicalize_dtype(float)))
    # Of the operations on scalars only the angle of a point distinguishes signed zeros.
    signed_zeros = any(eqn.primitive.name == "atan2" for eqn in all_equations(closed.jaxpr))
    graph = ScalarGraph(precision, checked, largest, limits, signed_zeros)
    inputs = tuple(
        nodes([graph.input(k, j, np.dtype(a.dtype)) for j in range(a.size)], a.shape) for k, a in enumerate(avals)
    )
    outputs = JaxprReader(graph).read(closed, inputs)
    return ScalarProgram(graph, inputs, tuple(outputs), tuple(np.dtype(v.aval.dtype) for v in closed.jaxpr.outvars))
