"""Functions of matrices evaluated by NumPy, one equation at a time: the reference for their kernels.

XLA takes seconds to compile a function with loops and branches. The few members of a self-test take milliseconds here.
"""

from __future__ import annotations

import functools
import string
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .....jax_inside import ClosedJaxpr, Literal, closed, scan_parts
from ....parts.inlining import inlined
from ....primitives.entry import convert
from ....primitives.table import OPERATIONS, entry_of
from ..kernel_body import Rounded

#: Equations after which XLA would have been faster, some .3 s.
_MOST = 100_000

#: From the operands of an equation to its results.
Rule: TypeAlias = Callable[..., Sequence[Any]]


class NoReference(Exception):
    """Raised for an equation without a form in NumPy, and for more equations than are worth it."""


class _Evaluation:
    """What a function and its loops and branches share: the number of equations so far, and how results are rounded."""

    def __init__(self) -> None:
        self.equations = 0
        self.rounded: Rounded = np.asarray
        self.lock = threading.Lock()  #: of kernels that are checked side by side


class NumpyReference:
    """A function of arrays by NumPy, for one member.

    Args:
        evaluation: of the function of which it is a part.

    Raises:
        NoReference: it has an equation without a form in NumPy.
    """

    def __init__(self, program: ClosedJaxpr, evaluation: _Evaluation | None = None) -> None:
        program = inlined(program)
        jaxpr = self._jaxpr = program.jaxpr
        self._evaluation = evaluation or _Evaluation()
        self._known = dict(zip(jaxpr.constvars, map(np.asarray, program.consts), strict=True))
        self._steps: list[tuple[Rule, list[Any], list[tuple[Any, np.dtype[Any]]]]] = []
        for eqn in jaxpr.eqns:
            rule = _rule(eqn, self._evaluation)
            types = [np.dtype(_aval(v).dtype) for v in eqn.outvars]
            self._steps.append((rule, list(map(self._operand, eqn.invars)), list(zip(eqn.outvars, types, strict=True))))

    def __call__(self, *arrays: Any) -> list[NDArray[Any]]:
        evaluation = self._evaluation
        evaluation.equations += len(self._steps)
        if evaluation.equations > _MOST:
            raise NoReference("too many equations")
        known: dict[Any, Any] = {**self._known, **dict(zip(self._jaxpr.invars, arrays, strict=True))}
        for rule, operands, results in self._steps:
            values = rule(*(known[v] if number is None else number for v, number in operands))
            for (v, dtype), value in zip(results, values, strict=True):
                known[v] = evaluation.rounded(np.asarray(value, dtype))
        return [known[v] if number is None else number for v, number in map(self._operand, self._jaxpr.outvars)]

    @staticmethod
    def _operand(v: Any) -> tuple[Any, Any]:
        return (None, np.asarray(v.val, _aval(v).dtype)) if isinstance(v, Literal) else (v, None)

    def of_rows(self, rows: Sequence[NDArray[Any]], rounded: Rounded) -> list[NDArray[Any]]:
        """All results for rows of arguments; `rounded` is applied to the results of each equation.

        Raises:
            NoReference: it takes too many equations.
        """
        with self._evaluation.lock, np.errstate(all="ignore"):
            self._evaluation.equations, self._evaluation.rounded = 0, rounded
            every = [self(*arrays) for arrays in zip(*rows, strict=True)]
        return [np.stack(results) for results in zip(*every, strict=True)]


def _aval(v: Any) -> Any:
    return v.aval


def _rule(eqn: Any, evaluation: _Evaluation) -> Rule:
    """How an equation is evaluated."""
    name, entry = eqn.primitive.name, entry_of(eqn)
    if name in _CONTROL:
        return _CONTROL[name](eqn, evaluation)
    if name in _RULES:
        return functools.partial(_RULES[name], eqn.params)
    if name in OPERATIONS and OPERATIONS[name] is entry:
        number = OPERATIONS[name].number
        return lambda *a: [number(*a)]
    if entry is None or entry.numpy is None:
        raise NoReference(name)
    function, params, several = entry.numpy, eqn.params, eqn.primitive.multiple_results
    return lambda *a: function(params, *a) if several else [function(params, *a)]


# ---- loops and branches ----------------------------------------------------------------------------------------------


def _while(eqn: Any, evaluation: _Evaluation) -> Rule:
    p = eqn.params
    condition, body = (NumpyReference(closed(p[name]), evaluation) for name in ("cond_jaxpr", "body_jaxpr"))
    asking, fixed = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]

    def run(*values: Any) -> list[Any]:
        state = list(values[fixed:])
        while condition(*values[:asking], *state)[0]:
            state = body(*values[asking:fixed], *state)
        return state

    return run


def _scan(eqn: Any, evaluation: _Evaluation) -> Rule:
    p, (fixed, carried) = eqn.params, scan_parts(eqn)
    body = NumpyReference(closed(p["jaxpr"]), evaluation)
    places = range(p["length"])[::-1] if p["reverse"] else range(p["length"])

    def run(*values: Any) -> list[Any]:
        constants, state, rows = values[:fixed], list(values[fixed : fixed + carried]), values[fixed + carried :]
        stacked = [np.zeros(_aval(v).shape, _aval(v).dtype) for v in eqn.outvars[carried:]]
        for k in places:
            results = body(*constants, *state, *(row[k] for row in rows))
            state = results[:carried]
            for target, value in zip(stacked, results[carried:], strict=True):
                target[k] = value
        return [*state, *stacked]

    return run


def _cond(eqn: Any, evaluation: _Evaluation) -> Rule:
    branches = [NumpyReference(closed(branch), evaluation) for branch in eqn.params["branches"]]
    last = len(branches) - 1
    return lambda index, *values: branches[int(np.clip(index, 0, last))](*values)


_CONTROL: Mapping[str, Callable[[Any, _Evaluation], Rule]] = {"while": _while, "scan": _scan, "cond": _cond}


# ---- other equations -------------------------------------------------------------------------------------------------


def _reduction(ufunc: Any) -> Rule:
    return lambda p, a: [ufunc.reduce(a, tuple(map(int, p["axes"])))]


def _dot(p: Any, a: Any, b: Any) -> list[Any]:
    (left, right), (left_batch, right_batch) = p["dimension_numbers"]
    letters = iter(string.ascii_letters)
    first, second = [next(letters) for _ in a.shape], [next(letters) for _ in b.shape]
    for i, j in zip((*left, *left_batch), (*right, *right_batch), strict=True):
        second[j] = first[i]
    rows = [x for k, x in enumerate(first) if k not in (*left, *left_batch)]
    columns = [x for k, x in enumerate(second) if k not in (*right, *right_batch)]
    result = [*(first[k] for k in left_batch), *rows, *columns]
    return [np.einsum(f"{''.join(first)},{''.join(second)}->{''.join(result)}", a, b)]


def _iota(p: Any) -> list[Any]:
    shape, axis = p["shape"], p["dimension"]
    numbers = np.arange(shape[axis], dtype=p["dtype"])
    return [np.broadcast_to(numbers.reshape([-1 if k == axis else 1 for k in range(len(shape))]), shape)]


def _window(a: Any, sizes: Sequence[int], places: Sequence[Any]) -> tuple[slice, ...]:
    """A part of an array, moved inside."""
    starts = [int(np.clip(place, 0, n - m)) for place, n, m in zip(places, a.shape, sizes, strict=True)]
    return tuple(slice(start, start + m) for start, m in zip(starts, sizes, strict=True))


def _updated(p: Any, a: Any, update: Any, *places: Any) -> list[Any]:
    result = np.array(a)
    result[_window(a, update.shape, places)] = update
    return [result]


def _cholesky(p: Any, a: Any) -> list[Any]:
    factors = np.full(a.shape, np.nan, a.dtype)
    for at in np.ndindex(*a.shape[:-2]):
        try:
            factors[at] = np.linalg.cholesky(a[at])
        except np.linalg.LinAlgError:  # it is not positive definite, and JAX gives NaN
            continue
    return [factors]


def _triangular_solve(p: Any, a: Any, b: Any) -> list[Any]:
    if p["unit_diagonal"] or p["conjugate_a"]:
        raise NoReference("triangular_solve")
    triangle = np.tril(a) if p["lower"] else np.triu(a)
    triangle = np.swapaxes(triangle, -1, -2) if p["transpose_a"] else triangle
    if p["left_side"]:
        return [np.linalg.solve(triangle, b)]
    return [np.swapaxes(np.linalg.solve(np.swapaxes(triangle, -1, -2), np.swapaxes(b, -1, -2)), -1, -2)]


_RULES: Mapping[str, Rule] = {
    "reduce_sum": _reduction(np.add),
    "reduce_prod": _reduction(np.multiply),
    "reduce_max": _reduction(np.maximum),
    "reduce_min": _reduction(np.minimum),
    "reduce_and": _reduction(np.bitwise_and),
    "reduce_or": _reduction(np.bitwise_or),
    "dot_general": _dot,
    "integer_pow": lambda p, a: [a ** p["y"]],
    "rsqrt": lambda p, a: [1.0 / np.sqrt(a)],
    "convert_element_type": lambda p, a: [convert(np.dtype(p["new_dtype"])).number(a)],
    "iota": _iota,
    "dynamic_slice": lambda p, a, *places: [a[_window(a, p["slice_sizes"], places)]],
    "dynamic_update_slice": _updated,
    "cholesky": _cholesky,
    "triangular_solve": _triangular_solve,
    **dict.fromkeys(("copy", "optimization_barrier", "stop_gradient"), lambda p, *arrays: arrays),
}
