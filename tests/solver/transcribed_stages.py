"""The core on problems as `tx.trajectory.Problem` transcribes them: states on groups, times as parameters, phases."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from twistax.solver import Options, PythonFunctions, Solution, Stages, solve
from twistax.trajectory.outcome import Searched, outcome
from twistax.trajectory.solver import Status
from twistax.trajectory.transcribed import Step, jitted


class ByCore:
    """A solver for `Problem.solve(solver=...)`: the core, with functions of JAX. Rows of limits are inequalities.

    Everything is in the scales that the problem's start has, but for the cost, which is not divided.
    """

    def __init__(self, **options: float) -> None:
        self._options = options

    def run(self, solver: Any, start: Any, given: Any, max_iterations: int, callback: Any) -> Any:
        scales = solver.steps.opened(start, given).state.scales
        stated = StagesOf(solver, start, given, scales._replace(cost=jnp.ones(())))
        options = {"tolerance": 0.1 * solver.tolerance, "iterations": max_iterations, **self._options}
        found = stated.solve(Options(**options))
        dynamics, rows = stated.multipliers(found.lam, found.y, found.ye)
        in_cost = float(scales.cost)
        _, state = solver.weighed(stated.point(found.z), given, scales, dynamics / in_cost, rows / in_cost)
        status = Status.SOLVED if found.status.name == "SOLVED" else Status.STALLED
        return Searched(
            outcome(solver.shooting, state, status, int(found.statistics["iterations"])), state, None
        ).outcome


class StagesOf:
    """A transcribed problem as stages: unknowns that cannot move, and rows that do not exist, are left out."""

    def __init__(self, solver: Any, start: Any, given: Any, scales: Any) -> None:
        self._given, self._scales, shooting = given, scales, solver.shooting
        self._count, self._width, self._steered = shooting.intervals, shooting.n, shooting.m
        self._shared = shooting.border.size
        free_d, free_u, free_b = (np.asarray(a) for a in shooting.free)
        self._d = [np.flatnonzero(row) for row in free_d]
        self._u = [*(np.flatnonzero(row) for row in free_u), np.zeros(0, int)]
        self._b = np.flatnonzero(free_b)
        exists, equality = np.asarray(shooting.exists), np.asarray(shooting.equality)
        self._rows = len(exists)
        self._split_rows = np.arange(1, self._count + 1) * shooting.rows_per_interval
        self._h, self._e = exists & ~equality, exists & equality
        at = [[np.flatnonzero(part) for part in np.split(which, self._split_rows)] for which in (self._h, self._e)]
        self._at_h, self._at_e = at
        n, m = self._width, self._steered
        self._columns = [np.concatenate([d, n + u, n + m + self._b]) for d, u in zip(self._d[:-1], self._u)]
        self._columns.append(np.concatenate([self._d[-1], n + self._b]))

        leaves, self._tree = jax.tree.flatten(jax.tree.map(np.asarray, start))
        self._shapes, self._sizes = [a.shape for a in leaves], [a.size for a in leaves]
        self._start = np.concatenate([np.ravel(a) for a in leaves])
        controls = [len(u) for u in self._u]
        # The core only hands points on: how they are laid out is a matter of these functions.
        points = [len(self._start) - sum(controls) - len(self._b)] + [0] * self._count
        counts = ([len(d) for d in self._d], controls, [len(h) for h in self._at_h], [len(e) for e in self._at_e])
        self.stages = Stages(*counts, len(self._b), points)
        self._ends = np.cumsum([len(d) + len(u) for d, u in zip(self._d, self._u)])

        method = solver.method
        self._values = jitted(lambda p: method.scaled(shooting.values(p, given), scales))
        self._slopes = jitted(lambda p, y, w: method.derivatives_at(p, y, w, scales, given))
        self._turned = jitted(lambda p, c: self._left_jacobians(shooting, p, c))
        self._move = jitted(
            lambda p, s: shooting.move(p, Step(s.d * scales.d, s.u * scales.u, s.border * scales.border))
        )

    def _left_jacobians(self, shooting: Any, point: Any, defects: Any) -> Any:
        """J_l(c) = J_r(-c) of scaled defects."""
        c = defects * self._scales.d[1:]
        turned = shooting.charts(point.xs, jnp.concatenate([jnp.zeros_like(c[:1]), -c]))[1:]
        return turned * self._scales.d[1:, None, :] / self._scales.d[1:, :, None]

    def point(self, z: Array) -> Any:
        parts = np.split(z, np.cumsum(self._sizes)[:-1])
        return jax.tree.unflatten(self._tree, [a.reshape(shape) for a, shape in zip(parts, self._shapes)])

    def multipliers(self, lam: Array, y: Array, ye: Array) -> tuple[Array, Array]:
        dynamics, rows = np.zeros((self._count, self._width)), np.zeros(self._rows)
        for own, places, part in zip(dynamics, self._d[1:], np.split(lam, np.cumsum(self.stages.after)[:-2])):
            own[places] = part
        rows[self._h], rows[self._e] = y, ye
        return dynamics, rows

    def _step(self, v: Array) -> Step:
        d, u = np.zeros((self._count + 1, self._width)), np.zeros((self._count, self._steered))
        border = np.zeros(self._shared)
        *parts, border[self._b] = np.split(v, self._ends)
        for k, part in enumerate(parts):
            d[k, self._d[k]] = part[: len(self._d[k])]
            if k < self._count:
                u[k, self._u[k]] = part[len(self._d[k]) :]
        return Step(d, u, border)

    def solve(self, options: Any) -> Solution:
        functions = PythonFunctions(self.stages, self._numbers, self._jacobians, self._hessians, self._retract)
        ends = np.full(self.stages.variables, np.inf)
        return solve(
            *(self.stages, functions.functions, -ends, ends, self._start, np.zeros_like(ends)),
            options=options,
        )

    def _numbers(self, z: Array) -> Any:
        found = self._values(self.point(z))
        defects, rows = np.asarray(found.defects), np.asarray(found.rows)
        return float(found.cost), self._of_next(defects), rows[self._h], rows[self._e]

    def _of_next(self, defects: Array) -> Array:
        return np.concatenate([own[d] for own, d in zip(defects, self._d[1:])])

    def _derivatives(self, z: Array, dynamics: Any, rows: Any) -> Any:
        """Derivatives, with rows of the dynamics whose derivative by the next state is -1."""
        point = self.point(z)
        turned = np.asarray(self._turned(point, self._values(point).defects))
        found = self._slopes(point, np.einsum("kij,ki->kj", turned, dynamics), rows)
        return jax.tree.map(np.asarray, found._replace(defects=turned @ np.asarray(found.defects)))

    def _jacobians(self, z: Array) -> Any:
        found = self._derivatives(z, np.zeros((self._count, self._width)), np.zeros(self._rows))
        gradients = [*found.gradient, found.end_gradient]
        parts, shared = [], np.zeros(len(self._b))
        for own, columns in zip(gradients, self._columns):
            parts.append(own[columns[: len(columns) - len(self._b)]])
            shared += own[columns[len(columns) - len(self._b) :]]
        rows = [*found.rows, found.end_rows]
        blocks = [
            [own[np.ix_(*at)] for own, *at in zip(rows, places, self._columns)] for places in (self._at_h, self._at_e)
        ]
        after = [own[np.ix_(*at)] for own, *at in zip(found.defects, self._d[1:], self._columns)]
        return np.concatenate([*parts, shared]), after, *blocks

    def _hessians(self, z: Array, weight: float, lam: Array, y: Array, ye: Array) -> Any:
        dynamics, rows = self.multipliers(lam, y, ye)
        found = self._derivatives(z, dynamics / weight, rows / weight)
        whole = [*found.hessian, found.end_hessian]
        return [weight * own[np.ix_(columns, columns)] for own, columns in zip(whole, self._columns)]

    def _retract(self, z: Array, v: Array) -> Array:
        moved = self._move(self.point(z), self._step(v))
        return np.concatenate([np.ravel(a) for a in jax.tree.leaves(moved)])
