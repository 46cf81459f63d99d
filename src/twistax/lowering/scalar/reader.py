"""A jaxpr as scalars: every equation acts on arrays of nodes, calls and loops of known length are unrolled."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import ClosedJaxpr, Jaxpr, Literal, Unread, alone, inner_jaxprs, jaxpr_as_fun, source_of
from .entry import Nodes
from .graph import Graph
from .table import entry_of, say_unread

__all__ = ["Reader", "trace"]


def trace(function: Callable[..., Any], *shapes: Any) -> ClosedJaxpr:
    """The jaxpr of a function of arrays of these shapes."""
    return jax.make_jaxpr(function)(*shapes)


class _OwnDerivative:
    """A function with a derivative of its own. Equal where both do the same; derivatives are only traced to compare."""

    def __init__(self, name: str, own: ClosedJaxpr, equation: ClosedJaxpr) -> None:
        self._alone = equation
        self._key = (name, source_of(own), _fingerprint(equation))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _OwnDerivative) and self._key == other._key and self._back == other._back

    @functools.cached_property
    def _back(self) -> Any:
        avals = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in self._alone.jaxpr.invars]

        def linear(*values: Any) -> Any:
            real = [k for k, v in enumerate(values) if jnp.issubdtype(v.dtype, jnp.inexact)]

            def moving(*some: Any) -> Any:
                given = dict(zip(real, some, strict=True))
                results = jaxpr_as_fun(self._alone)(*(given.get(k, v) for k, v in enumerate(values)))
                return [r for r in results if jnp.issubdtype(r.dtype, jnp.inexact)]

            results, back = jax.vjp(moving, *(values[k] for k in real))
            return back([jnp.ones_like(r) for r in results])

        return _fingerprint(trace(linear, *avals))


class Reader:
    """Reads jaxprs into one graph.

    Attributes:
        graph: where the scalars go.
        whole: keep functions with a derivative of their own as calls; else they are unrolled.
    """

    def __init__(self, graph: Graph, whole: bool = True) -> None:
        self.graph = graph
        self.whole = whole
        self._literals: dict[Any, Nodes] = {}
        self._reading: list[Jaxpr] = []

    def read(self, program: ClosedJaxpr, inputs: Sequence[Nodes]) -> list[Nodes]:
        """The results of a jaxpr on arrays of nodes."""
        jaxpr, g = program.jaxpr, self.graph
        known: dict[Any, Nodes] = {}

        def value(variable: Any) -> Nodes:
            return self._literal(variable) if isinstance(variable, Literal) else known[variable]

        known.update(zip(jaxpr.constvars, (g.array(c) for c in program.consts), strict=True))
        known.update(zip(jaxpr.invars, inputs, strict=True))
        self._reading.append(jaxpr)
        for eqn in jaxpr.eqns:
            results = self._equation(eqn, [value(v) for v in eqn.invars])
            known.update(zip(eqn.outvars, results, strict=True))
        self._reading.pop()
        return [value(v) for v in jaxpr.outvars]

    def known(self, arrays: Iterable[Nodes]) -> bool:
        """Whether all entries of arrays are numbers."""
        return all(self.graph.values(a) is not None for a in arrays)

    def call(self, eqn: Any, arrays: Sequence[Nodes], own: ClosedJaxpr | None = None) -> list[Nodes]:
        """An equation as a call of a function.

        Args:
            own: what it does, where it is a call only for its own derivative.
        """
        distinct = {v: a for v, a in zip(eqn.invars, arrays, strict=True) if not isinstance(v, Literal)}
        equation = alone(self._reading[-1], eqn, list(distinct))
        # What is unrolled for its derivative only has no effects, and is the same wherever it is the same.
        key = object() if own is None else _OwnDerivative(eqn.primitive.name, own, equation)
        return list(self.graph.call(equation, key, distinct.values(), own is not None).results)

    def _equation(self, eqn: Any, arrays: list[Nodes]) -> list[Nodes]:
        entry, found = entry_of(eqn), None
        if entry is not None and (entry.any_type or not self._foreign(eqn)):
            try:
                found = entry.scalars(self, eqn, *arrays)
            except Unread as error:
                say_unread(error)
        return self.call(eqn, arrays) if found is None else found

    def _literal(self, literal: Any) -> Nodes:
        key = (literal.aval.dtype, np.shape(literal.val), np.asarray(literal.val).tobytes())
        if key not in self._literals:
            self._literals[key] = self.graph.array(np.asarray(literal.val, literal.aval.dtype))
        return self._literals[key]

    def _foreign(self, eqn: Any) -> bool:
        """Whether an equation works in complex numbers, or in a precision that is not the program's."""
        dtypes = (v.aval.dtype for v in (*eqn.invars, *eqn.outvars))
        return any(jnp.issubdtype(dtype, jnp.inexact) and dtype != self.graph.dtype for dtype in dtypes)


def _fingerprint(program: ClosedJaxpr) -> Any:
    """Equal for jaxprs that do the same to arguments of the same types."""
    jaxpr = program.jaxpr
    names: dict[Any, int] = {}

    def name(variable: Any) -> Any:
        if isinstance(variable, Literal):
            return (str(variable.aval), np.asarray(variable.val).tobytes())
        return names.setdefault(variable, len(names))

    head = tuple((name(v), str(v.aval)) for v in (*jaxpr.constvars, *jaxpr.invars))
    body = []
    for eqn in jaxpr.eqns:
        # Callables are the rules of a function with a derivative of its own, which `_OwnDerivative` compares.
        # Elsewhere, as in a callback, they are the operation itself.
        rules = eqn.primitive.name in ("custom_jvp_call", "custom_vjp_call")
        own = {k: v for k, v in eqn.params.items() if not (_holds_jaxprs(v) or (rules and callable(v)))}
        inner = tuple(_fingerprint(each) for each in inner_jaxprs(eqn))
        ins, outs = tuple(map(name, eqn.invars)), tuple(map(name, eqn.outvars))
        body.append((eqn.primitive.name, str(sorted(own.items(), key=lambda e: e[0])), inner, ins, outs))
    consts = tuple((np.asarray(c).dtype.str, np.asarray(c).tobytes()) for c in program.consts)
    return (head, tuple(body), tuple(map(name, jaxpr.outvars)), consts)


def _holds_jaxprs(parameter: Any) -> bool:
    """Whether a parameter of an equation is a jaxpr or a sequence with one among its entries."""
    entries = parameter if isinstance(parameter, (tuple, list)) else (parameter,)
    return any(hasattr(entry, "eqns") for entry in entries)
