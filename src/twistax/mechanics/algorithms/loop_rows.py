"""Rows of closed loops: which of them are independent in a posture, and the shortest wrenches of all of them.

With D the measures of the closures' wrenches and E those of the velocities, see `loops.Metric`, the rows G become
$G_s = D G E^-1$, of lengths of order one where the motions of the two frames do not cancel. Of these, those are chosen
that stand off the others (`tx.linalg.IndependentRows`); the motion needs no more. Their multipliers mu make the forces
G' mu of the joints. With X the combinations of the rows chosen that all rows are, $X^T G_s,chosen = G_s$, the shortest
multipliers with the same forces are

    lambda = X' (X X')^-1 mu.

Where no row is left out X is the identity. Columns of X of rows that are shorter than the tolerance are zero.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...expr import (
    Concat,
    Constant,
    Expr,
    IndependentRows,
    Inputs,
    Outer,
    Parameter,
    Solve,
    SolvePositive,
    State,
    Sum,
    evaluate_all,
    leaves_of,
)
from ..kinematic_tree import KinematicTree
from .inertia_frames import mirrored

#: Systems of more unknowns are LAPACK's.
_SMALL = 48
#: The length of a row of G_s of two frames of which one moves by a joint, alone. Where all rows are much shorter the
#: frames move as one, as those of a second hinge on the axis of the first do: the rows are what misalignment is.
UNIT = 1.0
#: So many rows are compared with one another; of more those of one closure at a time, which costs less.
_AT_ONCE = 12


def solved(A: Expr, b: Expr) -> Expr:
    """A^-1 b for a positive definite A: small ones as scalars, large ones by LAPACK, which compiles faster."""
    return SolvePositive(A, b) if A.shape[0] <= _SMALL else Solve(A, b)


class LoopRows:
    """The closure rows G (m, n) of a mechanism at one configuration."""

    def __init__(self, mechanism: KinematicTree, G: Expr) -> None:
        self.G, self._metric = G, mechanism.loop_metric
        length = characteristic_length(mechanism)
        #: D (m,) and E (n,), m for turns.
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
        """Which rows are selected, and the distances of all rows, (2, m)."""
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
        """The smallest lambda (m,) equivalent to multipliers mu (m,) of the selected rows."""
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
    """The length l of the metric, m, by default from the mechanism with its parameter values."""
    if mechanism.loop_metric.length is not None:
        return float(mechanism.loop_metric.length)
    places = [numbers(link.mount[:3, 3]) for link in mechanism.links]
    on_base = [link.parent in (None, mechanism.base) for link in mechanism.links]
    # The position of the mechanism is not its size: positions on the base are relative to the first of them.
    origin = places[on_base.index(True)]
    distances = [float(np.linalg.norm(place - origin * at)) for place, at in zip(places, on_base, strict=True)]
    distances = [length for length in distances if length > 0.0]
    return float(np.mean(distances)) if distances else 1.0


def numbers(expr: Expr) -> np.ndarray:
    """The value of an expression at random states and the values of the parameters, or one."""
    if isinstance(expr, Constant):
        return expr.value
    rng, x, params = np.random.default_rng(0), dict[str, Any](), dict[str, Any]()
    for leaf in leaves_of(expr):
        if isinstance(leaf, State):
            x[leaf.name] = leaf.group.retract(leaf.group.identity(), rng.normal(size=leaf.group.dimension))
        elif isinstance(leaf, Parameter):
            params[leaf.name] = jnp.asarray(np.ones(leaf.shape) if leaf.value is None else leaf.value)
    inputs = Inputs(jnp.zeros(()), x, {}, params, jnp.zeros(()).dtype)
    with jax.ensure_compile_time_eval():
        (value,) = evaluate_all([expr], lambda leaf: leaf.read(inputs))
    return np.asarray(value, np.float64)


def _lengths(wrenches: np.ndarray, length: float) -> np.ndarray:
    """Of wrenches (k, 6): one over the root of |f|^2 + |tau / l|^2."""
    return 1.0 / np.sqrt(np.sum(wrenches[:, :3] ** 2, axis=1) + np.sum(wrenches[:, 3:] ** 2, axis=1) / length**2)


def _speeds(mechanism: KinematicTree, length: float) -> np.ndarray:
    """Of every freedom the root of |v|^2 + |l w|^2 of the joints that it moves (n,)."""
    squares = np.zeros(mechanism.dofs)
    for segment in mechanism.segments:
        for k, i in enumerate(segment.freedoms):
            H = numbers(segment.link.joint.motion_subspace[:, k])
            squares[i] += segment.ratio**2 * (H[:3] @ H[:3] + length**2 * (H[3:] @ H[3:]))
    return np.sqrt(squares)
