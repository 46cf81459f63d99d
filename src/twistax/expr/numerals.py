"""A function of arrays worked out on NumPy's numbers: XLA would compile a program for each operation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import ClosedJaxpr, Literal

#: What constants are folded with most; JAX itself does whatever is not here.
_IN_NUMPY: dict[str, Callable[..., Any]] = {
    "add": lambda a, b, **_: a + b,
    "add_any": lambda a, b, **_: a + b,
    "sub": lambda a, b, **_: a - b,
    "mul": lambda a, b, **_: a * b,
    "neg": lambda a, **_: -a,
    "abs": lambda a, **_: np.abs(a),
    "max": lambda a, b, **_: np.maximum(a, b),
    "min": lambda a, b, **_: np.minimum(a, b),
    "eq": lambda a, b, **_: a == b,
    "ne": lambda a, b, **_: a != b,
    "lt": lambda a, b, **_: a < b,
    "le": lambda a, b, **_: a <= b,
    "gt": lambda a, b, **_: a > b,
    "ge": lambda a, b, **_: a >= b,
    "and": lambda a, b, **_: a & b,
    "or": lambda a, b, **_: a | b,
    "not": lambda a, **_: ~a,
    "select_n": lambda which, *cases, **_: np.choose(np.asarray(which, int), cases),
    "convert_element_type": lambda a, **_: a,  # the type of a result is taken from its equation
    "square": lambda a, **_: a * a,
    "sqrt": lambda a, **_: np.sqrt(a),
    "reduce_sum": lambda a, *, axes, **_: np.sum(a, axis=tuple(axes)),
    "slice": lambda a, *, start_indices, limit_indices, strides, **_: a[
        tuple(map(slice, start_indices, limit_indices, strides or [1] * a.ndim))
    ],
    "squeeze": lambda a, *, dimensions, **_: np.squeeze(a, tuple(dimensions)),
    "reshape": lambda a, *, new_sizes, **_: np.reshape(a, new_sizes),
    "transpose": lambda a, *, permutation, **_: np.transpose(a, permutation),
    "concatenate": lambda *parts, dimension, **_: np.concatenate(parts, dimension),
    "stack": lambda *parts, axis, **_: np.stack(parts, axis),
    "broadcast_in_dim": lambda a, *, shape, broadcast_dimensions, **_: np.broadcast_to(
        np.expand_dims(a, [k for k in range(len(shape)) if k not in broadcast_dimensions]), shape
    ),
    "unstack": lambda a, *, axis, **_: list(np.moveaxis(a, axis, 0)),
    "dot_general": lambda a, b, *, dimension_numbers, **_: np.tensordot(a, b, dimension_numbers[0]),
    "copy": lambda a, **_: a,
}


def numerals(function: Callable[..., Any], values: Sequence[np.ndarray], traced: bool) -> np.ndarray:
    """The one result of a function of arrays, traceable by JAX.

    Args:
        traced: False for a function that takes NumPy's arrays as they are.
    """
    with np.errstate(all="ignore"):  # what is not finite is the caller's to judge
        if not traced:
            return np.asarray(function(*values))
        closed = jax.make_jaxpr(function)(*values)
        if _in_numpy(closed.jaxpr):
            return _worked_out(closed, values)[0]
    return np.asarray(function(*map(jnp.asarray, values)))


def _in_numpy(jaxpr: Any) -> bool:
    return all(_in_numpy(inner.jaxpr) if (inner := _inner(eqn)) else _is_listed(eqn) for eqn in jaxpr.eqns)


def _inner(eqn: Any) -> ClosedJaxpr | None:
    return eqn.params["jaxpr"] if eqn.primitive.name == "jit" else None


def _is_listed(eqn: Any) -> bool:
    return eqn.primitive.name in _IN_NUMPY and not _differs(eqn.primitive.name, eqn)


def _differs(name: str, eqn: Any) -> bool:
    """Whether NumPy would do something else."""
    given, result = [v.aval.dtype for v in eqn.invars], eqn.outvars[0].aval.dtype
    if name == "dot_general":
        return bool(eqn.params["dimension_numbers"][1][0]) or {*given} != {result}
    if name == "reshape":
        return eqn.params["dimensions"] is not None
    if name == "select_n":
        return given[0] != np.dtype(bool)
    # Not a number, and what is out of range.
    return (
        name == "convert_element_type" and jnp.issubdtype(given[0], jnp.inexact) and jnp.issubdtype(result, jnp.integer)
    )


def _worked_out(closed: ClosedJaxpr, values: Sequence[Any]) -> list[np.ndarray]:
    jaxpr = closed.jaxpr
    known = dict(zip(jaxpr.constvars, closed.consts, strict=True))
    known.update(zip(jaxpr.invars, values, strict=True))

    def value(variable: Any) -> np.ndarray:
        return np.asarray(variable.val if isinstance(variable, Literal) else known[variable], variable.aval.dtype)

    for eqn in jaxpr.eqns:
        inputs = [value(each) for each in eqn.invars]
        if inner := _inner(eqn):
            results = _worked_out(inner, inputs)
        else:
            found = _IN_NUMPY[eqn.primitive.name](*inputs, **eqn.params)
            results = found if eqn.primitive.multiple_results else [found]
        known.update(zip(eqn.outvars, results, strict=True))
    return [value(each) for each in jaxpr.outvars]
