"""Factorisations and solves of small matrices, unrolled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jax import lax

from ..entry import ANY, Entry, Nodes, entries, takes
from .arithmetic import ARITHMETIC
from .elementary import ELEMENTARY
from .logic import LOGIC

if TYPE_CHECKING:
    from ..reader import Reader

__all__ = ["LINEAR_ALGEBRA"]

#: Larger matrices call the library.
_LARGEST = 12

_A = np.array([[4.0, 1.0], [1.0, 3.0]])


def _cholesky(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    """The lower factor of each matrix, of its lower triangle."""
    g, n = reader.graph, a.shape[-1]
    if n > _LARGEST:
        return None
    found = np.full(a.shape, g.zero)
    for index in np.ndindex(*a.shape[:-2]):
        A, L = a[index], found[index]
        for j in range(n):
            for i in range(j, n):
                rest = int(A[i, j])
                for k in range(j):
                    rest = g.sub(rest, g.mul(int(L[i, k]), int(L[j, k])))
                L[i, j] = g.node(ELEMENTARY["sqrt"], rest) if i == j else g.div(rest, int(L[j, j]))
    return [found]


def _lu(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    """LU with partial pivoting: [L and U in one, the rows swapped with, the permutation].

    The first of the largest entries on or below the diagonal becomes the pivot; entries that are structurally zero are
    never compared.
    """
    g = reader.graph
    if a.ndim != 2 or a.shape[0] != a.shape[1] or a.shape[0] > g.limits.pivoted:
        return None
    n, A = a.shape[0], a.copy()
    index = np.dtype(eqn.outvars[1].aval.dtype)
    rows = [g.constant(i, index) for i in range(n)]
    pivots, order = list(rows), list(rows)
    magnitude, larger, equal = ARITHMETIC["abs"], LOGIC["gt"], LOGIC["eq"]
    for k in range(n):
        others = [i for i in range(k + 1, n) if A[i, k] != g.zero]
        best = g.node(magnitude, int(A[k, k]))
        for i in others:
            size = g.node(magnitude, int(A[i, k]))
            better = g.node(larger, size, best)
            best, pivots[k] = g.select(better, size, best), g.select(better, rows[i], pivots[k])
        for i in others:
            swap = g.node(equal, pivots[k], rows[i])
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
    return [A, np.array(pivots), np.array(order)]


def _triangular_solve(reader: Reader, eqn: Any, a: Nodes, b: Nodes) -> list[Nodes] | None:
    g, p, n = reader.graph, eqn.params, a.shape[-1]
    if n > _LARGEST or a.ndim != 2:
        return None
    A, B, lower = a, b, p["lower"]
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
    return [X if p["left_side"] else X.T]


def _cubic(eqn: Any) -> Mapping[str, int]:
    size = max(v.aval.size for v in eqn.invars) * max(v.aval.shape[-1] for v in eqn.invars)
    return {eqn.primitive.name: size}


LINEAR_ALGEBRA: dict[str, Entry] = entries(
    Entry(name="cholesky", read=_cholesky, work=_cubic, example=(lambda a: lax.linalg.cholesky(a), _A)),
    Entry(name="lu", read=_lu, work=_cubic, example=(lambda a: lax.linalg.lu(a), _A)),
    Entry(
        name="triangular_solve",
        # Matrices that are conjugated are complex, which are not read.
        takes=(takes(left_side=ANY, lower=ANY, transpose_a=ANY, conjugate_a=ANY, unit_diagonal=ANY),),
        read=_triangular_solve,
        work=_cubic,
        example=(lambda a: lax.linalg.triangular_solve(a, a, left_side=True, lower=True), _A),
    ),
)
