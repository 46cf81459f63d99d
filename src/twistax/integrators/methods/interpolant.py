"""Polynomials between the ends of a step, from the slopes of its stages."""

from __future__ import annotations

import enum
import functools
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..tableaus import ButcherTableau

#: The largest residual of conditions that count as met.
_ROUND_OFF = 1e-9
#: Weights below this are zero, up to rounding.
_UNREAD = 1e-6


class Between(enum.Enum):
    """The method of `tx.integrate` for states at saved times inside a step."""

    #: One shorter step of the same method: as accurate as the ends of steps, at the cost of a step for each saved time.
    STEP = "a shorter step"
    #: A polynomial through the slopes of the step, in the coordinates around its start: rotations stay in their group,
    #: no rate is evaluated, and the order is that of `interpolant`.
    POLYNOMIAL = "a polynomial"


class Interpolant(NamedTuple):
    """The state at a fraction x of a step of length h: coordinates h sum_i b_i(x) k_i, with b_i(x) = sum_j w_ij x^j.

    Attributes:
        order: the order in the sense of a method: the error is of the power order + 1 of the step.
        weights: (s, order), w_ij for j = 1, 2, ...; the stages are those of `to_the_end`.
    """

    order: int
    weights: NDArray[Any]


@functools.cache
def interpolant(tableau: ButcherTableau) -> Interpolant:
    """The polynomial of highest order that the slopes of a step permit, with a continuous derivative across steps.

    Let Phi_i(t) be the elementary weights of a rooted tree t, |t| its number of nodes and gamma(t) its density. The
    order is p if sum_i b_i(x) Phi_i(t) = x^|t| / gamma(t) for all trees with at most p nodes. Slope and value at both
    ends are those of the step. These are linear equations for w; the solution with the smallest sum of squares is used.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.6, theorem 6.1.
    """
    rows = tableau.to_the_end
    ends = np.zeros(len(rows.c))
    ends[: len(tableau.b)] = tableau.b
    first, last = np.eye(len(rows.c))[[0, -1]]
    for order in range(tableau.order, 3, -1):
        weights, off = _solved(rows.a, ends, first, last, order)
        if off < _ROUND_OFF:
            return Interpolant(order, weights)
    # Cubic, as Hermite's.
    return Interpolant(
        min(tableau.order, 3), np.stack([first, 3 * ends - 2 * first - last, first + last - 2 * ends], 1)
    )


def _solved(a: Any, ends: Any, first: Any, last: Any, order: int) -> tuple[NDArray[Any], float]:
    """The weights, and the largest residual of the conditions."""
    trees = [tree for size in range(1, order + 1) for tree in _trees(size)]
    sizes, stages = np.array([_size(tree) for tree in trees]), len(ends)
    phi = np.stack([_weight(tree, a) for tree in trees])
    powers = np.arange(1, order + 1)
    wanted = np.where(sizes[:, None] == powers, 1.0 / np.array([_density(tree) for tree in trees])[:, None], 0.0)
    # There are hundreds of trees for a dozen stages: phi w = wanted is R w = Q' wanted, where it can be met.
    q, r = np.linalg.qr(phi)
    target = q.T @ wanted
    # Slope at the start, value and slope at the end.
    at, to = np.stack([powers == 1, powers**0, powers], 1).astype(float), np.stack([first, ends, last], 1)
    weights, read = np.zeros((stages, order)), np.full(stages, True)
    for _ in range(3):  # then the residual by rounding, then without superfluous stages, four of DOP853
        weights[read] += _smallest(r[:, read], target - r @ weights, at, (to - weights @ at)[read])
        read = np.abs(weights).max(1) > _UNREAD
        weights[~read] = 0.0
    weights[:, 0] = first  # the slope at the start, to the last bit
    return weights, float(max(np.abs(weights @ at - to).max(), np.abs(phi @ weights - wanted).max()))


def _smallest(a: Any, b: Any, at: Any, to: Any) -> NDArray[Any]:
    """The x with the smallest sum of squares for a x = b and x at = to, where both can be met.

    One system of equations for all entries of x would be ten times as wide: a BLAS with threads waits for them there,
    for seconds where other programs keep the processor busy.
    """
    x = np.linalg.pinv(a, rcond=1e-12) @ b
    # The correction of x at the ends lies in the null space of a, if both conditions can be met.
    return np.asarray(x + (to - x @ at) @ np.linalg.pinv(at))


# ---- rooted trees: each is the sorted tuple of those that hang from its root -----------------------------------------

_Tree: TypeAlias = tuple[Any, ...]


@functools.cache
def _trees(size: int) -> list[_Tree]:
    """The rooted trees with this number of nodes."""
    return sorted({tuple(sorted(forest)) for forest in _forests(size - 1, size - 1)})


def _forests(size: int, largest: int) -> list[tuple[_Tree, ...]]:
    if not size:
        return [()]
    parts = range(1, min(size, largest) + 1)
    return [(tree, *rest) for first in parts for tree in _trees(first) for rest in _forests(size - first, first)]


def _size(tree: _Tree) -> int:
    return 1 + sum(map(_size, tree))


def _density(tree: _Tree) -> float:
    return _size(tree) * float(np.prod([_density(branch) for branch in tree]))


def _weight(tree: _Tree, a: Any) -> Any:
    return functools.reduce(np.multiply, [a @ _weight(branch, a) for branch in tree], np.ones(len(a)))
