"""Rows of loop constraints: which of them are independent in a configuration, and the minimum-norm wrenches of all of
them.

Let D and E be the scales of constraint wrenches and of velocities, see `loops.Metric`. The scaled rows $G_s = D G E^-1$
have lengths of order one, unless the motions of the two frames cancel. Rows that are linearly independent of the others
are selected (`tx.linalg.IndependentRows`); these determine the motion. Their multipliers mu cause the joint forces G'
mu. Let X express all rows as combinations of the selected ones, $X^T G_s,chosen = G_s$. The minimum-norm multipliers
with the same joint forces are

    lambda = X' (X X')^-1 mu.

If no row is omitted, X is the identity. Columns of X for rows that are shorter than the tolerance are zero.
"""

from __future__ import annotations

import functools

import numpy as np

from ...expr import (
    Concat,
    Constant,
    Expr,
    IndependentRows,
    Outer,
    Parameter,
    Solve,
    SolvePositive,
    State,
    Sum,
    Time,
    leaves_of,
    substitute,
)
from ...jax_inside import in_double
from ..kinematic_tree import KinematicTree
from .inertia_frames import mirrored

#: Larger systems are solved by LAPACK.
_SMALL = 48
#: The length of a row of G_s for two frames that a single joint moves relative to each other. If all rows are much
#: shorter, the frames move together, as with a second hinge on the axis of the first; the rows then express
#: misalignment only.
UNIT = 1.0
#: Up to this number, all rows are compared with one another; above it, the rows of one loop constraint at a time, which
#: is cheaper.
_AT_ONCE = 12


def solved(A: Expr, b: Expr) -> Expr:
    """A^-1 b for a positive definite A: small systems in scalar form, large ones by LAPACK, which compiles faster."""
    return SolvePositive(A, b) if A.shape[0] <= _SMALL else Solve(A, b)


class LoopRows:
    """The rows G (m, n) of the loop constraints of a mechanism at one configuration."""

    def __init__(self, mechanism: KinematicTree, G: Expr) -> None:
        self.G, self._metric = G, mechanism.loop_metric
        length = characteristic_length(mechanism)
        #: D (m,) and E (n,), m for rotations.
        self.measures = np.concatenate([_lengths(loop.constraint_basis.value.T, length) for loop in mechanism.loops])
        self.speeds = _speeds(mechanism, length)
        self._blocks = tuple(loop.rows for loop in mechanism.loops)

    @functools.cached_property
    def scaled(self) -> Expr:
        """The scaled rows G_s (m, n)."""
        return Constant(self.measures[:, None]) * self.G * (1.0 / self.speeds)

    @functools.cached_property
    def gram(self) -> Expr:
        """The Gram matrix G_s G_s' (m, m)."""
        return mirrored(self.scaled @ self.scaled.T)

    @functools.cached_property
    def independent(self) -> Expr:
        """Which rows are selected, and the distance of every row from the span of those selected before it, (2, m)."""
        blocks = () if len(self.measures) <= _AT_ONCE else self._blocks
        return IndependentRows(self.gram, float(self._metric.tolerance), blocks, UNIT)

    @property
    def chosen(self) -> Expr:
        """(m,) 1 for selected rows, 0 for others."""
        return self.independent[0]

    def solve(self, A: Expr, r: Expr) -> Expr:
        """The solution x of A x = r within the selected rows, zero elsewhere: A (m, m), r (m,) or (m, k)."""
        wanted = self.chosen * r if len(r.shape) == 1 else self.chosen[:, None] * r
        return solved(self._of_chosen(A), wanted)

    def shortest(self, mu: Expr) -> Expr:
        """The minimum-norm lambda (m,) that is equivalent to multipliers mu (m,) of the selected rows."""
        if len(self.measures) == 1:
            return mu
        X = solved(self._of_chosen(self.gram), self.chosen[:, None] * self.gram) * self._felt
        return Constant(self.measures) * (X.T @ solved(self._of_chosen(mirrored(X @ X.T)), mu / self.measures))

    @property
    def _felt(self) -> Expr:
        """(m,) weights of the rows: 1 for selected or long rows, 0 for rows shorter than the tolerance, smooth in
        between.
        """
        m = len(self.measures)
        squares = Concat(*(self.gram[i, i] for i in range(m)))
        least = (self._metric.tolerance**2) * (UNIT**2 + Sum(squares))
        return self.chosen + (1.0 - self.chosen) * squares / (squares + least)

    def _of_chosen(self, A: Expr) -> Expr:
        """A (m, m) with rows and columns of the identity in place of those that are not selected."""
        k = self.chosen
        return Outer(k, k) * A + (1.0 - k) * np.eye(A.shape[0])


def characteristic_length(mechanism: KinematicTree) -> float:
    """The length l of the metric, m; by default computed from the mechanism with its parameter values."""
    if mechanism.loop_metric.length is not None:
        return float(mechanism.loop_metric.length)
    places = [numbers(link.mount[:3, 3]) for link in mechanism.links]
    on_base = [link.parent in (None, mechanism.base) for link in mechanism.links]
    # The location of the mechanism is not its size: positions on the base are relative to the first of them.
    origin = places[on_base.index(True)]
    distances = [float(np.linalg.norm(place - origin * at)) for place, at in zip(places, on_base, strict=True)]
    distances = [length for length in distances if length > 0.0]
    return float(np.mean(distances)) if distances else 1.0


def numbers(expr: Expr) -> np.ndarray:
    """The value of an expression at random states, with parameter values, or one for a parameter without a value."""
    if isinstance(expr, Constant):
        return expr.value
    rng, known = np.random.default_rng(0), dict[str, Expr]()
    for leaf in leaves_of(expr):
        if isinstance(leaf, State):
            with in_double():
                value = leaf.group.retract(leaf.group.identity(), rng.normal(size=leaf.group.dimension))
            known[leaf.key()] = Constant(value)
        elif isinstance(leaf, Parameter):
            known[leaf.key()] = Constant(np.ones(leaf.shape) if leaf.value is None else leaf.value)
        elif isinstance(leaf, Time):
            known[leaf.key()] = Constant(0.0)
    folded = substitute(expr, known).canonicalize()  # without compilation, in double precision
    return folded.value if isinstance(folded, Constant) else np.full(expr.shape, np.nan)


def _lengths(wrenches: np.ndarray, length: float) -> np.ndarray:
    """For wrenches (k, 6): one over the root of |f|^2 + |tau / l|^2."""
    return 1.0 / np.sqrt(np.sum(wrenches[:, :3] ** 2, axis=1) + np.sum(wrenches[:, 3:] ** 2, axis=1) / length**2)


def _speeds(mechanism: KinematicTree, length: float) -> np.ndarray:
    """For every degree of freedom, the root of |v|^2 + |l w|^2 of the joints that it moves (n,)."""
    squares = np.zeros(mechanism.dofs)
    for segment in mechanism.segments:
        for k, i in enumerate(segment.freedoms):
            H = numbers(segment.link.joint.motion_subspace[:, k])
            squares[i] += segment.ratio**2 * (H[:3] @ H[:3] + length**2 * (H[3:] @ H[3:]))
    return np.sqrt(squares)
