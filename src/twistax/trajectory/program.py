"""A discrete problem as a nonlinear program with sparse derivatives, for solvers of others.

Unknowns and constraints stand stage by stage, as solvers that know stages want them:

    z = [d_0, du_0, ..., d_K, b],   minimise f(z),   lower <= g(z) <= upper,
    g = [d_1 - F_0(d_0, du_0, b), rows_0, ..., rows of the end].

d_k are tangents in the charts at nodes that stay, the reference; b is what all stages share, the final time first, or
a copy of it for each stage, b_k, where a solver wants stages that share nothing. Unknowns that cannot move are left
out. Everything is scaled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from .interior_point import InteriorPoint
from .iterate import Scales
from .transcribed import Derivatives, Given, Point, Step, Transcribed, Values, jitted


class Entries(NamedTuple):
    """Where the entries of a sparse matrix stand, column by column, and which numbers add up to each."""

    rows: Array
    columns: Array
    source: Array
    target: Array

    def of(self, parts: Sequence[Array]) -> Array:
        """The entries, of the numbers in arrays one after the other."""
        numbers = np.concatenate([part.ravel() for part in parts])[self.source]
        return np.bincount(self.target, numbers, minlength=len(self.rows))


class Reference(NamedTuple):
    """What a program is stated about: nodes, scales, and what the problem is solved for."""

    point: Point
    scales: Scales
    given: Given


class Reached(NamedTuple):
    """Where a solver ended: the point, multipliers of the dynamics and of the rows, and the largest turn, rad."""

    point: Point
    dynamics: Array
    rows: Array
    turn: float


class Program:
    """The nonlinear program behind a discrete problem.

    Attributes:
        size, count: numbers of unknowns and of constraints.
        lower, upper: (count,) limits of g.
        jacobian, hessian: `Entries` of g' and of the Lagrangian's second derivative, which is symmetric.
        stages: per node the numbers of states (b included), of controls and of rows.

    Args:
        with_copies: whether each stage has a b of its own.
    """

    def __init__(self, shooting: Transcribed, method: InteriorPoint, *, with_copies: bool) -> None:
        self._shooting, self._method = shooting, method
        free, intervals = shooting.free, shooting.intervals
        n, m, shared = free.d.shape[1], free.u.shape[1], len(free.border)
        rows = method.split(jnp.asarray(shooting.exists))
        inner, end = np.asarray(rows.inner), np.asarray(rows.end)
        d, u = -np.ones((intervals + 1, n), int), -np.ones((intervals, m), int)
        b = -np.ones((intervals + 1, shared), int)
        gaps, copies = -np.ones((intervals, n), int), -np.ones((intervals, shared), int)
        inner_rows, end_rows = -np.ones(inner.shape, int), -np.ones(end.shape, int)
        self.size = self.count = 0
        stages = []
        for k in range(intervals + 1):
            states = self._number(d[k], free.d[k])
            if with_copies or k == intervals:
                states += self._number(b[k], free.border)
            if k == intervals:
                stages.append((states, 0, self._count(end_rows, end)))
                break
            controls = self._number(u[k], free.u[k])
            self._count(gaps[k], free.d[k + 1])
            if with_copies:
                self._count(copies[k], free.border)
            stages.append((states, controls, self._count(inner_rows[k], inner[k])))
        if not with_copies:
            b[:] = b[-1]
        self.stages = tuple(stages)
        self._places = d, b, u
        self._row_places = gaps, copies, np.concatenate([inner_rows.ravel(), end_rows])
        equality = np.ones(self.count, bool)
        row_places = self._row_places[2]
        equality[row_places[row_places >= 0]] = shooting.equality[row_places >= 0]
        self.lower, self.upper = np.where(equality, 0.0, -np.inf), np.zeros(self.count)
        self._describe(copies, inner_rows, end_rows)
        self._values_of, self._derivatives_of = jitted(self._values), jitted(self._derivatives)
        self._reached = jitted(self._moved)

    def _number(self, places: Array, which: Array) -> int:
        """Give the next numbers to some unknowns."""
        count = int(which.sum())
        places[which] = np.arange(self.size, self.size + count)
        self.size += count
        return count

    def _count(self, places: Array, which: Array) -> int:
        """Give the next numbers to some constraints."""
        count = int(which.sum())
        places[which] = np.arange(self.count, self.count + count)
        self.count += count
        return count

    def _describe(self, copies: Array, inner_rows: Array, end_rows: Array) -> None:
        """Where derivatives stand in sparse matrices."""
        d, b, u = self._places
        gaps = self._row_places[0]
        own = np.concatenate([d[:-1], u, b[:-1]], axis=1)  # (intervals, size), in the order of Derivatives
        last = np.concatenate([d[-1], b[-1]])
        self._columns = own, last
        blocks = [
            np.broadcast_arrays(gaps[:, :, None], own[:, None, :]),
            np.broadcast_arrays(inner_rows[:, :, None], own[:, None, :]),
            np.broadcast_arrays(end_rows[:, None], last[None, :]),
            (gaps, d[1:]),
            (copies, b[1:]),
            (copies, b[:-1]),
        ]
        self.jacobian = _entries(blocks)
        self.hessian = _entries(
            [
                np.broadcast_arrays(own[:, :, None], own[:, None, :]),
                np.broadcast_arrays(last[:, None], last[None, :]),
            ]
        )

    # ---- values and derivatives, as NumPy arrays --------------------------------------------------------------------

    def step(self, z: Array) -> Step:
        """The step in the problem's units of scales that unknowns stand for."""
        whole = np.append(z, 0.0)  # places of what cannot move are -1
        d, b, u = self._places
        return Step(whole[d], whole[u], whole[b[0]])

    def values(self, z: Array, reference: Reference) -> tuple[float, Array]:
        """f and g."""
        found = self._values_of(self.step(z), reference)
        _, b, _ = self._places
        whole, g = np.append(z, 0.0), np.zeros(self.count + 1)
        gaps, copies, rows = self._row_places
        g[gaps], g[rows] = -np.asarray(found.defects), np.asarray(found.rows)
        g[copies] = whole[b[1:]] - whole[b[:-1]]
        return float(found.cost), g[:-1]

    def slopes(self, z: Array, reference: Reference) -> tuple[Array, Array]:
        """The gradient of f, and the numbers of the Jacobian of g."""
        found = self._derivatives_of(self.step(z), reference, *self.multipliers(np.zeros(self.count)))
        inner, last = self._columns
        gradient = np.zeros(self.size + 1)
        np.add.at(gradient, inner, np.asarray(found.gradient))
        np.add.at(gradient, last, np.asarray(found.end_gradient))
        gaps, copies, _ = self._row_places
        parts = (-np.asarray(found.defects), np.asarray(found.rows), np.asarray(found.end_rows))
        return gradient[:-1], self.jacobian.of([*parts, np.ones(gaps.size + copies.size), -np.ones(copies.size)])

    def bend(self, z: Array, reference: Reference, weight: float, multipliers: Array) -> Array:
        """The numbers of the second derivative of weight f + multipliers . g."""

        def of(multipliers: Array) -> Array:
            found = self._derivatives_of(self.step(z), reference, *self.multipliers(multipliers))
            return self.hessian.of([np.asarray(found.hessian), np.asarray(found.end_hessian)])

        # What is compiled has the objective with weight one.
        return weight * of(multipliers / weight) if weight > 0.0 else of(multipliers) - of(np.zeros(self.count))

    def reached(self, z: Array, reference: Reference, multipliers: Array) -> Reached:
        """The point after a step, with the multipliers of what was scaled by the reference."""
        step = self.step(z)
        y, w = self.multipliers(multipliers)
        point, charts = self._reached(step, reference)
        y = np.stack([np.linalg.solve(J.T, own) for J, own in zip(np.asarray(charts)[1:], y)])
        turns = np.abs(step.d * np.asarray(reference.scales.d))[np.broadcast_to(self._shooting.turns, step.d.shape)]
        return Reached(jax.tree.map(np.asarray, point), y, w, float(turns.max(initial=0.0)))

    def multipliers(self, multipliers: Array) -> tuple[Array, Array]:
        """Those of the dynamics, F_k - d_(k+1), and of the rows, from those of g."""
        whole = np.append(multipliers, 0.0)
        gaps, _, rows = self._row_places
        return -whole[gaps], whole[rows]

    def flat_multipliers(self, dynamics: Any, rows: Any) -> Array:
        """Those of g from those of the dynamics and of the rows; of copies zero."""
        found = np.zeros(self.count + 1)
        gaps, _, row_places = self._row_places
        found[gaps], found[row_places] = -np.asarray(dynamics), np.asarray(rows)
        return found[:-1]

    # ---- the same in JAX ------------------------------------------------------------------------------------------

    def _begun(self, step: Step, reference: Reference) -> tuple[Point, jax.Array]:
        """The reference with other controls and times, and the step of its nodes."""
        point, s = reference.point, reference.scales
        shift = Step(jnp.zeros_like(step.d), step.u * s.u, step.border * s.border)
        return self._shooting.move(point, shift), step.d * s.d

    def _moved(self, step: Step, reference: Reference) -> tuple[Point, jax.Array]:
        """The point after a step, and (nodes, n, n) the scaled change of charts there."""
        s = reference.scales
        turned = self._shooting.charts(reference.point.xs, step.d * s.d)
        point = self._shooting.move(reference.point, Step(step.d * s.d, step.u * s.u, step.border * s.border))
        return point, turned * s.d[:, None] / s.d[:, :, None]

    def _values(self, step: Step, reference: Reference) -> Values:
        point, d = self._begun(step, reference)
        return self._method.scaled(self._shooting.values(point, reference.given, d), reference.scales)

    def _derivatives(self, step: Step, reference: Reference, y: Any, w: Any) -> Derivatives:
        point, d = self._begun(step, reference)
        return self._method.derivatives_at(point, y, w, reference.scales, reference.given, d)


def _entries(blocks: Sequence[Any]) -> Entries:
    """The entries of blocks of (row, column) places, -1 for what is left out."""
    rows, columns = (np.concatenate([np.asarray(block[i]).ravel() for block in blocks]) for i in range(2))
    source = np.flatnonzero((rows >= 0) & (columns >= 0))
    places, target = np.unique(np.stack([columns[source], rows[source]]), axis=1, return_inverse=True)
    return Entries(places[1], places[0], source, target.ravel())
