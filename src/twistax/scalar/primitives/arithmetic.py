"""Arithmetic of arrays: powers, choices, conversions, products, reductions, and factorisations of small matrices."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from .entry import ALWAYS, NEVER, SMALL, Entry, Operation, convert, default, in_numpy, up_to
from .interface import Graph, Nodes, Reader, each, gathered, nodes
from .matrix_products import columns_in_calls
from .operations import LARGEST, OPERATIONS, SMALLEST, inverse_root, on
from .powers import power

# ---- entry by entry --------------------------------------------------------------------------------------------------


def _integer_pow(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    g = reader.graph
    if g.dtype_of(a) != g.dtype:
        return None
    return [each(lambda x: power(g, x, eqn.params["y"]), a)]


def _select_n(reader: Reader, eqn: Any, which: Nodes, *cases: Nodes) -> list[Nodes]:
    """Case by case; a truth value chooses the second case where it holds."""
    g = reader.graph

    def choose(c: int, *options: int) -> int:
        if g.dtypes[c].kind == "b":
            return g.select(c, options[1], options[0])
        chosen = options[-1]
        for k in range(len(options) - 2, -1, -1):
            chosen = g.select(on(g, "eq", c, g.constant(k, g.dtypes[c])), options[k], chosen)
        return chosen

    return [each(choose, which, *cases)]


def _ordered(name: str) -> Any:
    """le_to, lt_to: the order of all numbers, NaN behind them and equal to itself."""

    def compare(g: Graph, a: int, b: int) -> int:
        is_greater = on(g, "ne", b, b)
        if name == "lt":
            is_greater = OPERATIONS["and"].on(g)(is_greater, on(g, "eq", a, a))
        return OPERATIONS["or"].on(g)(on(g, name, a, b), is_greater)

    return lambda reader, eqn, *arrays: [each(functools.partial(compare, reader.graph), *arrays)]


def _converted(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    g, target = reader.graph, np.dtype(eqn.params["new_dtype"])
    return [each(lambda x: x if g.dtypes[x] == target else g.node(convert(target), x), a)]


def _reduced(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    """The operand itself, if the precision is that of its type."""
    precision, p = jnp.finfo(eqn.invars[0].aval.dtype), eqn.params
    return [a] if (p["exponent_bits"], p["mantissa_bits"]) == (precision.nexp, precision.nmant) else None


def _square(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [each(lambda x: reader.graph.mul(x, x), a)]


def _same(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return list(arrays)


ELEMENTWISE = [
    Entry(
        "rsqrt",
        lambda reader, eqn, a: [each(functools.partial(inverse_root, reader.graph), a)],
        "|accuracy",
        when=default("accuracy"),
        inside=SMALL,
    ),
    Entry("add_any", lambda reader, eqn, a, b: [each(reader.graph.add, a, b)], inside=SMALL, numpy=in_numpy(np.add)),
    Entry("square", _square, inside=SMALL, numpy=in_numpy(np.square)),
    Entry("integer_pow", _integer_pow, "y", inside=SMALL),
    Entry("quotient", lambda reader, eqn, a, b: [each(reader.graph.div, a, b)], inside=SMALL),
    Entry("select_n", _select_n, inside=SMALL, numpy=lambda p, which, *cases: np.choose(np.asarray(which, int), cases)),
    Entry("le_to", _ordered("le"), inside=SMALL),
    Entry("lt_to", _ordered("lt"), inside=SMALL),
    Entry(
        "convert_element_type",
        _converted,
        "new_dtype weak_type sharding",
        any_type=True,
        inside=SMALL,
        moves=True,
        numpy=lambda p, a: a,  # what reads it takes the type of the equation
    ),
    Entry("reduce_precision", _reduced, "exponent_bits mantissa_bits", inside=SMALL),
    Entry("copy", _same, any_type=True, inside=SMALL, moves=True, numpy=lambda p, a: a),
    Entry("apart", _same, inside=SMALL, moves=True),
    Entry("optimization_barrier", _same, any_type=True, inside=ALWAYS, moves=True),
    Entry("round", None, "rounding_method", inside=SMALL),
]


# ---- products --------------------------------------------------------------------------------------------------------

#: Matrices to factorise, or to solve with, that are larger call the library.
_LARGEST = 12


def _dot_general(reader: Reader, eqn: Any, a: Nodes, b: Nodes) -> list[Nodes] | None:
    """Batch, free and contracted axes as in `jax.lax.dot_general`; the terms are added from the first to the last."""
    g = reader.graph
    if len({v.aval.dtype for v in (*eqn.invars, *eqn.outvars)}) > 1:
        return None
    (left, right), (left_batch, right_batch) = eqn.params["dimension_numbers"]
    left_free = [i for i in range(a.ndim) if i not in (*left, *left_batch)]
    right_free = [i for i in range(b.ndim) if i not in (*right, *right_batch)]
    batch = [a.shape[i] for i in left_batch]
    rows, columns = [a.shape[i] for i in left_free], [b.shape[i] for i in right_free]
    inner = math.prod(a.shape[i] for i in left)
    A = a.transpose([*left_batch, *left_free, *left]).reshape(math.prod(batch), math.prod(rows), inner).tolist()
    B = b.transpose([*right_batch, *right_free, *right]).reshape(math.prod(batch), math.prod(columns), inner).tolist()
    entries = list[int]()
    for above, below in zip(A, B, strict=True):
        called = columns_in_calls(g, above, below)
        for i, row in enumerate(above):
            for j, column in enumerate(below):
                known = called.get((i, j))
                entries.append(functools.reduce(g.add, map(g.mul, row, column), g.zero) if known is None else known)
    return [nodes(entries, (*batch, *rows, *columns))]


def _full_precision(p: Mapping[str, Any]) -> bool:
    """Whether products have full precision; other algorithms round the factors."""
    precision = p["precision"]
    both = precision if isinstance(precision, tuple) else (precision,)
    return all(one is None or isinstance(one, lax.Precision) for one in both)


def _product_work(eqn: Any) -> Mapping[str, int]:
    (contracted, _), _ = eqn.params["dimension_numbers"]
    depth, out = math.prod(eqn.invars[0].aval.shape[i] for i in contracted), eqn.outvars[0].aval.size
    return {"mul": depth * out, "add": (depth - 1) * out}


# ---- reductions ------------------------------------------------------------------------------------------------------


def _reduction_work(name: str) -> Any:
    def work(eqn: Any) -> Mapping[str, int]:
        return {name: sum(v.aval.size for v in eqn.invars) - sum(v.aval.size for v in eqn.outvars)}

    return work


def _reduction(
    name: str, pair: str, takes: str = "axes", *, empty: float | None = None, many: Operation | None = None, **more: Any
) -> Entry:
    """A reduction by an operation on two nodes.

    Args:
        empty: that of no entries.
        many: that of three floating-point numbers and more, where its derivative is another one.
    """

    def read(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
        g, result = reader.graph, eqn.outvars[0].aval
        lists, shape = gathered(a, tuple(map(int, eqn.params["axes"])))
        if not all(lists):
            return None if empty is None else [np.full(shape, g.constant(empty, np.dtype(result.dtype)), np.int64)]
        if many is not None and jnp.issubdtype(result.dtype, jnp.floating) and max(map(len, lists), default=0) > 2:
            return [nodes([g.node(many, *terms) for terms in lists], shape)]
        return [nodes([functools.reduce(OPERATIONS[pair].on(g), terms) for terms in lists], shape)]

    return Entry(name, read, takes, work=_reduction_work(pair), **{"inside": SMALL, **more})


def _cumulative(name: str, pair: str) -> Entry:
    def read(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
        axis, backwards = eqn.params["axis"], -1 if eqn.params["reverse"] else 1
        totals = np.moveaxis(a, axis, -1)[..., ::backwards].copy()
        for index in np.ndindex(*totals.shape[:-1]):
            totals[index] = list(itertools.accumulate(totals[index].tolist(), OPERATIONS[pair].on(reader.graph)))
        return [np.moveaxis(totals[..., ::backwards], -1, axis)]

    return Entry(name, read, "axis reverse", inside=SMALL, work=lambda eqn: {pair: eqn.outvars[0].aval.size})


def _place_of(name: str, further: str) -> Entry:
    """The place of an extreme: the first of equals, and of NaN where there is one."""

    def read(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
        g, dtype = reader.graph, np.dtype(eqn.params["index_dtype"])
        real = jnp.issubdtype(eqn.invars[0].aval.dtype, jnp.inexact)
        lists, shape = gathered(a, tuple(map(int, eqn.params["axes"])))
        places = []
        for first, *rest in lists:
            best, place = first, g.constant(0, dtype)
            for k, entry in enumerate(rest, start=1):
                better = on(g, further, entry, best)
                if real:
                    first_nan = OPERATIONS["and"].on(g)(on(g, "ne", entry, entry), on(g, "eq", best, best))
                    better = OPERATIONS["or"].on(g)(better, first_nan)
                best, place = g.select(better, entry, best), g.select(better, g.constant(k, dtype), place)
            places.append(place)
        return [nodes(places, shape)]

    one_axis = lambda p: len(p["axes"]) == 1  # noqa: E731
    return Entry(name, read, "axes index_dtype", when=one_axis, inside=SMALL, work=_reduction_work(name))


_EXTREME = "axes | axes out_sharding"  # JAX 0.10; 0.11 and later

CONTRACTION = [
    Entry(
        "dot_general",
        _dot_general,
        "dimension_numbers precision preferred_element_type out_sharding",
        when=_full_precision,
        inside=up_to(64),  # larger ones call a library
        work=_product_work,
        numpy=lambda p, a, b: np.tensordot(a, b, p["dimension_numbers"][0]),
    ),
    _reduction("reduce_sum", "add", "axes out_sharding", empty=0.0, numpy=lambda p, a: np.sum(a, tuple(p["axes"]))),
    _reduction("reduce_prod", "mul"),
    _reduction("reduce_max", "max", _EXTREME, many=LARGEST),
    _reduction("reduce_min", "min", _EXTREME, many=SMALLEST),
    _reduction("reduce_and", "and"),
    _reduction("reduce_or", "or"),
    _reduction("reduce_xor", "xor", inside=NEVER),
    _cumulative("cumsum", "add"),
    _cumulative("cumprod", "mul"),
    _cumulative("cummax", "max"),
    _cumulative("cummin", "min"),
    _place_of("argmax", "gt"),
    _place_of("argmin", "lt"),
]


# ---- linear algebra --------------------------------------------------------------------------------------------------


def _cholesky(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    """The lower factor of each matrix, of its lower triangle."""
    g, n = reader.graph, a.shape[-1]
    if n > _LARGEST:
        return None
    factors = np.full(a.shape, g.zero)
    for index in np.ndindex(*a.shape[:-2]):
        A, L = a[index], factors[index]
        for j in range(n):
            for i in range(j, n):
                rest = int(A[i, j])
                for k in range(j):
                    rest = g.sub(rest, g.mul(int(L[i, k]), int(L[j, k])))
                L[i, j] = on(g, "sqrt", rest) if i == j else g.div(rest, int(L[j, j]))
    return [factors]


def _lu(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    """LU with partial pivoting: [L and U in one, the rows swapped with, the permutation].

    The first of the largest entries on or below the diagonal becomes the pivot; entries that are structurally zero are
    never compared.
    """
    if a.shape[-2] != a.shape[-1] or a.shape[-1] > reader.graph.limits.pivoted:
        return None
    index, batch = np.dtype(eqn.outvars[1].aval.dtype), a.shape[:-2]
    every = [_lu_of(reader.graph, a[at], index) for at in np.ndindex(*batch)]
    return [np.array(parts, int).reshape(*batch, *parts[0].shape) for parts in zip(*every, strict=True)]


def _lu_of(g: Graph, a: Nodes, index: np.dtype[Any]) -> tuple[Nodes, Nodes, Nodes]:
    n, A = a.shape[0], a.copy()
    rows = [g.constant(i, index) for i in range(n)]
    pivots, order = list(rows), list(rows)
    for k in range(n):
        candidates = [i for i in range(k + 1, n) if A[i, k] != g.zero]
        best = on(g, "abs", int(A[k, k]))
        for i in candidates:
            size = on(g, "abs", int(A[i, k]))
            better = on(g, "gt", size, best)
            best, pivots[k] = g.select(better, size, best), g.select(better, rows[i], pivots[k])
        for i in candidates:
            swap = on(g, "eq", pivots[k], rows[i])
            for j in range(n):
                low, high = int(A[i, j]), int(A[k, j])
                A[k, j], A[i, j] = g.select(swap, low, high), g.select(swap, high, low)
            order[k], order[i] = g.select(swap, order[i], order[k]), g.select(swap, order[k], order[i])
        for i in range(k + 1, n):
            if A[i, k] == g.zero:
                continue
            A[i, k] = g.div(int(A[i, k]), int(A[k, k]))
            for j in range(k + 1, n):
                A[i, j] = g.sub(int(A[i, j]), g.mul(int(A[i, k]), int(A[k, j])))
    return A, np.array(pivots), np.array(order)


def _triangular_solve(reader: Reader, eqn: Any, a: Nodes, b: Nodes) -> list[Nodes] | None:
    if a.shape[-1] > _LARGEST:
        return None
    result = np.empty_like(b)
    for at in np.ndindex(*a.shape[:-2]):
        result[at] = _triangle_solved(reader.graph, eqn.params, a[at], b[at])
    return [result]


def _triangle_solved(g: Graph, p: Mapping[str, Any], a: Nodes, b: Nodes) -> Nodes:
    """The solution for one matrix."""
    A, B, lower, n = a, b, p["lower"], a.shape[-1]
    if not p["left_side"]:
        A, B, lower = A.T, B.T, not lower
    if p["transpose_a"]:
        A, lower = A.T, not lower
    X = B.copy()
    order = range(n) if lower else range(n - 1, -1, -1)
    for i in order:
        for column in range(X.shape[1]):
            rest = int(X[i, column])
            for j in range(i) if lower else range(i + 1, n):
                rest = g.sub(rest, g.mul(int(A[i, j]), int(X[j, column])))
            X[i, column] = rest if p["unit_diagonal"] else g.div(rest, int(A[i, i]))
    return X if p["left_side"] else X.T


def _cubic(eqn: Any) -> Mapping[str, int]:
    size = max(v.aval.size for v in eqn.invars) * max(v.aval.shape[-1] for v in eqn.invars)
    return {eqn.primitive.name: size}


LINEAR_ALGEBRA = [
    Entry("cholesky", _cholesky, work=_cubic),
    Entry("lu", _lu, work=_cubic),
    # Matrices that are conjugated are complex, which are not read.
    Entry("triangular_solve", _triangular_solve, "left_side lower transpose_a conjugate_a unit_diagonal", work=_cubic),
]
