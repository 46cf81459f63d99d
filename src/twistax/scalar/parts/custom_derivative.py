"""Keys of functions with a custom derivative, equal for functions that do the same."""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import ClosedJaxpr, Literal, inner_jaxprs, jaxpr_as_fun, source_of
from ..primitives.table import WHERE

#: The directory of this package.
_PACKAGE = str(Path(__file__).parents[3]) + os.sep


class CustomDerivative:
    """A key for functions with a custom derivative. Equal if both do the same; derivatives are traced only to compare.

    Those of this package, by name and place, have one derivative, which is not traced for it.
    """

    def __init__(self, name: str, body: ClosedJaxpr, equation: ClosedJaxpr) -> None:
        self._alone = equation
        source = source_of(body) or ""
        self.key = (name, source, _fingerprint(equation))
        self._named = f" at {_PACKAGE}" in source

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, CustomDerivative)
            and self.key == other.key
            and (self._named or self.transpose == other.transpose)
        )

    @functools.cached_property
    def transpose(self) -> Any:
        avals = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in self._alone.jaxpr.invars]

        def real(*values: Any) -> Any:
            return [r for r in jaxpr_as_fun(self._alone)(*values) if jnp.issubdtype(r.dtype, jnp.inexact)]

        def linear(*values: Any) -> Any:
            results, back = jax.vjp(real, *values)
            return [c for c in back([jnp.ones_like(r) for r in results]) if c.dtype != jax.dtypes.float0]

        return _fingerprint(jax.make_jaxpr(linear)(*avals))


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
        # Callables are the rules of a function with a derivative of its own, which `CustomDerivative` compares.
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
