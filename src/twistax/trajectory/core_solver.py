"""The solver's core on a transcribed problem: units, a solve, and what came out in the terms of this package."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..solver.core import Solution, solve
from ..solver.core import Status as CoreStatus
from ..solver.options import Options
from .iterate import Errors, Scales
from .outcome import Outcome
from .problem import Problem
from .sizes import Sizes, measured_sizes
from .staged import Staged, method_of
from .transcribed import Given, Point, Values
from .watch import Status

_POINTER = ctypes.c_void_p

#: What the core says, in the words of this package.
_STATUS = {
    CoreStatus.SOLVED: Status.SOLVED,
    CoreStatus.MAX_ITERATIONS: Status.MAX_ITERATIONS,
    CoreStatus.INFEASIBLE: Status.INFEASIBLE,
    CoreStatus.NON_FINITE: Status.NON_FINITE,
    CoreStatus.STOPPED: Status.OUT_OF_TIME,
}


class Evaluated:
    """Values and derivatives of a problem in stages at a point, by its functions."""

    def __init__(self, staged: Staged, z: Array) -> None:
        transcription = staged.transcription
        stages, functions = transcription.stages, transcription.functions
        self.stages = stages
        self.cost, self.c = np.zeros(1), np.zeros(sum(stages.after))
        self.h, self.e = np.zeros(sum(stages.inequalities)), np.zeros(sum(stages.equalities))
        self.gradient = np.zeros(stages.variables)
        counts = (stages.after, stages.inequalities, stages.equalities)
        self.F, self.Jh, self.Je = (np.zeros(stages.block_sizes(rows)) for rows in counts)
        self.H = np.zeros(stages.block_sizes(stages.columns))
        self._z, self._functions = np.ascontiguousarray(z), functions
        self._failed = self._call("values", self.cost, self.c, self.h, self.e)
        transcription.check()

    def _call(self, name: str, *arrays: Any) -> int:
        kinds = [ctypes.c_double if isinstance(a, float) else _POINTER for a in arrays]
        function = ctypes.CFUNCTYPE(ctypes.c_int32, _POINTER, _POINTER, *kinds)(getattr(self._functions, name))
        pointers = [a if isinstance(a, float) else a.ctypes.data for a in arrays]
        return int(function(self._functions.user, self._z.ctypes.data, *pointers))

    def differentiate(self) -> bool:
        """First derivatives, and the second ones of the cost; whether there are such."""
        zeros = [np.zeros_like(a) for a in (self.c, self.h, self.e)]
        failed = self._failed or self._call("jacobians", self.gradient, self.F, self.Jh, self.Je)
        return not (failed or self._call("hessians", 1.0, *zeros, self.H))

    def bends(self, y: Array, ye: Array) -> Array:
        """Second derivatives of y . h + ye . e."""
        H = np.zeros_like(self.H)
        self._call("hessians", 0.0, np.zeros_like(self.c), y, ye, H)
        return H

    def blocks(self, flat: Array, rows: Any) -> list[Array]:
        """The matrices (rows, columns) of all stages."""
        sizes = [r * n for r, n in zip(rows, self.stages.columns)]
        parts = np.split(flat, np.cumsum(sizes)[:-1])
        return [a.reshape(n, r).T for a, r, n in zip(parts, rows, self.stages.columns)]


class Units:
    """Units for the core at a start.

    Attributes:
        sizes: of states, controls and shared unknowns.
        v: of all variables.
        rows, equalities, cost: of the rows and the objective.
    """

    def __init__(self, staged: Staged, point: Point) -> None:
        shooting, K = staged.shooting, staged.shooting.intervals
        at = Evaluated(staged, staged.flat(point))
        good = at.differentiate()
        stages = at.stages
        F = np.stack(at.blocks(at.F, stages.after)[:-1])
        moved = F if good and np.isfinite(F).all() else np.zeros_like(F)
        self.sizes = sizes = measured_sizes(shooting, point, moved)
        inner = np.tile(np.concatenate([sizes.d, sizes.u]), K)
        self.v = np.concatenate([inner, sizes.d, sizes.border])
        columns = [np.concatenate([sizes.d, sizes.u, sizes.border])] * K
        columns.append(np.concatenate([sizes.d, sizes.border]))
        slopes = [at.blocks(flat, counts) for flat, counts in ((at.Jh, stages.inequalities), (at.Je, stages.equalities))]
        changes = [np.concatenate([np.zeros(0), *(np.abs(b) @ c for b, c in zip(own, columns))]) for own in slopes]
        for places in staged.places_alone():
            weights = [np.zeros(len(change)) for change in changes]
            for weight, at_place in zip(weights, places):
                weight[at_place] = 1.0
            bends = [c @ np.abs(H) @ c for c, H in zip(columns, at.blocks(at.bends(*weights), stages.columns))]
            for change, own, at_place in zip(changes, staged.stages_of_rows, places):
                change[at_place] += 0.5 * np.array(bends)[own[at_place]]
        self.rows, self.equalities = staged.levelled_rows(*changes)
        bends = sum(c @ np.abs(H) @ c for c, H in zip(columns, at.blocks(at.H, stages.columns)))
        moves = np.abs(at.gradient) @ self.v + 0.5 * bends
        self.cost = float(moves) if np.isfinite(moves) and moves > 0.0 else 1.0


class CoreSolver:
    """Solves a problem of one phase by the core; what it needs compiles once."""

    def __init__(self, problem: Problem, given: Given) -> None:
        self.shooting = problem.shooting
        self.staged = Staged(problem.shooting, dict(problem.node_rows), method_of(problem.transcription), given)

    def run(self, start: Point, given: Given, max_iterations: int, tolerance: float, **options: float) -> Outcome:
        """Solve from a start."""
        staged, point = self.staged, Point(*(_arrays(a) for a in start))
        staged.transcription.set_data(staged.functions.data(given))
        units = Units(staged, point)
        turn, far = options.pop("turn", 1.5), options.pop("far", 1e300)
        cost_size = options.pop("cost_size", units.cost)
        chosen = {"tolerance": 0.1 * tolerance, "iterations": max_iterations, **options}
        result = solve(
            staged.transcription.stages,
            staged.transcription.functions,
            *staged.limits(point, given),
            staged.flat(point),
            staged.coordinates(point),
            size=units.v,
            row_size=units.rows,
            equality_size=units.equalities,
            cost_size=cost_size,
            largest_step=np.where(np.isin(np.arange(len(units.v)), staged.turning), turn, far * units.v),
            options=Options(**chosen),
        )
        self.result = result
        return self._outcome(result, units, given)

    def _outcome(self, result: Solution, units: Units, given: Given) -> Outcome:
        """What came out."""
        staged, own, K = self.staged, self.shooting, self.shooting.intervals
        at = Evaluated(staged, result.z)
        rows, slack = staged.rows(at.h, at.e), np.ones(len(own.exists))
        w = staged.rows(result.y, result.ye)
        row_sizes = staged.rows(units.rows, units.equalities)
        bounds, inequality = staged.bounds, own.exists & ~own.equality
        limit = np.where(np.isnan(bounds.limits), 0.0, bounds.limits)
        lower, upper = staged.limits(staged.point(result.z), given)
        limit = np.where(bounds.upper, upper[bounds.variables], lower[bounds.variables])
        rows[bounds.rows] = np.where(bounds.upper, 1.0, -1.0) * (result.v[bounds.variables] - limit)
        w[bounds.rows] = np.where(bounds.upper, result.zu[bounds.variables], result.zl[bounds.variables])
        row_sizes[bounds.rows] = units.v[bounds.variables]
        row_sizes = np.where(row_sizes > 0.0, row_sizes, 1.0)
        slack = np.where(inequality, np.maximum(-rows, 0.0), slack)
        sizes, cost = units.sizes, units.cost
        scales = Scales(
            np.tile(sizes.d, (K + 1, 1)), np.tile(sizes.u, (K, 1)), sizes.border, row_sizes, np.asarray(cost)
        )
        defects = at.c.reshape(K, own.n)
        violated = np.where(own.equality, np.abs(rows), np.maximum(rows, 0.0)) / row_sizes
        violated = np.where(own.exists | own.decided, violated, 0.0)
        lam = result.lam.reshape(K, own.n)
        gap = (np.abs(w) * np.where(inequality, slack, np.abs(rows)))[own.exists].sum() + np.abs(lam * defects).sum()
        numbers = result.statistics
        errors = Errors(numbers["stationarity"], numbers["violation"], numbers["complementarity"], gap / cost)
        return Outcome(
            point=staged.point(result.z),
            values=Values(at.cost[0], defects, rows),
            errors=errors,
            dynamics=lam,
            rows=w,
            scaled_rows=w * row_sizes / cost,
            slack=slack,
            violations=np.concatenate([(np.abs(defects) / sizes.d).ravel(), violated]),
            scales=scales,
            status=_STATUS.get(result.status, Status.STALLED),
            iterations=max(int(numbers["iterations"]), 1),
        )


def _arrays(tree: Any) -> Any:
    return {name: np.asarray(a) for name, a in tree.items()} if isinstance(tree, dict) else np.asarray(tree)
