"""How many operations on scalars a jaxpr amounts to as it stands."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import jax

from ..jax_inside import inner_jaxprs

__all__ = ["array_operations", "has_keys", "largest_array", "primitives"]

#: Operations that only move numbers, or hold others.
_MOVING = frozenset(
    " ".join(
        [
            "broadcast_in_dim concatenate convert_element_type copy copy_p dynamic_slice dynamic_update_slice",
            "expand_dims gather iota optimization_barrier pad reshape rev scatter slice split squeeze stack",
            "stop_gradient tile transpose unstack",
        ]
    ).split(" ")
)
_CUBIC = ("lu", "cholesky", "triangular_solve")


def array_operations(jaxpr: Any) -> Counter[str]:
    """Operations by name, all entries of arrays and all turns of loops counted; factorisations by their cube."""
    found: Counter[str] = Counter()
    for eqn in jaxpr.eqns:
        name = eqn.primitive.name
        inner = inner_jaxprs(eqn)
        out = sum(v.aval.size for v in eqn.outvars)
        if inner:
            for each in inner:
                for kind, count in array_operations(each.jaxpr).items():
                    found[kind] += count * eqn.params.get("length", 1)
        elif name == "dot_general":
            (contracted, _), _ = eqn.params["dimension_numbers"]
            depth = math.prod(eqn.invars[0].aval.shape[i] for i in contracted)
            found["mul"] += depth * out
            found["add"] += (depth - 1) * out
        elif name in _CUBIC:
            found[name] += max(v.aval.size for v in eqn.invars) * max(v.aval.shape[-1] for v in eqn.invars)
        elif name.startswith(("reduce_", "cum", "arg")):
            found[name.removeprefix("reduce_").replace("sum", "add")] += sum(v.aval.size for v in eqn.invars) - out
        elif name not in _MOVING:
            found[name] += out
    return +found


def largest_array(jaxpr: Any) -> int:
    """The number of entries of the largest array that is worked on, also inside of calls and loops."""
    sizes = [v.aval.size for v in (*jaxpr.invars, *(v for eqn in jaxpr.eqns for v in eqn.outvars))]
    return max([*sizes, *(largest_array(inner.jaxpr) for eqn in jaxpr.eqns for inner in inner_jaxprs(eqn))], default=0)


def primitives(jaxpr: Any) -> set[str]:
    """The names of all operations, also inside of calls and loops."""
    inside = [primitives(inner.jaxpr) for eqn in jaxpr.eqns for inner in inner_jaxprs(eqn)]
    return {eqn.primitive.name for eqn in jaxpr.eqns}.union(*inside)


def has_keys(jaxpr: Any) -> bool:
    """Whether random keys, or anything else that is no array of numbers, occur, also inside of calls and loops."""
    variables = [*jaxpr.constvars, *jaxpr.invars, *(v for eqn in jaxpr.eqns for v in eqn.outvars)]
    own = any(jax.dtypes.issubdtype(v.aval.dtype, jax.dtypes.extended) for v in variables if hasattr(v.aval, "dtype"))
    return own or any(has_keys(inner.jaxpr) for eqn in jaxpr.eqns for inner in inner_jaxprs(eqn))
