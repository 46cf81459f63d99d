"""Products of matrices that are calls: emitters write them as loops over columns."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import jax

from ...jax_inside import ClosedJaxpr
from .interface import PRODUCT, Graph, nodes

#: A loop over fewer columns gains nothing.
_FEWEST = 4


def columns_in_calls(g: Graph, A: Sequence[Sequence[int]], B: Sequence[Sequence[int]]) -> dict[tuple[int, int], int]:
    """The entries of A B^T that are results of calls, by row and column.

    Columns with zeros in the same places are one call, if it has as many multiplications as the limits of the graph
    say. Their zeros cost nothing.

    Args:
        A, B: nodes, row by row.
    """
    entries: dict[tuple[int, int], int] = {}
    if g.limits.products == math.inf or len(A) * sum(map(len, B)) < g.limits.products:
        return entries
    groups: dict[tuple[int, ...], list[int]] = {}
    for j, column in enumerate(B):
        groups.setdefault(tuple(k for k, b in enumerate(column) if b != g.zero), []).append(j)
    for inner, columns in groups.items():
        rows = [i for i, row in enumerate(A) if any(row[k] != g.zero for k in inner)]
        left, right = [A[i][k] for i in rows for k in inner], [B[j][k] for k in inner for j in columns]
        work = len(columns) * sum(a != g.zero for a in left)
        constant = any(all(g.numbers[i] is not None for i in factor) for factor in (left, right))
        if len(columns) < _FEWEST or work < g.limits.products or constant:
            continue
        g.inside += 2 * work
        shapes = (len(rows), len(inner)), (len(inner), len(columns))
        arguments = [nodes(factor, shape) for factor, shape in zip((left, right), shapes, strict=True)]
        (result,) = g.call(_product(*shapes, g.dtype), PRODUCT, arguments, True).results
        places = [(i, j) for i in rows for j in columns]
        entries.update(zip(places, result.reshape(-1).tolist(), strict=True))
    return entries


@functools.lru_cache(256)
def _product(left: tuple[int, ...], right: tuple[int, ...], dtype: Any) -> ClosedJaxpr:
    return jax.make_jaxpr(jax.lax.dot)(jax.ShapeDtypeStruct(left, dtype), jax.ShapeDtypeStruct(right, dtype))
