"""Results of the solver's core in terms of the problem: rows, multipliers, errors and status."""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from ...solver.core import CoreSolution, CoreStatus
from ..start_units import StartUnits
from ..transcription.evaluation import Evaluated
from ..transcription.iterate import Instance, Iterate, Values
from ..transcription.staged import Staged
from .integration import CloseIntegration
from .outcome import Errors, Outcome, Scales
from .status import Status

#: The ratio of the core's unit of the objective to its change under moves of all unknowns by their sizes. The barrier
#: parameter starts at 0.1 of that unit.
COST = 0.02
#: A result is acceptable within this multiple of the tolerance.
_ACCEPTABLE = 100.0

#: The exit status of the core as a `Status`.
_STATUS = {
    CoreStatus.SOLVED: Status.SOLVED,
    CoreStatus.MAX_ITERATIONS: Status.MAX_ITERATIONS,
    CoreStatus.INFEASIBLE: Status.INFEASIBLE,
    CoreStatus.NON_FINITE: Status.NON_FINITE,
    CoreStatus.STOPPED: Status.STOPPED,
    CoreStatus.UNBOUNDED: Status.UNBOUNDED,
}


class Measure:
    """Measures the errors of results of the core.

    Args:
        tolerance: tolerance of the scaled first-order conditions.
    """

    def __init__(self, staged: Staged, close: CloseIntegration, tolerance: float) -> None:
        self._staged, self._transcribed, self._close, self._tolerance = staged, staged.transcribed, close, tolerance

    @property
    def has_determined_rows(self) -> bool:
        """Whether fixed initial or final values alone determine a row."""
        return bool((self._transcribed.determined & ~self._transcribed.redundant).any())

    def violated_at_once(self, point: Iterate, instance: Instance, units: StartUnits) -> float:
        """The largest scaled violation of rows that fixed initial or final values determine, so that no trajectory can
        satisfy them.
        """
        if not self.has_determined_rows:
            return 0.0
        problem = self._transcribed
        rows = self._close.determined_rows(self._staged.flat(point), instance)
        violated = np.where(problem.equality, np.abs(rows), np.maximum(rows, 0.0)) / self.row_sizes(units)
        return float(np.where(problem.determined & ~problem.redundant, violated, 0.0).max(initial=0.0))

    def row_sizes(self, units: StartUnits) -> Array:
        """Sizes of all rows; a row that the core does not have has the size of another row of the same name."""
        problem = self._transcribed
        sizes = self._staged.all_rows(units.rows, units.equalities, units.v, units.v)
        for name in np.unique(problem.names[(sizes <= 0.0) & problem.determined].astype(str)):
            has_name = problem.names == name
            sizes[has_name & (sizes <= 0.0)] = sizes[has_name].max()
        return np.where(sizes > 0.0, sizes, 1.0)

    def scales(self, units: StartUnits) -> Scales:
        """Units of all unknowns and of the objective; rows are not scaled."""
        problem = self._transcribed
        d, u = np.ones((problem.nodes, problem.n)), np.ones((problem.intervals, problem.m))
        for number, (part, sizes) in enumerate(zip(self._staged.parts, units.parts)):
            last = part.stages.stop - 1
            d[part.stages, : part.shooting.n] = sizes.d
            u[part.stages.start : last, : part.shooting.m] = sizes.u
            if part.phase.join is not None:
                free = part.phase.join.free
                u[last, : len(free)] = units.parts[number + 1].d[free]
        return Scales(d, u, units.border, np.ones(len(problem.exists)), np.asarray(units.cost))

    @np.errstate(all="ignore")
    def outcome(
        self,
        result: CoreSolution,
        units: StartUnits,
        instance: Instance,
        status: Status | None = None,
        warm: bool = False,
    ) -> Outcome:
        """The outcome of a run, with the status of the core unless another status applies."""
        staged, problem, numbers = self._staged, self._transcribed, result.statistics
        at, point = Evaluated(staged.transcription, result.z), staged.point(result.z)
        lower, upper = staged.limits(staged.coordinates(result.z), instance)
        rows = staged.all_rows(at.h, at.e, lower - result.v, result.v - upper)
        w = staged.all_rows(result.y, result.ye, result.zl, result.zu)
        if problem.determined.any():
            rows = np.where(problem.determined, self._close.determined_rows(result.z, instance), rows)
        sizes = self.row_sizes(units)
        inequality = problem.exists & ~problem.equality
        slack = np.where(inequality, np.maximum(-rows, 0.0), 1.0)
        scales = self.scales(units)._replace(rows=sizes)
        defects, dynamics = staged.padded(at.c), staged.padded(result.lam)
        violated = np.where(problem.equality, np.abs(rows), np.maximum(rows, 0.0)) / sizes
        violated = np.where(problem.exists | problem.determined, violated, 0.0)
        gap = (np.abs(w) * np.where(inequality, slack, np.abs(rows)))[problem.exists].sum()
        gap += np.abs(dynamics * defects).sum()
        errors = Errors(
            numbers["stationarity"] * COST,
            numbers["violation"],
            numbers["complementarity"] * COST,
            float(gap / units.cost),
            float(numbers["excess"] / numbers["worth"]) if numbers["worth"] > 0.0 else np.nan,
        )
        ended = status or self._status(result, float(violated.max(initial=0.0)), errors)
        return Outcome(
            point=point,
            values=Values(at.cost[0], defects, rows),
            errors=errors,
            dynamics=dynamics,
            rows=w,
            scaled_rows=w * sizes / units.cost,
            slack=slack,
            violations=np.concatenate([(np.abs(defects) / scales.d[1:]).ravel(), violated]),
            scales=scales,
            status=ended,
            iterations=max(int(numbers["iterations"]), int(not warm)),
            saddle=ended in (Status.SOLVED, Status.ACCEPTABLE) and not numbers["minimum"],
            units=units,
        )

    def _status(self, result: CoreSolution, violated: float, errors: Errors) -> Status:
        numbers, tolerance = result.statistics, self._tolerance
        holds = numbers["violation"] <= tolerance and violated <= tolerance
        optimal = max(errors.stationarity, errors.complementarity, errors.gap) <= tolerance
        if result.status is CoreStatus.SOLVED or (holds and optimal and errors.excess <= tolerance):
            return Status.SOLVED
        if result.status in _STATUS:
            return _STATUS[result.status]
        return Status.ACCEPTABLE if max(numbers["error"], errors.excess) <= _ACCEPTABLE * tolerance else Status.STALLED
