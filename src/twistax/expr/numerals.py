"""Functions of arrays that are evaluated many times: on numbers by NumPy, because XLA would compile a program for each
operation; and on arrays that JAX traces.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import ClosedJaxpr, Literal, Unread, inner_jaxprs, is_traced, jaxpr_as_fun
from ..scalar.primitives.table import TABLE

#: What JAX traced of functions, by their kinds and the shapes of their arguments; None: NumPy computes something else.
Formulas: TypeAlias = "dict[Hashable, ClosedJaxpr | None]"


def numerals(
    function: Callable[..., Any], values: Sequence[np.ndarray], kind: Hashable | None, formulas: Formulas
) -> np.ndarray:
    """The single result of a function of arrays that JAX can trace.

    Args:
        kind: equal for functions that compute the same; None for a function that accepts NumPy arrays directly.
        formulas: cached traces by kind, to which this one is added.
    """
    with np.errstate(all="ignore"):  # what is not finite is the caller's to judge
        if kind is None:
            return np.asarray(function(*values))
        place = (kind, *((value.shape, value.dtype) for value in values))
        if place not in formulas:
            traced = jax.make_jaxpr(function)(*values)
            formulas[place] = traced if _in_numpy(traced.jaxpr) else None
        closed = formulas[place]
        if closed is not None:
            return _computed(closed, values)[0]
    return np.asarray(function(*map(jnp.asarray, values)))


def _in_numpy(jaxpr: Any) -> bool:
    return all(_in_numpy(inner.jaxpr) if (inner := _inner(eqn)) else _form(eqn) is not None for eqn in jaxpr.eqns)


def _inner(eqn: Any) -> ClosedJaxpr | None:
    """The called function, if an equation only calls one."""
    inner = inner_jaxprs(eqn) if eqn.primitive.name == "jit" else []
    return inner[0] if len(inner) == 1 else None


def _form(eqn: Any) -> Callable[..., Any] | None:
    """What NumPy computes for an equation, by the table of primitives; None where that would be something else."""
    entry = TABLE.get(eqn.primitive.name)
    if entry is None or entry.numpy is None or _differs(entry.name, eqn):
        return None
    try:
        return entry.numpy if entry.understands(eqn) else None
    except Unread:  # of a later JAX, which knows what it means
        return None


def _differs(name: str, eqn: Any) -> bool:
    """Whether NumPy's result differs from JAX's."""
    types, result = [v.aval.dtype for v in eqn.invars], eqn.outvars[0].aval.dtype
    if name == "dot_general" and eqn.params["dimension_numbers"][1][0]:
        return True
    if name in ("dot_general", "mul"):
        return {*types} != {result}
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
            form = _form(eqn)
            assert form is not None
            output = form(eqn.params, *inputs)
            results = output if eqn.primitive.multiple_results else [output]
        known.update(zip(eqn.outvars, results, strict=True))
    return list(map(value, jaxpr.outvars))


# ---- formulas on arrays that JAX traces -----------------------------------------------------------------------------

#: A formula is traced alone where it is met for this time.
_OFTEN = 3

#: What decides, besides its operands, what JAX traces of a formula.
_CONFIGURATION = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
)


class RepeatedFormulas:
    """The formulas of nodes: their counts, or JAX's traces of them.

    A function of `jax.numpy` checks and promotes its arguments at each call, which takes several times as long as its
    operations. A robot of thirty links has ten thousand nodes, of some hundred kinds.

    Args:
        most: kinds that are kept.
    """

    def __init__(self, most: int = 4096) -> None:
        self._most = most
        self._met: dict[Hashable, int] = {}
        self._traced: dict[Hashable, Callable[..., list[Any]]] = {}

    def value(self, node: Any, operands: Sequence[Any]) -> Any:
        """The value of a node without branches, from those of its operands."""
        if not node.by_values or not is_traced(operands):
            return node.evaluate_on_demand(operands, [])
        configuration = tuple(getattr(jax.config, name) for name in _CONFIGURATION)
        kind = (type(node), node.static_key(), configuration, *map(jax.typeof, operands))
        formula = self._traced.get(kind)
        if formula is None:
            times = self._met[kind] = self._met.get(kind, 0) + 1
            if times < _OFTEN:
                return node.evaluate_on_demand(operands, [])
            traced = jax.make_jaxpr(lambda *values: node.evaluate_on_demand(list(values), []))
            formula = self._traced[kind] = jaxpr_as_fun(traced(*operands))
            for known in (self._met, self._traced):
                while len(known) > self._most:
                    known.pop(next(iter(known)), None)
        return formula(*operands)[0]


#: Those of all evaluations in this process.
FORMULAS = RepeatedFormulas()
