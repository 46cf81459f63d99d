"""Strategies in addition to a local solver, which converges to a nearby point that satisfies the first-order
conditions.

Each strategy runs the unmodified solver from another start or in other units.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from ..start_units import StartUnits
from ..transcription.iterate import Instance, Iterate
from . import other_starts
from .budget import Budget
from .core_solver import CoreSolver
from .outcome import Outcome, Scales
from .status import AT_OPTIMUM, Status
from .warm import WarmStart

#: The smallest ratio of the unit of the objective at the end of a run to the unit before.
_SMALL = 1e-6
#: A failed run is repeated from its end if a unit there has changed by more than this factor.
_FAR = 1e3
#: The iterations that one run may take, so that some of the default limit remain for other strategies.
_MOST = 500
#: If no step helps: sizes of random steps from the start of further runs, and the number of these runs.
_ASIDE, _ASIDE_TIMES = 0.01, 2
#: Exit statuses that free durations may have caused.
_AT_REST = {Status.INFEASIBLE, Status.STALLED, Status.MAX_ITERATIONS}
#: Runs with these exit statuses are accepted at an objective below that of a saddle; others only if they satisfy every
#: constraint.
_BETTER = (Status.SOLVED, Status.UNBOUNDED)
#: Sizes of steps away from a saddle point; a longer one follows if the search returns to the saddle.
_AWAY = (0.1, 0.3, 1.0)


class Strategy(enum.Enum):
    """Strategies of `Problem.solve` in addition to a single run of the interior-point method. By default all are used;
    `strategies=` selects some.
    """

    RESCALING = (
        "scales are computed again within a run and after a failed one, which is then repeated with its initial scales"
    )
    STATED_SCALES = "a failed run is repeated without scaling, in the units of the problem"
    PERTURBED_STARTS = "a failed run is repeated from two perturbed starts"
    FITTED_DURATIONS = "a failed run is repeated with durations that fit the limits of the controls"
    LEAVING_SADDLES = "a solution that is not a minimum is perturbed along random directions and solved again"
    IMPLICIT_STEPS = (
        "if explicit steps are unstable and the solve finds no optimum, the problem is solved by implicit steps"
    )
    LOWERED_RELAXATIONS = "complementarity constraints are relaxed at first, and less in each further solve"

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickles and copies use the name, because the sentences may change between versions."""
        return getattr, (type(self), self.name)


def solved(
    solver: CoreSolver,
    start: Iterate | WarmStart,
    instance: Instance,
    budget: Budget,
    strategies: Collection[Strategy] = tuple(Strategy),
) -> Outcome:
    """A solve from a start in suitable units, continued to a minimum if one is nearby."""
    return _Search(solver, budget, strategies, limited=bool(strategies) and isinstance(start, Iterate)).run(
        start, instance
    )


class _Search:
    """The runs of the solver from one start.

    Args:
        limited: whether each run must leave iterations for other strategies.
    """

    def __init__(self, solver: CoreSolver, budget: Budget, strategies: Collection[Strategy], *, limited: bool) -> None:
        self._solver, self._budget, self._strategies, self._limited = solver, budget, strategies, limited

    def run(self, start: Iterate | WarmStart, instance: Instance) -> Outcome:
        """Apply the strategies in turn until the search reaches an optimum."""
        result = self._near(start, instance)
        at_once = result.status is Status.INFEASIBLE and result.iterations <= 1  # called before the first step
        if at_once or isinstance(start, WarmStart):
            return dataclasses.replace(result, iterations=self._budget.used)
        if self._may_repeat(result, Strategy.FITTED_DURATIONS, _AT_REST | {Status.NON_FINITE}):
            result = self._at_fitted_durations(result, start, instance)
        repeats: dict[Strategy, dict[str, bool]] = {
            Strategy.STATED_SCALES: {"as_stated": True},  # the units of the statement are often well chosen
            Strategy.RESCALING: {"rescaling": False},  # the units at an iterate may be worse than those at its start
        }
        for strategy, options in repeats.items():
            if self._may_repeat(result, strategy):
                again = self._once(start, instance, **options)
                result = self._at_minimum(again, instance) if again.status in AT_OPTIMUM else result
        for seed in range(_ASIDE_TIMES):  # if the gradient of a row vanishes at the start, no step helps
            if self._may_repeat(result, Strategy.PERTURBED_STARTS):
                other = self._near(other_starts.beside(self._solver, start, result.scales, _ASIDE, seed), instance)
                result = other if other.status in AT_OPTIMUM else result
        return dataclasses.replace(result, iterations=self._budget.used)

    def _may_repeat(self, result: Outcome, strategy: Strategy, ends: Collection[Status] = _AT_REST) -> bool:
        return result.status in ends and not self._budget.is_spent and strategy in self._strategies

    def _once(
        self, start: Any, instance: Instance, floor: float = 0.0, rescaling: bool = True, **options: bool
    ) -> Outcome:
        budget = self._budget
        most = min(_MOST, budget.left) if self._limited else budget.left
        rescaling = rescaling and Strategy.RESCALING in self._strategies
        result = self._solver.run_once(start, instance, most, budget, cost_floor=floor, rescaling=rescaling, **options)
        budget.used += min(result.iterations, most)
        is_stopped = result.status is Status.STOPPED
        return dataclasses.replace(result, status=budget.ended or result.status) if is_stopped else result

    def _fitting(self, start: Any, instance: Instance) -> Outcome:
        """A run. If it fails, it continues from its end in the units measured there, provided that they differ much
        from those of its start.

        This helps, for example, if an exponential of a state that is far away at the start has a unit of 1e21.
        """
        result = self._once(start, instance)
        if not self._may_repeat(result, Strategy.RESCALING):
            return result
        fresh, used = self._solver.units(result.point, instance), result.scales
        floor = _SMALL * float(used.cost)
        if max(fresh.cost, floor) >= float(used.cost) and not _are_far(self._solver, fresh, used):
            return result
        again = self._once(result.point, instance, floor, is_guess=False)
        return again if again.status in AT_OPTIMUM else result

    def _at_minimum(self, result: Outcome, instance: Instance) -> Outcome:
        if Strategy.LEAVING_SADDLES not in self._strategies:
            return result
        solve = lambda start: self._fitting(start, instance)  # noqa: E731
        return at_a_minimum(self._solver, solve, result, lambda: self._budget.is_spent)

    def _near(self, start: Any, instance: Instance) -> Outcome:
        return self._at_minimum(self._fitting(start, instance), instance)

    def _at_fitted_durations(self, result: Outcome, start: Iterate, instance: Instance) -> Outcome:
        """The optimum from durations that fit the limited controls; the present result if there is none."""
        units = self._solver.units(start, instance, is_guess=True)
        durations = units.fitted_durations(self._solver.staged, start, instance.limits)
        if (durations == np.asarray(start.border)).all():
            return result
        other = self._near(start.with_border(durations), instance)
        return other if other.status in AT_OPTIMUM else result


def _are_far(solver: CoreSolver, fresh: StartUnits, used: Scales) -> bool:
    """Whether the units of states or controls differ from those at a result by a large factor."""
    known = solver.measure.scales(fresh)
    ratios = [np.ravel(known.d / used.d)]
    for part, sizes in zip(solver.transcribed.segments, fresh.parts):
        columns = np.flatnonzero(sizes.steers)
        ratios.append(np.ravel((known.u / used.u)[part.stages][:, columns]))
    return bool((np.abs(np.log(np.concatenate(ratios))) > np.log(_FAR)).any())


def at_a_minimum(
    solver: CoreSolver,
    solve: Callable[[Iterate], Outcome],
    result: Outcome,
    is_over: Callable[[], bool] = lambda: False,
) -> Outcome:
    """The result; or, if it is a saddle point, a better one that searches from perturbed points reach.

    Args:
        is_over: whether no further search may start.
    """
    seed = 0
    while result.saddle and result.status in (Status.SOLVED, Status.ACCEPTABLE):
        better = None
        for size in _AWAY:
            if is_over():
                break
            other = solve(other_starts.beside(solver, result.point, result.scales, size, seed, controls_alone=True))
            seed += 1
            lower = other.cost < result.cost - solver.tolerance * float(result.scales.cost)
            if lower and (
                other.status in _BETTER or (other.status in _AT_REST and other.violation <= solver.tolerance)
            ):
                better = other
                break
        if better is None:
            break
        result = better
    return result
