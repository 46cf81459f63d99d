"""Sums, products and other reductions."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..entry import ANY, Entry, Nodes, entries, gathered, largest, never_inside, nodes, small_inside, takes
from ..operation import Operation
from .arithmetic import ARITHMETIC, LARGEST, SMALLEST
from .logic import LOGIC

if TYPE_CHECKING:
    from ..reader import Reader

__all__ = ["CONTRACTION"]

#: Products of matrices beyond this many entries call a library.
_LARGEST_PRODUCT = 64

_M, _TRUTH = np.arange(6.0).reshape(2, 3), np.array([[True, False], [True, True]])


# ---- products --------------------------------------------------------------------------------------------------------


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
    flat = [
        g.sum(map(g.mul, row, column)) for above, below in zip(A, B, strict=True) for row in above for column in below
    ]
    return [nodes(flat, (*batch, *rows, *columns))]


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
    name: str,
    pair: Operation,
    example: Any,
    known: Any = None,
    *,
    empty: float | None = None,
    many: Operation | None = None,
    inside: Any = small_inside,
) -> Entry:
    """A reduction by an operation on two nodes.

    Args:
        empty: that of no entries.
        many: that of three floating-point numbers and more, where its derivative is another one.
    """

    def read(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
        g = reader.graph
        lists, shape = gathered(a, tuple(map(int, eqn.params["axes"])))
        if not all(lists):
            if empty is None:
                return None
            return [np.full(shape, g.constant(empty, np.dtype(eqn.outvars[0].aval.dtype)), np.int64)]
        real = jnp.issubdtype(eqn.outvars[0].aval.dtype, jnp.floating)
        if many is not None and real and max(map(len, lists), default=0) > 2:
            return [nodes([g.node(many, *each) for each in lists], shape)]
        return [nodes([functools.reduce(pair.on(g), each) for each in lists], shape)]

    return Entry(
        name=name,
        takes=known or (takes(axes=ANY),),
        read=read,
        inside=inside,
        work=_reduction_work(pair.name),
        example=example,
    )


def _cumulative(name: str, pair: Operation, example: Any) -> Entry:
    def read(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
        axis, reverse = eqn.params["axis"], eqn.params["reverse"]
        ordered = np.moveaxis(a, axis, -1)
        ordered = ordered[..., ::-1] if reverse else ordered
        found = ordered.copy()
        for index in np.ndindex(*found.shape[:-1]):
            for k in range(1, found.shape[-1]):
                before, own = int(found[(*index, k - 1)]), int(found[(*index, k)])
                found[(*index, k)] = pair.on(reader.graph)(before, own)
        return [np.moveaxis(found[..., ::-1] if reverse else found, -1, axis)]

    return Entry(
        name=name,
        takes=(takes(axis=ANY, reverse=ANY),),
        read=read,
        inside=small_inside,
        work=lambda eqn: {pair.name: eqn.outvars[0].aval.size},
        example=(example, _M),
    )


def _place_of(name: str, further: Operation, example: Any) -> Entry:
    """The place of an extreme: the first of equals, and of NaN where there is one."""

    def read(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
        g, dtype = reader.graph, np.dtype(eqn.params["index_dtype"])
        real = jnp.issubdtype(eqn.invars[0].aval.dtype, jnp.inexact)
        lists, shape = gathered(a, tuple(map(int, eqn.params["axes"])))
        flat = []
        for first, *others in lists:
            best, place = first, g.constant(0, dtype)
            for k, entry in enumerate(others, start=1):
                better = g.node(further, entry, best)
                if real:
                    first_nan = LOGIC["and"].on(g)(g.node(LOGIC["ne"], entry, entry), g.node(LOGIC["eq"], best, best))
                    better = LOGIC["or"].on(g)(better, first_nan)
                best, place = g.select(better, entry, best), g.select(better, g.constant(k, dtype), place)
            flat.append(place)
        return [nodes(flat, shape)]

    return Entry(
        name=name,
        takes=(takes(axes=lambda axes: len(axes) == 1, index_dtype=ANY),),
        read=read,
        inside=small_inside,
        work=_reduction_work(name),
        example=(example, _M),
    )


_EXTREME = (takes(axes=ANY), takes(axes=ANY, out_sharding=ANY))  # JAX 0.10; 0.11 and later

CONTRACTION: dict[str, Entry] = entries(
    Entry(
        name="dot_general",
        takes=(takes(dimension_numbers=ANY, precision=ANY, preferred_element_type=ANY, out_sharding=ANY),),
        read=_dot_general,
        inside=lambda eqn: largest(eqn) <= _LARGEST_PRODUCT,
        work=_product_work,
        example=(lambda a: a @ a.T, _M),
    ),
    _reduction(
        "reduce_sum", ARITHMETIC["add"], (lambda a: a.sum(0), _M), (takes(axes=ANY, out_sharding=ANY),), empty=0.0
    ),
    _reduction("reduce_prod", ARITHMETIC["mul"], (lambda a: a.prod(0), _M)),
    _reduction("reduce_max", ARITHMETIC["max"], (lambda a: a.max(0), _M), _EXTREME, many=LARGEST),
    _reduction("reduce_min", ARITHMETIC["min"], (lambda a: a.min(0), _M), _EXTREME, many=SMALLEST),
    _reduction("reduce_and", LOGIC["and"], (lambda a: jnp.all(a, axis=0), _TRUTH)),
    _reduction("reduce_or", LOGIC["or"], (lambda a: jnp.any(a, axis=0), _TRUTH)),
    _reduction(
        "reduce_xor", LOGIC["xor"], (lambda a: lax.reduce_xor_p.bind(a, axes=(0,)), _TRUTH), inside=never_inside
    ),
    _cumulative("cumsum", ARITHMETIC["add"], lambda a: lax.cumsum(a, 1)),
    _cumulative("cumprod", ARITHMETIC["mul"], lambda a: lax.cumprod(a, 1)),
    _cumulative("cummax", ARITHMETIC["max"], lambda a: lax.cummax(a, 1)),
    _cumulative("cummin", ARITHMETIC["min"], lambda a: lax.cummin(a, 1)),
    _place_of("argmax", LOGIC["gt"], lambda a: jnp.argmax(a, 1)),
    _place_of("argmin", LOGIC["lt"], lambda a: jnp.argmin(a, 1)),
)
