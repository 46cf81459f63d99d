"""The solver's core on a transcribed problem: a solve, and what came out in the terms of this package."""

from __future__ import annotations

import copy
import functools
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..solver.core import Solution, Units, Watch, solve
from ..solver.core import Status as CoreStatus
from ..solver.options import Options
from . import strategies
from .accuracy import Judge
from .budget import Budget
from .close_look import CloseLook
from .evaluated import Evaluated, moved
from .hessians import by_updates
from .iterate import Errors, Scales
from .outcome import Outcome
from .quasi_newton import StageUpdates
from .staged import Staged
from .start_units import StartUnits
from .strategies import Strategy
from .transcribed import Given, Point, Step, Values
from .warm import WarmStart
from .watch import Status

#: The core's tolerance over that of a solve, and of complementarity over that; what slacks can change of the objective
#: counts as a sum, so it is smaller where there are more inequalities than so many.
_CLOSER, _FEW, _EXACT = 0.1, 2, 0.005
#: A warm start asks for so many times that: it begins near, and is one of many.
_NEAR = 10.0
#: The core's unit of the objective over what moves of all unknowns by their sizes change of it: the barrier parameter
#: begins at 0.1 of that unit.
COST = 0.02
#: The largest turn of a step, rad, and the largest change of a duration, relative: one that falls faster has come to
#: its limit before states and controls have followed it.
_TURN, _CHANGE = 1.5, 0.2
#: Iterations of a run, or of one in units that were measured then, after which units are measured anew; it begins anew
#: there if one of them is so many times as large or as small.
_FITTED_AT, _MISFIT = (7, 80), 10.0
#: A result is acceptable within so many tolerances.
_ACCEPTABLE = 100.0
#: The first barrier parameter of a warm start over its error, and the limits of that parameter.
_WARM_SHARE, _WARM_LEAST, _WARM_MOST = 1e-2, 1e-9, 0.1
#: Options that change nothing of a start: it is only measured.
_AS_IT_IS = {"iterations": 0, "barrier_start": 1e-14, "slack_push": 1e-14, "bound_push": 0.0, "warm_range": 1e300}
#: Random starts: moves of states and controls in their sizes; how much larger than sizes, or than those of the guess,
#: gaps may be, and shares of a move to them.
_MOVES, _LOST, _SHARES = (0.4, 0.15), 30.0, tuple(0.5**k for k in range(11))

#: What the core says, in the words of this package.
_STATUS = {
    CoreStatus.SOLVED: Status.SOLVED,
    CoreStatus.MAX_ITERATIONS: Status.MAX_ITERATIONS,
    CoreStatus.INFEASIBLE: Status.INFEASIBLE,
    CoreStatus.NON_FINITE: Status.NON_FINITE,
    CoreStatus.STOPPED: Status.STOPPED,
    CoreStatus.UNBOUNDED: Status.UNBOUNDED,
}


class CoreSolver:
    """Solves a transcribed problem by the core; what it needs compiles once.

    Args:
        staged: the problem.
        parts: the problems of its phases.
        given: what it is solved for, for shapes.
        tolerance: of the first-order conditions, scaled.
    """

    def __init__(self, staged: Staged, parts: Sequence[Any], given: Given, tolerance: float) -> None:
        self.staged, self.tolerance, self._parts = staged, tolerance, parts
        self.transcribed = staged.transcribed
        self.busy = False  # whether it is in a solve
        self._by_updates = by_updates(parts)
        self.close_look = CloseLook(staged, parts, given)
        self.judge = Judge(self.close_look, staged)
        stages, border = staged.transcription.stages, staged.border
        self.largest_step = np.where(staged.turning, _TURN, np.inf)
        durations = stages.variables - stages.parameters + np.arange(border.phases)
        self.largest_step[durations] = -_CHANGE
        exists = self.transcribed.exists & ~self.transcribed.equality
        self._inequalities = max(1, int(exists.sum()))
        closer = self._closest = _EXACT * _CLOSER * tolerance * min(1.0, _FEW / self._inequalities) / COST
        self._exactly = {"tolerance": _CLOSER * tolerance / COST, "violation": _CLOSER * tolerance}
        self._exactly |= {"complementarity": closer, "gap": _CLOSER * tolerance, "acceptable": tolerance / COST}
        self._exactly |= {"row_relaxation": 0.0, "bound_relaxation": min(1e-8, closer)}
        #: What solvers of others made of the problem, by solver.
        self.made: dict[Any, Any] = {}

    def alone(self, given: Given) -> CoreSolver:
        """The same for another thread: kernels are shared, memory is not."""
        return CoreSolver(self.staged.alone(given), self._parts, given, self.tolerance)

    def units(self, point: Point, given: Given) -> StartUnits:
        """Units at a start."""
        self.staged.set_given(given)
        return StartUnits(self.staged, point, given.limits)

    def options(self, max_iterations: int) -> dict[str, float]:
        """Options of the core for a start that is no warm one."""
        return {**self._exactly, "iterations": max_iterations}

    def run(
        self, start: Point | WarmStart, given: Given, budget: Budget, used: Collection[Strategy] = tuple(Strategy)
    ) -> Outcome:
        """Solve from a start, with strategies."""
        return strategies.solved(self, start, given, budget, used)

    def moved(self, point: Point, step: Step) -> Point:
        """A point after a step."""
        z = moved(self.staged.transcription, self.staged.flat(point), self.staged.step(*step))
        return self.staged.point(z)

    def perturbed(self, point: Point, given: Given, rng: np.random.Generator) -> Point:
        """A point with every free entry of states, controls and border moved by a random step.

        The step is halved until gaps of the dynamics there are finite and no more than a few times those at the point:
        what is exponential in a state, as air is in a height, else makes starts that mean nothing.
        """
        staged, units, free = self.staged, self.units(point, given), self.transcribed.free
        z, scales = staged.flat(point), self.scales(units)
        d = np.where(self.transcribed.stirred, _MOVES[0] * rng.normal(size=free.d.shape) * scales.d, 0.0)
        u = np.where(free.u, _MOVES[1] * rng.normal(size=free.u.shape) * scales.u, 0.0)
        here, (low, high) = np.asarray(point.border), np.asarray(given.limits).T
        spread = np.minimum((high - low) / 6.0, _MOVES[0] * units.border)
        border = np.where(free.border, rng.normal(size=here.shape) * spread, 0.0)

        def gap(z: Array) -> float:
            found = np.abs(Evaluated(staged.transcription, z).c) / staged.after(units.v)
            return float(found.max(initial=0.0)) if np.isfinite(found).all() else np.inf

        most = _LOST * max(1.0, gap(z))
        for share in _SHARES:
            step = staged.step(share * d, share * u, np.clip(here + share * border, low, high) - here)
            found = moved(staged.transcription, z, step)
            if gap(found) <= most:
                break
        return staged.point(found)

    def run_once(
        self,
        start: Point | WarmStart,
        given: Given,
        max_iterations: int,
        budget: Budget | None = None,
        cost_floor: float = 0.0,
        as_stated: bool = False,
        rescaling: bool = True,
        **options: float,
    ) -> Outcome:
        """Solve from a start, in the units that it has."""
        point = _arrays(start.point if isinstance(start, WarmStart) else start)
        if isinstance(start, WarmStart) and start.units is not None and not as_stated:
            self.staged.set_given(given)
            units = copy.copy(start.units)
        else:
            units = self.units(point, given)
        units.cost = max(units.cost, cost_floor)
        if as_stated:
            units.become_one()
        chosen = self.options(max_iterations)
        call = functools.partial(self._call, point, given, units)
        violated = self.violated_at_once(point, given, units)
        if not np.isfinite(violated):
            return self.outcome(call({**chosen, "iterations": 0}), units, given, Status.NON_FINITE)
        if violated > self.tolerance:
            return self.outcome(call({**chosen, "iterations": 0}), units, given, Status.INFEASIBLE)
        watch = _Watch(budget or Budget(max_iterations))
        if not isinstance(start, WarmStart):
            fitted = _FITTED_AT if rescaling and not as_stated else ()
            return self._from_point(point, given, units, {**chosen, **options}, watch, fitted)
        warm, violated = self._warm(point, start.dynamics, start.rows, units)
        if violated <= self.tolerance:
            outcome = self._as_it_is(warm, point, given, units)
            if outcome.status is Status.SOLVED and outcome.errors.gap <= self.tolerance:
                return outcome
        closer = min(_CLOSER * self.tolerance, _NEAR * self._closest)
        near = {"complementarity": closer, **_near(violated)}
        kept = call({**chosen, **near, **options}, warm, watch)
        return self.outcome(kept, units, given)

    def measured(
        self, point: Point, dynamics: Array, rows: Array, given: Given, units: StartUnits | None = None
    ) -> Outcome:
        """How far a point with multipliers is from the conditions of an optimum, in units that fit it if None."""
        units = self.units(point, given) if units is None else units
        return self._as_it_is(self._warm(point, dynamics, rows, units)[0], point, given, units)

    def _as_it_is(self, warm: Solution, point: Point, given: Given, units: StartUnits) -> Outcome:
        """How far a warm start is from the conditions of an optimum."""
        kept = self._call(point, given, units, {**self._exactly, **_AS_IT_IS, "tolerance": self.tolerance}, warm)
        return self.outcome(kept, units, given, warm=True)

    def _from_point(
        self,
        point: Point,
        given: Given,
        units: StartUnits,
        options: dict[str, float],
        watch: _Watch,
        fitted: Sequence[int],
    ) -> Outcome:
        """A solve whose units are measured anew after some iterations: a guess may say little about them."""
        left = list(fitted)
        while True:
            fresh: StartUnits | None = None

            def is_misfit(iteration: int, z: Array, used: StartUnits = units) -> bool:
                nonlocal fresh, point
                if not left or iteration < left[0]:
                    return False
                del left[0]
                here = self.staged.point(z.copy())
                measured = StartUnits(self.staged, here, given.limits)
                if measured.distance(used) > np.log(_MISFIT):
                    fresh, point = measured, here
                return fresh is not None

            watch.also = is_misfit
            result = self._call(point, given, units, options, None, watch)
            watch.before += int(result.statistics["iterations"])
            if fresh is None:
                break
            options, units = {**options, "iterations": options["iterations"] - result.statistics["iterations"]}, fresh
        result.statistics["iterations"] = watch.before
        return self.outcome(result, units, given)

    def _call(
        self,
        point: Point,
        given: Given,
        units: StartUnits,
        options: dict[str, float],
        warm: Solution | None = None,
        watch: Watch | None = None,
    ) -> Solution:
        """One call of the core. Where its restoration alone comes to no end, iterations are left: no step helps."""
        staged, functions = self.staged, self.staged.transcription.functions
        if self._by_updates:
            functions = StageUpdates(staged.transcription, units.v, units.cost).functions
        result = solve(
            staged.transcription.stages,
            functions,
            *staged.limits(point, given),
            staged.flat(point),
            staged.coordinates(point),
            units=Units(units.v, units.rows, units.equalities, COST * units.cost),
            largest_step=self.largest_step,
            options=Options(**options),
            warm=warm,
            watch=watch,
        )
        if result.status is CoreStatus.MAX_ITERATIONS and result.statistics["iterations"] < options["iterations"]:
            result.status = CoreStatus.STALLED
        return result

    @property
    def is_decided(self) -> bool:
        """Whether ends alone decide a row."""
        return bool((self.transcribed.decided & ~self.transcribed.pinned).any())

    def violated_at_once(self, point: Point, given: Given, units: StartUnits) -> float:
        """The largest violation of rows that ends alone decide, in their sizes: no trajectory changes them."""
        own = self.transcribed
        if not self.is_decided:
            return 0.0
        rows = self.close_look.decided_rows(self.staged.flat(point), given)
        violated = np.where(own.equality, np.abs(rows), np.maximum(rows, 0.0)) / self.row_sizes(units)
        return float(np.where(own.decided & ~own.pinned, violated, 0.0).max(initial=0.0))

    def row_sizes(self, units: StartUnits) -> Array:
        """Of all rows; of one that is not in the core that of another of its name."""
        own = self.transcribed
        sizes = self.staged.all_rows(units.rows, units.equalities, units.v, units.v)
        for name in np.unique(own.names[(sizes <= 0.0) & own.decided].astype(str)):
            alike = own.names == name
            sizes[alike & (sizes <= 0.0)] = sizes[alike].max()
        return np.where(sizes > 0.0, sizes, 1.0)

    def _warm(self, point: Point, dynamics: Array, rows: Array, units: StartUnits) -> tuple[Solution, float]:
        """A warm start for the core, and the largest violation there in the core's units."""
        staged, stages = self.staged, self.staged.transcription.stages
        y, ye, zl, zu = staged.split_rows(np.asarray(rows))
        lam = np.concatenate([row[:count] for row, count in zip(np.asarray(dynamics), stages.after)])
        z, v = staged.flat(point), staged.coordinates(point)
        at = Evaluated(staged.transcription, z)
        parts = (at.c / staged.after(units.v), np.maximum(at.h, 0.0) / units.rows, at.e / units.equalities)
        violated = max(float(np.abs(a).max(initial=0.0)) for a in parts)
        none = np.zeros((0, 10))
        warm = Solution(CoreStatus.SOLVED, z, v, np.maximum(-at.h, 0.0), lam, y, ye, zl, zu, {}, none)
        return warm, violated

    # ---- what came out ----------------------------------------------------------------------------------------------

    @np.errstate(all="ignore")
    def outcome(
        self, result: Solution, units: StartUnits, given: Given, status: Status | None = None, warm: bool = False
    ) -> Outcome:
        """What came out; the status is that of the core unless it is known."""
        staged, own = self.staged, self.transcribed
        at = Evaluated(staged.transcription, result.z)
        point = staged.point(result.z)
        lower, upper = staged.limits(point, given)
        rows = staged.all_rows(at.h, at.e, lower - result.v, result.v - upper)
        w = staged.all_rows(result.y, result.ye, result.zl, result.zu)
        if own.decided.any():
            rows = np.where(own.decided, self.close_look.decided_rows(result.z, given), rows)
        sizes = self.row_sizes(units)
        inequality = own.exists & ~own.equality
        slack = np.where(inequality, np.maximum(-rows, 0.0), 1.0)
        scales = self.scales(units)._replace(rows=sizes)
        defects, dynamics = (self._padded(a) for a in (at.c, result.lam))
        violated = np.where(own.equality, np.abs(rows), np.maximum(rows, 0.0)) / sizes
        violated = np.where(own.exists | own.decided, violated, 0.0)
        gap = (np.abs(w) * np.where(inequality, slack, np.abs(rows)))[own.exists].sum()
        gap += np.abs(dynamics * defects).sum()
        numbers = result.statistics
        errors = Errors(
            numbers["stationarity"] * COST,
            numbers["violation"],
            numbers["complementarity"] * COST,
            float(gap / units.cost),
        )
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
            status=status or self._status(result, float(violated.max(initial=0.0)), errors),
            iterations=max(int(numbers["iterations"]), int(not warm)),
            saddle=result.status in (CoreStatus.SOLVED, CoreStatus.ACCEPTABLE) and not numbers["minimum"],
            units=units,
        )

    def _status(self, result: Solution, violated: float, errors: Errors) -> Status:
        """The core's status in the words of this package."""
        numbers = result.statistics
        if result.status is CoreStatus.SOLVED:
            return Status.SOLVED
        holds = numbers["violation"] <= self.tolerance and violated <= self.tolerance
        if holds and max(errors.stationarity, errors.complementarity, errors.gap) <= self.tolerance:
            return Status.SOLVED
        if result.status in _STATUS:
            return _STATUS[result.status]
        return Status.ACCEPTABLE if numbers["error"] <= _ACCEPTABLE * self.tolerance else Status.STALLED

    def _padded(self, flat: Array) -> Array:
        """Numbers of all defects as (intervals, n)."""
        own = self.transcribed
        found, at = np.zeros((own.intervals, own.n)), 0
        for stage, count in enumerate(self.staged.transcription.stages.after[:-1]):
            found[stage, :count] = flat[at : at + count]
            at += count
        return found

    def scales(self, units: StartUnits) -> Scales:
        """Units of all unknowns and of the objective; rows count as they are."""
        own = self.transcribed
        d, u = np.ones((own.nodes, own.n)), np.ones((own.intervals, own.m))
        for number, (part, sizes) in enumerate(zip(self.staged.parts, units.parts)):
            first, shooting = part.stages.start, part.shooting
            d[part.stages, : shooting.n] = sizes.d
            u[first : first + shooting.intervals, : shooting.m] = sizes.u
            if part.phase.join is not None:
                free = part.phase.join.free
                u[first + shooting.intervals, : len(free)] = units.parts[number + 1].d[free]
        return Scales(d, u, units.border, np.ones(len(own.exists)), np.asarray(units.cost))


def _near(violated: float) -> dict[str, float]:
    """Options that keep a start near: the further it is from holding, the higher its barrier."""
    barrier = float(np.clip(_WARM_SHARE * violated, _WARM_LEAST, _WARM_MOST))
    push = max(barrier, 1e-12) ** 0.5
    return {"barrier_start": barrier, "slack_push": min(push, 1e-2), "bound_push": min(push, 1e-2)}


class _Watch:
    """What is called before each iteration: Python sees signals there, and what a solve may take.

    Attributes:
        before: iterations before this call of the core.
        also: asked then, too; whether the core should stop.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget, self.before, self.also = budget, 0, lambda iteration, z: False

    def __call__(self, iteration: int, cost: float, violation: float, z: Array) -> bool:
        is_new = iteration > 0 or self.before == 0  # the first iterate in other units is the last one before
        return (is_new and self.budget.ends(self.before + iteration, cost, violation)) or self.also(iteration, z)


def _arrays(tree: Any) -> Any:
    """Points as NumPy arrays."""
    if isinstance(tree, Point):
        return Point(*(_arrays(a) for a in tree))
    if isinstance(tree, tuple):
        return tuple(map(_arrays, tree))
    return {name: np.asarray(a) for name, a in tree.items()} if isinstance(tree, dict) else np.asarray(tree)
