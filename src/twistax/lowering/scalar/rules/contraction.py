"""Sums, products and other reductions."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..graph import Graph, Nodes
from ..operations import LARGEST, SMALLEST, Operation, by_primitive
from .rule import Rule, nodes

__all__ = ["CONTRACTION"]


def _dot_general(g: Graph, eqn: Any, a: Nodes, b: Nodes) -> list[Nodes] | None:
    """Batch, free and contracted axes as in `jax.lax.dot_general`; the terms are added from the first to the last."""
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


def _gathered(a: Nodes, axes: tuple[int, ...]) -> tuple[list[list[int]], tuple[int, ...]]:
    """The entries over the axes, one list for each of the rest, and the shape of the rest."""
    kept = [i for i in range(a.ndim) if i not in axes]
    shape = tuple(a.shape[i] for i in kept)
    count = math.prod(a.shape[i] for i in axes)
    return a.transpose([*kept, *axes]).reshape(math.prod(shape), count).tolist(), shape


def _folded(
    function: Callable[[Graph, int, int], int], empty: float | None = None, many: Operation | None = None
) -> Rule:
    """A reduction by a function of two nodes.

    Args:
        empty: that of no entries.
        many: that of three floating-point numbers and more, where its derivative is another one.
    """

    def rule(g: Graph, eqn: Any, a: Nodes) -> list[Nodes] | None:
        lists, shape = _gathered(a, tuple(map(int, eqn.params["axes"])))
        if not all(lists):
            if empty is None:
                return None
            return [np.full(shape, g.constant(empty, np.dtype(eqn.outvars[0].aval.dtype)), np.int64)]
        real = jnp.issubdtype(eqn.outvars[0].aval.dtype, jnp.floating)
        if many is not None and real and max(map(len, lists), default=0) > 2:
            return [nodes([g.node(many, *entries) for entries in lists], shape)]
        return [nodes([functools.reduce(functools.partial(function, g), entries) for entries in lists], shape)]

    return rule


def _cumulative(function: Callable[[Graph, int, int], int]) -> Rule:
    def rule(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
        axis, reverse = eqn.params["axis"], eqn.params["reverse"]
        ordered = np.moveaxis(a, axis, -1)
        ordered = ordered[..., ::-1] if reverse else ordered
        found = ordered.copy()
        for index in np.ndindex(*found.shape[:-1]):
            for k in range(1, found.shape[-1]):
                found[(*index, k)] = function(g, int(found[(*index, k - 1)]), int(found[(*index, k)]))
        return [np.moveaxis(found[..., ::-1] if reverse else found, -1, axis)]

    return rule


def _extreme(name: str) -> Rule:
    """argmax, argmin: the first of equals."""

    def rule(g: Graph, eqn: Any, a: Nodes) -> list[Nodes] | None:
        dtype, further = np.dtype(eqn.params["index_dtype"]), by_primitive[name]
        lists, shape = _gathered(a, tuple(map(int, eqn.params["axes"])))
        if len(eqn.params["axes"]) != 1:
            return None
        flat = []
        for entries in lists:
            best, place = entries[0], g.constant(0, dtype)
            for k, entry in enumerate(entries[1:], start=1):
                better = g.node(further, entry, best)
                best, place = g.select(better, entry, best), g.select(better, g.constant(k, dtype), place)
            flat.append(place)
        return [nodes(flat, shape)]

    return rule


def _of(name: str) -> Callable[[Graph, int, int], int]:
    operation = by_primitive[name]
    return lambda g, a, b: g.node(operation, a, b)


def _add(g: Graph, a: int, b: int) -> int:
    return g.add(a, b)


def _mul(g: Graph, a: int, b: int) -> int:
    return g.mul(a, b)


CONTRACTION: dict[str, Rule] = {
    "dot_general": _dot_general,
    "reduce_sum": _folded(_add, 0.0),
    "reduce_prod": _folded(_mul),
    "reduce_max": _folded(_of("max"), many=LARGEST),
    "reduce_min": _folded(_of("min"), many=SMALLEST),
    **{f"reduce_{name}": _folded(_of(name)) for name in ("and", "or", "xor")},
    "cumsum": _cumulative(_add),
    "cumprod": _cumulative(_mul),
    "cummax": _cumulative(_of("max")),
    "cummin": _cumulative(_of("min")),
    "argmax": _extreme("gt"),
    "argmin": _extreme("lt"),
}
