"""A jaxpr as scalars: every equation acts on arrays of nodes, calls and loops of known length are written out."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import (
    ClosedJaxpr,
    Literal,
    Unread,
    alone,
    closed,
    expansion,
    inner_jaxprs,
    jaxpr_as_fun,
    say_once,
    scan_parts,
    source_of,
)
from .graph import Graph, Nodes
from .operations import by_primitive
from .rules import RULES
from .rules.movement import MOVEMENT

__all__ = ["Reader", "trace"]

#: Parameters that hold the function of a call that is read as if written out.
_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat2": "jaxpr",
}

#: Calls that have a derivative of their own: kept whole for it.
_OWN_DERIVATIVE = ("custom_jvp_call", "custom_vjp_call", "custom_linear_solve")

#: Rules that hold for numbers of any type.
_ANY_TYPE = frozenset(MOVEMENT) | {"convert_element_type", "copy", "copy_p", "optimization_barrier"}


def trace(function: Callable[..., Any], *shapes: Any) -> ClosedJaxpr:
    """The jaxpr of a function of arrays of these shapes."""
    return jax.make_jaxpr(function)(*shapes)


class _OwnDerivative:
    """A function with a derivative of its own. Equal where both do the same; derivatives are only traced to compare."""

    def __init__(self, eqn: Any, equation: ClosedJaxpr) -> None:
        self._alone = equation
        self._key = (eqn.primitive.name, source_of(_own(eqn)), _fingerprint(equation))

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
        whole: keep functions with a derivative of their own as calls; else they are written out.
        unread: the names of primitives that are called as they are.
    """

    def __init__(self, graph: Graph, whole: bool = True) -> None:
        self.graph = graph
        self.whole = whole
        self.unread: set[str] = set()
        self._literals: dict[Any, Nodes] = {}

    def read(self, program: ClosedJaxpr, inputs: Sequence[Nodes]) -> list[Nodes]:
        """The results of a jaxpr on arrays of nodes."""
        jaxpr, g = program.jaxpr, self.graph
        known: dict[Any, Nodes] = {}

        def value(variable: Any) -> Nodes:
            return self._literal(variable) if isinstance(variable, Literal) else known[variable]

        known.update(zip(jaxpr.constvars, (g.array(c) for c in program.consts), strict=True))
        known.update(zip(jaxpr.invars, inputs, strict=True))
        for eqn in jaxpr.eqns:
            results = self._equation(jaxpr, eqn, [value(v) for v in eqn.invars])
            known.update(zip(eqn.outvars, results, strict=True))
        return [value(v) for v in jaxpr.outvars]

    def _literal(self, literal: Any) -> Nodes:
        key = (literal.aval.dtype, np.shape(literal.val), np.asarray(literal.val).tobytes())
        if key not in self._literals:
            self._literals[key] = self.graph.array(np.asarray(literal.val, literal.aval.dtype))
        return self._literals[key]

    def _equation(self, jaxpr: Any, eqn: Any, arrays: list[Nodes]) -> list[Nodes]:
        name = eqn.primitive.name
        if name in _CALLS:
            return self.read(closed(eqn.params[_CALLS[name]]), arrays)
        if name in _OWN_DERIVATIVE:
            out = not self.whole or self._constant(eqn, arrays)
            return self._written_out(eqn, arrays) if out else self._call(jaxpr, eqn, arrays, inline=True)
        try:
            special = _SPECIAL.get(name)
            found = special(self, eqn, arrays) if special else None
            if found is None and name in RULES and (name in _ANY_TYPE or not self._foreign(eqn)):
                found = RULES[name](self.graph, eqn, *arrays)
        except Unread as error:
            say_once(f"{error}, which this twistax does not know: that operation runs as JAX has it")
            found = None
        if found is None:
            self.unread.add(name)
            found = self._call(jaxpr, eqn, arrays, inline=False)
        return found

    def _constant(self, eqn: Any, arrays: list[Nodes]) -> bool:
        """Whether a function with a derivative of its own needs none: all is known, of a solve the matrix."""
        if eqn.primitive.name == "custom_linear_solve":
            arrays = arrays[: sum(eqn.params["const_lengths"])]
        return all(self.graph.values(a) is not None for a in arrays)

    def _written_out(self, eqn: Any, arrays: list[Nodes]) -> list[Nodes]:
        """What a function with a derivative of its own does; a solve, by the solver that it came with."""
        if eqn.primitive.name != "custom_linear_solve":
            return self.read(_own(eqn), arrays)
        counts = eqn.params["const_lengths"]
        skip, right = counts.matvec + counts.vecmat, arrays[sum(counts) :]
        return self.read(_own(eqn), [*arrays[skip : skip + counts.solve], *right])

    def _foreign(self, eqn: Any) -> bool:
        """Whether an equation works in complex numbers, or in a precision that is not the program's."""
        dtypes = (v.aval.dtype for v in (*eqn.invars, *eqn.outvars))
        return any(jnp.issubdtype(dtype, jnp.inexact) and dtype != self.graph.dtype for dtype in dtypes)

    def _call(self, jaxpr: Any, eqn: Any, arrays: list[Nodes], inline: bool) -> list[Nodes]:
        """An equation as a call of a function."""
        distinct = {v: a for v, a in zip(eqn.invars, arrays, strict=True) if not isinstance(v, Literal)}
        equation = alone(jaxpr, eqn, list(distinct))
        # What is written out for its derivative only has no effects, and is the same wherever it is the same.
        key = _OwnDerivative(eqn, equation) if inline else object()
        return list(self.graph.call(equation, key, distinct.values(), inline).results)

    def _expansion(self, eqn: Any, arrays: list[Nodes]) -> list[Nodes] | None:
        inside = expansion(eqn, own_derivatives=False)
        return None if inside is None else self.read(inside, arrays)

    # ---- control flow --------------------------------------------------------------------------------------------

    def _scan(self, eqn: Any, arrays: list[Nodes]) -> list[Nodes] | None:
        p = eqn.params
        body, length = p["jaxpr"], p["length"]
        if length * _equations(body.jaxpr) > self.graph.limits.equations:
            return None
        fixed, carried = scan_parts(eqn)
        consts, carry, along = arrays[:fixed], arrays[fixed : fixed + carried], arrays[fixed + carried :]
        rows: list[list[Nodes]] = []
        for k in reversed(range(length)) if p["reverse"] else range(length):
            found = self.read(body, [*consts, *carry, *(np.asarray(a[k]) for a in along)])
            carry = found[:carried]
            rows.append(found[carried:])
        if p["reverse"]:
            rows = rows[::-1]
        shapes = [v.aval.shape for v in eqn.outvars[carried:]]
        stacked = [np.array([row[i] for row in rows], np.int64).reshape(shape) for i, shape in enumerate(shapes)]
        return [*carry, *stacked]

    def _cond(self, eqn: Any, arrays: list[Nodes]) -> list[Nodes] | None:
        """The branch that is known, or all of them with the results selected."""
        index, *operands = arrays
        branches, g = eqn.params["branches"], self.graph
        number = g.numbers[int(index)]
        if number is not None:
            return self.read(branches[int(np.clip(number, 0, len(branches) - 1))], operands)
        if sum(_equations(b.jaxpr) for b in branches) > self.graph.limits.equations:
            return None
        before = len(g.calls)
        cases = [self.read(branch, operands) for branch in branches]
        if not all(call.inline for call in g.calls[before:]):
            return None  # what is not written out runs only where its branch is taken: it may be a loop without end
        last = cases[-1]
        for k in range(len(branches) - 2, -1, -1):
            here = g.node(by_primitive["le"], int(index), g.constant(k, g.dtypes[int(index)]))
            last = [
                np.array(
                    [g.select(here, a, b) for a, b in zip(x.reshape(-1).tolist(), y.reshape(-1).tolist(), strict=True)],
                    np.int64,
                ).reshape(x.shape)
                for x, y in zip(cases[k], last, strict=True)
            ]
        return last


_SPECIAL: dict[str, Callable[[Reader, Any, list[Nodes]], list[Nodes] | None]] = {
    "scan": Reader._scan,
    "cond": Reader._cond,
    "call_hi_primitive": Reader._expansion,
}


def _equations(jaxpr: Any) -> int:
    """Equations, inner ones included."""
    return sum(1 + sum(_equations(inner.jaxpr) for inner in inner_jaxprs(eqn)) for eqn in jaxpr.eqns)


def _own(eqn: Any) -> ClosedJaxpr:
    """What a function with a derivative of its own does."""
    return closed(eqn.params["jaxprs"].solve if "jaxprs" in eqn.params else eqn.params["call_jaxpr"])


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
        own = {k: v for k, v in eqn.params.items() if not callable(v) and not _holds_jaxprs(v)}
        inner = tuple(_fingerprint(each) for each in inner_jaxprs(eqn))
        ins, outs = tuple(map(name, eqn.invars)), tuple(map(name, eqn.outvars))
        body.append((eqn.primitive.name, str(sorted(own.items(), key=lambda e: e[0])), inner, ins, outs))
    consts = tuple((np.asarray(c).dtype.str, np.asarray(c).tobytes()) for c in program.consts)
    return (head, tuple(body), tuple(map(name, jaxpr.outvars)), consts)


def _holds_jaxprs(parameter: Any) -> bool:
    """Whether a parameter of an equation is a jaxpr or a sequence with one among its entries."""
    entries = parameter if isinstance(parameter, (tuple, list)) else (parameter,)
    return any(hasattr(entry, "eqns") for entry in entries)
