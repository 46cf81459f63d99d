"""A function of arrays computed on NumPy's numbers: XLA would compile a program for each operation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import ClosedJaxpr, Literal, inner_jaxprs

#: What constants are folded with most, with the parameters each reads; JAX itself does whatever is not here.
_IN_NUMPY: dict[str, tuple[Callable[..., Any], set[str]]] = {
    "add": (np.add, set()),
    "add_any": (np.add, set()),
    "sub": (np.subtract, set()),
    "mul": (lambda a, b, out_dtype: a * b, {"out_dtype"}),
    "neg": (np.negative, set()),
    "abs": (np.abs, set()),
    "max": (np.maximum, set()),
    "min": (np.minimum, set()),
    "eq": (np.equal, set()),
    "ne": (np.not_equal, set()),
    "lt": (np.less, set()),
    "le": (np.less_equal, set()),
    "gt": (np.greater, set()),
    "ge": (np.greater_equal, set()),
    "and": (np.bitwise_and, set()),
    "or": (np.bitwise_or, set()),
    "not": (np.invert, set()),
    "select_n": (lambda which, *cases: np.choose(np.asarray(which, int), cases), set()),
    "convert_element_type": (lambda a, new_dtype: a, {"new_dtype"}),  # a result takes the type of its equation
    "square": (np.square, set()),
    "sqrt": (np.sqrt, set()),
    "reduce_sum": (lambda a, axes: np.sum(a, axis=tuple(axes)), {"axes"}),
    "slice": (
        lambda a, start_indices, limit_indices, strides: a[
            tuple(map(slice, start_indices, limit_indices, strides or [1] * a.ndim))
        ],
        {"start_indices", "limit_indices", "strides"},
    ),
    "squeeze": (lambda a, dimensions: np.squeeze(a, tuple(dimensions)), {"dimensions"}),
    "reshape": (lambda a, new_sizes, dimensions: np.reshape(a, new_sizes), {"new_sizes", "dimensions"}),
    "transpose": (lambda a, permutation: np.transpose(a, permutation), {"permutation"}),
    "concatenate": (lambda *parts, dimension: np.concatenate(parts, dimension), {"dimension"}),
    "stack": (lambda *parts, axis: np.stack(parts, axis), {"axis"}),
    "broadcast_in_dim": (
        lambda a, shape, broadcast_dimensions: np.broadcast_to(
            np.expand_dims(a, [k for k in range(len(shape)) if k not in broadcast_dimensions]), shape
        ),
        {"shape", "broadcast_dimensions"},
    ),
    "unstack": (lambda a, axis: list(np.moveaxis(a, axis, 0)), {"axis"}),
    "dot_general": (lambda a, b, dimension_numbers: np.tensordot(a, b, dimension_numbers[0]), {"dimension_numbers"}),
    "copy": (lambda a: a, set()),
}

#: Parameters that change no value; in any other that a later JAX may add, JAX is believed.
_WITHOUT_EFFECT = {"accuracy", "out_sharding", "precision", "preferred_element_type", "sharding", "weak_type"}


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
            return _computed(closed, values)[0]
    return np.asarray(function(*map(jnp.asarray, values)))


def _in_numpy(jaxpr: Any) -> bool:
    return all(_in_numpy(inner.jaxpr) if (inner := _inner(eqn)) else _is_listed(eqn) for eqn in jaxpr.eqns)


def _inner(eqn: Any) -> ClosedJaxpr | None:
    """The one function that an equation calls, if all it does is to call it."""
    inner = inner_jaxprs(eqn) if eqn.primitive.name == "jit" else []
    return inner[0] if len(inner) == 1 else None


def _is_listed(eqn: Any) -> bool:
    name = eqn.primitive.name
    return name in _IN_NUMPY and _IN_NUMPY[name][1] == {*eqn.params} - _WITHOUT_EFFECT and not _differs(name, eqn)


def _differs(name: str, eqn: Any) -> bool:
    """Whether NumPy would do something else."""
    types, result = [v.aval.dtype for v in eqn.invars], eqn.outvars[0].aval.dtype
    if name == "dot_general" and eqn.params["dimension_numbers"][1][0]:
        return True
    if name in ("dot_general", "mul"):
        return {*types} != {result}
    if name == "reshape":
        return eqn.params["dimensions"] is not None
    if name == "select_n":
        return types[0] != np.dtype(bool)
    # NaN, and what is out of range.
    return (
        name == "convert_element_type" and jnp.issubdtype(types[0], jnp.inexact) and jnp.issubdtype(result, jnp.integer)
    )


def _computed(closed: ClosedJaxpr, values: Sequence[Any]) -> list[np.ndarray]:
    jaxpr = closed.jaxpr
    known = dict(zip(jaxpr.constvars, closed.consts, strict=True))
    known.update(zip(jaxpr.invars, values, strict=True))

    def value(variable: Any) -> np.ndarray:
        return np.asarray(variable.val if isinstance(variable, Literal) else known[variable], variable.aval.dtype)

    for eqn in jaxpr.eqns:
        inputs = list(map(value, eqn.invars))
        if inner := _inner(eqn):
            results = _computed(inner, inputs)
        else:
            function, names = _IN_NUMPY[eqn.primitive.name]
            output = function(*inputs, **{name: eqn.params[name] for name in names})
            results = output if eqn.primitive.multiple_results else [output]
        known.update(zip(eqn.outvars, results, strict=True))
    return list(map(value, jaxpr.outvars))
