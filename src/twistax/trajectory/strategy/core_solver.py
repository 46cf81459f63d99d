"""The solver's core applied to a transcribed problem, from a point or a warm start."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...solver.core import CoreSolution, CoreStatus, StopCheck, Units, solve
from ...solver.options import Options
from ..hessians.options import by_updates
from ..hessians.quasi_newton import StageUpdates
from ..start_units import StartUnits
from ..transcription.evaluation import Evaluated, moved
from ..transcription.iterate import Instance, Iterate, Step
from ..transcription.staged import Staged
from .budget import Budget
from .integration import CloseIntegration
from .judge import Judge
from .measure import COST, Measure
from .outcome import Outcome
from .status import Status
from .warm import WarmStart

#: Ratios to the tolerance of a solve: the core's tolerance, its least barrier parameter, and the relaxation of bounds.
_CLOSER, _LEAST = 0.1, 1e-3
#: The largest rotation of a step, rad, and the largest relative change of a duration. A larger decrease would move the
#: duration to its limit before states and controls have adapted to it.
_TURN, _CHANGE = 1.5, 0.2
#: Iterations of a run after which its units are measured again, in general and after units were measured already. The
#: run restarts there if a unit has changed by more than this factor.
_FITTED_AT, _MISFIT = (7, 30, 80), 10.0
#: The ratio of the first barrier parameter of a warm start to the error of the start, and the limits of that parameter.
_WARM_SHARE, _WARM_LEAST, _WARM_MOST = 1e-2, 1e-9, 0.1
#: Options under which a start is only measured and not changed, however large its error is.
_AS_IT_IS = {"iterations": 0, "barrier_start": 1e-14, "slack_push": 1e-20, "bound_push": 0.0, "warm_range": 1e300}
_AS_IT_IS |= {"acceptable": 1e300}


class _Start(NamedTuple):
    """The start of a run, the data of its problem, and the units of the solve."""

    point: Iterate
    instance: Instance
    units: StartUnits


class CoreSolver:
    """Solves a transcribed problem with the solver's core. Kernels compile once.

    Args:
        staged: the problem.
        problems: the problems of its phases.
        instance: data of a solve, for shapes.
        tolerance: tolerance of the scaled first-order conditions.

    Attributes:
        busy: whether a solve is in progress.
        measure, judge: measure the errors of results, and check their meshes.
        largest_step: the largest step of each unknown, as in `solver.core.solve`.
        made: the problem in the form of IPOPT or Fatrop, by solver.
    """

    def __init__(self, staged: Staged, problems: Sequence[Any], instance: Instance, tolerance: float) -> None:
        self.staged, self.tolerance, self._problems = staged, tolerance, problems
        self.transcribed = staged.transcribed
        self.busy, self.made = False, dict[Any, Any]()
        self._by_updates = by_updates(problems)
        close = CloseIntegration(staged, problems, instance)
        self.judge, self.measure = Judge(close, staged), Measure(staged, close, tolerance)
        stages = staged.transcription.stages
        self.largest_step = np.where(staged.turning, _TURN, np.inf)
        free_times = int(staged.border.free[: staged.border.phases].sum())
        self.largest_step[stages.variables - stages.parameters + np.arange(free_times)] = -_CHANGE
        scaled = _CLOSER * tolerance / COST
        self._exactly = {"tolerance": scaled, "complementarity": scaled, "violation": _CLOSER * tolerance}
        self._exactly |= {"barrier_least": _LEAST * tolerance, "row_relaxation": 0.0}
        self._exactly |= {"bound_relaxation": min(1e-8, _LEAST * tolerance)}
        self._exactly |= {"excess": _CLOSER * tolerance, "excess_acceptable": tolerance, "acceptable": tolerance / COST}

    def alone(self, instance: Instance) -> CoreSolver:
        """A copy for another thread: it shares kernels, not memory."""
        return CoreSolver(self.staged.alone(instance), self._problems, instance, self.tolerance)

    def units(
        self, point: Iterate, instance: Instance, *, is_guess: bool = False, with_rows: bool = True
    ) -> StartUnits:
        """Units at a start, where the durations of a guess may be far too long."""
        self.staged.set_instance(instance)
        return StartUnits(self.staged, point, instance.limits if is_guess else None, with_rows=with_rows)

    def options(self, max_iterations: int) -> dict[str, float]:
        """Options of the core for a start that is not a warm start."""
        return {**self._exactly, "iterations": max_iterations}

    def moved(self, point: Iterate, step: Step) -> Iterate:
        """A point after a step."""
        return self.staged.point(moved(self.staged.transcription, self.staged.flat(point), self.staged.step(*step)))

    def run_once(
        self,
        start: Iterate | WarmStart,
        instance: Instance,
        max_iterations: int,
        budget: Budget | None = None,
        *,
        cost_floor: float = 0.0,
        as_stated: bool = False,
        rescaling: bool = True,
        is_guess: bool = True,
    ) -> Outcome:
        """Solve from a start in its units.

        Args:
            cost_floor: the smallest unit of the objective.
            as_stated: whether to use the units of the statement, without scaling.
            rescaling: whether units are measured again within a run.
            is_guess: whether a point may be far from a feasible trajectory.
        """
        point = _arrays(start.point if isinstance(start, WarmStart) else start)
        known = start.units if isinstance(start, WarmStart) and not as_stated else None
        if known is not None and known.fit(self.staged, point):
            self.staged.set_instance(instance)
            units = copy.copy(known)
        else:
            units = self.units(point, instance, is_guess=is_guess and not isinstance(start, WarmStart))
        units.cost = max(units.cost, cost_floor)
        if as_stated:
            units.become_one()
        begin, options = _Start(point, instance, units), self.options(max_iterations)
        violated = self.measure.violated_at_once(point, instance, units)
        if not violated <= self.tolerance:
            status = Status.INFEASIBLE if np.isfinite(violated) else Status.NON_FINITE
            return self.measure.outcome(self._call(begin, {**options, "iterations": 0}), units, instance, status)
        check = _IterationCheck(budget or Budget(max_iterations))
        if not isinstance(start, WarmStart):
            return self._from_point(begin, options, check, _FITTED_AT if rescaling and not as_stated else ())
        warm, distance = self._warm(begin, start.dynamics, start.rows)
        if distance <= self.tolerance:
            for units_of in (units,) if known is None else (units, known):  # it was solved in its present units
                outcome = self._as_it_is(warm, begin._replace(units=units_of))
                if outcome.status is Status.SOLVED:
                    return outcome
                distance = max(distance, outcome.errors.stationarity / COST)
        return self.measure.outcome(self._call(begin, {**options, **_near(distance)}, warm, check), units, instance)

    def measured(self, point: Iterate, dynamics: Array, rows: Array, instance: Instance) -> Outcome:
        """The optimality errors of a point with multipliers, in units measured there."""
        start = _Start(point, instance, self.units(point, instance))
        return self._as_it_is(self._warm(start, dynamics, rows)[0], start)

    def _as_it_is(self, warm: CoreSolution, start: _Start) -> Outcome:
        """The optimality errors of a warm start."""
        result = self._call(start, {**self._exactly, **_AS_IT_IS}, warm)
        return self.measure.outcome(result, start.units, start.instance, warm=True)

    def _from_point(
        self, start: _Start, options: dict[str, float], check: _IterationCheck, fitted: Sequence[int]
    ) -> Outcome:
        """A solve from a point. Its units are measured again after some iterations, because a guess may have other
        magnitudes than the solution.
        """
        left = list(fitted)
        while True:
            fresh: _Start | None = None

            def is_misfit(iteration: int, z: Array, used: _Start = start) -> bool:
                nonlocal fresh
                if not left or iteration < left[0]:
                    return False
                del left[0]
                point = self.staged.point(z.copy())
                units = StartUnits(self.staged, point, used.instance.limits, before=used.units, with_rows=False)
                if units.distance(used.units) > np.log(_MISFIT):
                    units.measure_rows(self.staged)
                    fresh = _Start(point, used.instance, units)
                return fresh is not None

            check.extra = is_misfit
            result = self._call(start, options, None, check)
            check.before += int(result.statistics["iterations"])
            if fresh is None:
                break
            options, start = {**options, "iterations": options["iterations"] - result.statistics["iterations"]}, fresh
        result.statistics["iterations"] = check.before
        return self.measure.outcome(result, start.units, start.instance)

    def _call(
        self,
        start: _Start,
        options: dict[str, float],
        warm: CoreSolution | None = None,
        check: StopCheck | None = None,
    ) -> CoreSolution:
        """One call of the core. If its feasibility restoration fails alone, iterations remain, because no step reduces
        the violation.
        """
        staged, units, functions = self.staged, start.units, self.staged.transcription.functions
        z = staged.flat(start.point)
        v = staged.coordinates(z)
        if self._by_updates:
            functions = StageUpdates(staged.transcription, units.v, units.cost).functions
        result = solve(
            staged.transcription.stages,
            functions,
            *staged.limits(v, start.instance),
            z,
            v,
            units=Units(units.v, units.rows, units.equalities, COST * units.cost),
            largest_step=self.largest_step,
            options=Options(**options),
            warm=warm,
            should_stop=check,
        )
        if result.status is CoreStatus.MAX_ITERATIONS and result.statistics["iterations"] < options["iterations"]:
            result.status = CoreStatus.STALLED
        return result

    def _warm(self, start: _Start, dynamics: Array, rows: Array) -> tuple[CoreSolution, float]:
        """A warm start for the core, and the largest violation there in the core's units."""
        staged, units = self.staged, start.units
        y, ye, zl, zu = staged.split_rows(np.asarray(rows))
        z = staged.flat(start.point)
        v = staged.coordinates(z)
        at = Evaluated(staged.transcription, z)
        parts = (at.c / staged.after(units.v), np.maximum(at.h, 0.0) / units.rows, at.e / units.equalities)
        violated = max(float(np.abs(a).max(initial=0.0)) for a in parts)
        slacks, lam = np.maximum(-at.h, 0.0), staged.unpadded(dynamics)
        return CoreSolution(CoreStatus.SOLVED, z, v, slacks, lam, y, ye, zl, zu, {}, np.zeros((0, 10))), violated


def _near(distance: float) -> dict[str, float]:
    """Options that keep the iterates near a warm start: the initial barrier parameter is proportional to its violation
    or, for a feasible start, to the gradient of its Lagrangian.
    """
    barrier = float(np.clip(_WARM_SHARE * distance, _WARM_LEAST, _WARM_MOST))
    push = min(max(barrier, 1e-12) ** 0.5, 1e-2)
    return {"barrier_start": barrier, "slack_push": push, "bound_push": push}


class _IterationCheck:
    """The callback before each iteration, which lets Python handle signals and checks the limits of the solve.

    Attributes:
        before: the number of iterations before this call of the core.
        extra: an additional condition that ends the run.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget, self.before = budget, 0
        self.extra: Callable[[int, Array], bool] = lambda iteration, z: False

    def __call__(self, iteration: int, cost: float, violation: float, z: Array) -> bool:
        is_new = iteration > 0 or self.before == 0  # the first iterate in new units is the last one in the old units
        return (is_new and self.budget.ends(self.before + iteration, cost, violation, z)) or self.extra(iteration, z)


def _arrays(tree: Any) -> Any:
    if isinstance(tree, Iterate):
        return Iterate(*(_arrays(a) for a in tree))
    if isinstance(tree, tuple):
        return tuple(map(_arrays, tree))
    return {name: np.asarray(a) for name, a in tree.items()} if isinstance(tree, dict) else np.asarray(tree)
