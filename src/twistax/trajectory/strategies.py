"""Strategies around a solver that goes to the nearest point that meets the first-order conditions.

Each uses the solver as it is, from another start or in other units.
"""

from __future__ import annotations

import enum, os
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from . import durations
from .budget import Budget
from .outcome import Outcome
from .transcribed import Given, Point, Step
from .warm import WarmStart
from .watch import AT_OPTIMUM, Status

if TYPE_CHECKING:
    from .core_solver import CoreSolver
    from .iterate import Scales
    from .start_units import StartUnits

#: A result whose errors are so many tolerances in units that fit it is left as it is.
_CLOSE = 10.0
#: Rounds in better units; no unit of the objective is a smaller share of the one before.
_ROUNDS, _SMALL = 10, 1e-6
#: So many tolerances of the objective are the error of a result.
_NOISE = 100.0
#: Where the unit of the objective was so many times too large, multipliers are worth nothing, too.
_USELESS = 1e3
#: Units of controls that are so many times as large, or as small, as those at a result were worth nothing.
_FAR = 1e3
#: Iterations that one run may take: those left of the default are for other strategies.
_MOST = 500
#: Where no step helps: steps aside from the start, in sizes, for other runs, and how many.
_ASIDE, _ASIDE_TIMES = 0.01, 2
#: Runs that end so may have been led there by durations that are free.
_AT_REST = (Status.INFEASIBLE, Status.STALLED, Status.MAX_ITERATIONS)
#: Steps away from a solution that is no minimum, in sizes: a longer one where the search comes back.
_AWAY = (0.1, 0.3, 1.0)


class Strategy(enum.Enum):
    """What `Problem.solve` does around the interior point method; all of them unless `strategies=` names some."""

    RESCALING = "scales are measured anew within a run, and the run is repeated where they do not fit its result"
    STATED_SCALES = "a run that fails is repeated in the units of the statement"
    PERTURBED_STARTS = "a run that fails is repeated from two starts beside its own"
    FIXED_DURATIONS = "where nothing else helps, free durations are fixed first"
    LEAVING_SADDLES = "a solution that is no minimum is left along random directions"
    IMPLICIT_STEPS = (
        "where explicit steps are unstable and no optimum comes out, the problem is solved by implicit ones"
    )


def solved(
    solver: CoreSolver,
    start: Point | WarmStart,
    given: Given,
    budget: Budget,
    strategies: Collection[Strategy] = tuple(Strategy),
) -> Outcome:
    """A solve from a start, in units that fit its result, at a minimum where one is near."""
    rescaling = Strategy.RESCALING in strategies

    def once(begin: Any, given: Given, floor: float = 0.0, as_stated: bool = False) -> Outcome:
        # What has no other strategy after it takes all.
        most = min(_MOST, budget.left) if strategies and isinstance(start, Point) else budget.left
        found = solver.run_once(begin, given, most, budget, cost_floor=floor, as_stated=as_stated, rescaling=rescaling)
        budget.used += min(found.iterations, most)
        return found._replace(status=budget.ended or found.status) if found.status is Status.STOPPED else found

    def fitting(begin: Any, given: Given) -> Outcome:
        return in_fitting_units(solver, once, begin, given) if rescaling else once(begin, given)

    def at_minimum(result: Outcome, given: Given) -> Outcome:
        if Strategy.LEAVING_SADDLES not in strategies:
            return result
        return at_a_minimum(solver, lambda other: fitting(other, given), result)

    def near(begin: Any, given: Given) -> Outcome:
        return at_minimum(fitting(begin, given), given)

    def may_repeat(strategy: Strategy) -> bool:
        return result.status in _AT_REST and not budget.is_spent and strategy in strategies

    result = near(start, given)
    at_once = result.status is Status.INFEASIBLE and result.iterations <= 1  # before the first step
    if at_once or not isinstance(start, Point):
        return result._replace(iterations=budget.used)
    if may_repeat(Strategy.STATED_SCALES):
        stated = once(start, given, as_stated=True)  # the units of a statement are often well chosen
        if stated.status in AT_OPTIMUM:
            result = at_minimum(stated, given)
    for seed in range(_ASIDE_TIMES):  # where no step helps, and nothing says that there is no trajectory
        if not may_repeat(Strategy.PERTURBED_STARTS):
            break
        other = near(_beside(solver, start, result.scales, _ASIDE, seed), given)
        if other.status in AT_OPTIMUM:
            result = other
    if (may_repeat(Strategy.FIXED_DURATIONS) or result.status is Status.NON_FINITE and Strategy.FIXED_DURATIONS in strategies) and not os.environ.get("NODUR"):
        other = start._replace(border=solver.units(start, given).durations)
        found = near(other, given)
        if found.status in AT_OPTIMUM: result = found
    if may_repeat(Strategy.FIXED_DURATIONS) and not os.environ.get("NOFIXED"):
        result = with_fixed_durations(solver, near, result, start, given, budget)
    return result._replace(iterations=budget.used)


def in_fitting_units(solver: CoreSolver, solve: Callable[..., Outcome], start: Any, given: Given) -> Outcome:
    """A solve whose objective counts in units that fit the result: those of a start may be worth nothing there.

    What it changes: an exponential of a state that is far away at the start has a unit of 1e21, in which any point is
    optimal.
    """
    result = solve(start, given)
    known = start.units if isinstance(start, WarmStart) and result.status is Status.SOLVED else None
    if known is not None and known.fit(solver.staged, result.point):  # those of an earlier result close by
        return result
    for _ in range(_ROUNDS):
        if result.status in (Status.NON_FINITE, Status.UNBOUNDED):
            break
        fresh, used = solver.units(result.point, given), result.scales
        floor = _SMALL * float(used.cost)
        ratio, far = float(used.cost) / max(fresh.cost, floor), _are_far(solver, fresh, used)
        error = max(result.errors.stationarity, result.errors.gap)
        if not far and (ratio <= 1.0 or (result.status in AT_OPTIMUM and ratio * error <= _CLOSE * solver.tolerance)):
            result = result._replace(units=fresh)  # for warm starts there
            break
        if result.status in AT_OPTIMUM:
            measured = solver.run_once(warm_at(result, given), given, 0)
            if measured.status in AT_OPTIMUM:
                result = measured._replace(iterations=result.iterations, saddle=result.saddle)
                break
        # Multipliers are worth something where the units were.
        near = ratio <= _USELESS and not far and result.status in AT_OPTIMUM
        again = solve(warm_at(result, given) if near else result.point, given, floor)
        if again.status not in AT_OPTIMUM or again.cost > result.cost + _NOISE * solver.tolerance * float(used.cost):
            break
        settled = abs(again.cost - result.cost) <= solver.tolerance * float(again.scales.cost)
        result = again
        if settled:
            break
    return result


def warm_at(result: Outcome, given: Given) -> WarmStart:
    """A start at a result."""
    return WarmStart(None, result.point, result.dynamics, result.rows, result.scales, given.params)


def _are_far(solver: CoreSolver, fresh: StartUnits, used: Scales) -> bool:
    """Whether units of states or controls are nothing beside those at a result, or far above."""
    known = solver.scales(fresh)
    ratios = [np.ravel(known.d / used.d)]
    for part, sizes in zip(solver.transcribed.segments, fresh.parts):
        columns = np.flatnonzero(sizes.steers)
        ratios.append(np.ravel((known.u / used.u)[part.stages][:, columns]))
    return bool((np.abs(np.log(np.concatenate(ratios))) > np.log(_FAR)).any())


def with_fixed_durations(
    solver: CoreSolver,
    solve: Callable[..., Outcome],
    rested: Outcome,
    start: Point,
    given: Given,
    budget: Budget,
) -> Outcome:
    """What runs find that begin with fixed durations; the earlier outcome if no such run succeeds.

    Where free durations lead a run astray, what is found with fixed ones still meets every constraint.
    """
    for point, fixed in durations.fixed(solver.staged.border, start, given):
        if budget.is_spent:
            break
        found = solve(point, fixed)
        if found.status is not Status.SOLVED or budget.is_spent:
            continue
        freed = solve(found.point, given)
        if freed.status is Status.SOLVED:
            return freed
    return rested


def at_a_minimum(solver: CoreSolver, solve: Callable[[Point], Outcome], result: Outcome) -> Outcome:
    """A result, or where the objective falls to second order from it what is found beside it, if that is better."""
    seed = 0
    while result.saddle and result.status in (Status.SOLVED, Status.ACCEPTABLE):
        better = None
        for size in _AWAY:
            other = solve(_beside(solver, result.point, result.scales, size, seed, alone=True))
            seed += 1
            lower = other.cost < result.cost - solver.tolerance * float(result.scales.cost)
            if lower and other.status in (Status.SOLVED, Status.UNBOUNDED):
                better = other
                break
        if better is None:
            break
        result = better
    return result


def _beside(solver: CoreSolver, point: Point, scales: Scales, size: float, seed: int, alone: bool = False) -> Point:
    """The point after a random step, of controls alone if it is to be so and where there are some."""
    rng, own = np.random.default_rng(seed), solver.transcribed
    u = np.where(own.free.u, size * rng.normal(size=own.free.u.shape) * scales.u, 0.0)
    d = np.where(own.stirred, size * rng.normal(size=own.free.d.shape) * scales.d, 0.0)
    if alone and own.free.u.any():
        d = np.zeros_like(d)
    return solver.moved(point, Step(d, u, np.zeros(own.border.size)))
