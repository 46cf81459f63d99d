"""The solver's loop: Newton steps, the search for feasible points where no step is, and what came out."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from . import durations, estimate, warm
from .decisions import Memory, Opening, error
from .interior_point import InteriorPoint, largest
from .iterate import Scales
from .iterate import State as Iterate
from .outcome import Callback, Outcome, Search, Searched, outcome, seen
from .program import Program
from .restoration import Restoration
from .steps import Steps
from .stride import Reached, Stride, ordered
from .transcribed import Derivatives, Given, Point, Step, Transcribed, jitted
from .warm import WarmStart
from .watch import Status, Watch

#: A result is acceptable within so many tolerances.
_ACCEPTABLE = 100.0
#: How often a search for feasible points starts anew, and by how much a stationary point is shaken once, in scales.
_SEARCHES, _SHAKE = 12, 0.1
#: Where multipliers have run away, or no step helps: the step aside from the start, in scales, for another run.
_ASIDE = 0.01
#: Runs that end so may have been led there by durations that are free.
_AT_REST = (Status.INFEASIBLE, Status.STALLED)
#: Steps away from a solution that is no minimum, in scales: a longer one where the search comes back.
_AWAY = (0.1, 0.3, 1.0)
#: Random starts: how much larger than scales, or than those of the guess, gaps may be, and shares of steps to them.
_LOST, _SHARES = 30.0, tuple(0.5**k for k in range(11))


@dataclasses.dataclass
class _Way:
    """The way of a run from one start."""

    origin: Point | None  # where it began, and where another may; None: nowhere
    state: Iterate
    memory: Memory
    slopes: Derivatives | None = None  # at the state, where they are known
    before: float = np.inf  # the barrier parameter before
    hasty: bool = False  # whether searches for feasible points that creep are left
    misled: bool = False  # whether its scales were worth nothing once
    searches: int = 0  # for feasible points, where steps led nowhere
    rests: int = 0  # how many of these came to rest
    shaken: bool = False


class Solver:
    """Solves a transcribed problem again and again; what it needs compiles once."""

    def __init__(self, shooting: Transcribed, tolerance: float) -> None:
        self.shooting, self.tolerance = shooting, tolerance
        method = self.method = InteriorPoint(shooting, tolerance)
        self.steps = Steps(shooting, method, tolerance)
        self._move = shooting.moved
        self._warm = jitted(lambda *args: warm.begin(method, *args), 0)
        self.restoration = Restoration(method, self.steps, tolerance)
        self._estimated = jitted(functools.partial(estimate.estimated, method))
        #: What solvers of others made of the problem, by solver.
        self.made: dict[Any, Any] = {}

    def perturbed(self, point: Point, given: Given, rng: np.random.Generator) -> Point:
        """A point with every free entry of states, controls and border moved by a random step.

        The step is halved until gaps of the dynamics there are finite and no more than a few times those at the point:
        what is exponential in a state, as air is in a height, else makes starts that mean nothing.
        """
        scales = jax.tree.map(np.asarray, self.steps.opened(point, given).state.scales)
        free = self.shooting.free
        d = np.where(self.shooting.stirred, 0.4 * rng.normal(size=free.d.shape) * scales.d, 0.0)
        u = 0.15 * rng.normal(size=free.u.shape) * scales.u
        here, (low, high) = np.asarray(point.border), np.asarray(given.limits).T
        spread = np.minimum((high - low) / 6.0, 0.4 * np.asarray(scales.border))
        border = np.where(free.border, rng.normal(size=here.shape) * spread, 0.0)
        gap = lambda at: float(largest(self.steps.start(at, given, scales).values.defects / scales.d[1:]))  # noqa: E731
        most = _LOST * max(1.0, gap(point))
        for share in _SHARES:
            moves = np.clip(here + share * border, low, high) - here
            found = self._move(point, Step(share * d, share * u, moves))
            if gap(found) <= most:
                break
        return found

    def run(
        self,
        start: Point | WarmStart,
        given: Given,
        max_iterations: int,
        callback: Callback | None = None,
        reached: Reached | None = None,
    ) -> Outcome:
        """Solve from a start; a solution that is no minimum is left.

        Args:
            reached: how far the run has come already.
        """

        found = self.to_minimum(self._searches(start, given, reached), start, given, max_iterations, callback)
        if isinstance(start, WarmStart) or found.status not in _AT_REST or self._is_decided(found):
            return found
        return self._with_fixed_durations(found, start, given, max_iterations, callback)

    def _searches(self, start: Any, given: Given, reached: Reached | None = None) -> Search:
        """Runs from anywhere; from a start they go on from where it has come to, if it has."""

        def search(own: Any, most: int, callback: Callback | None) -> Searched:
            if isinstance(own, Reached):  # on from where it crept
                return self._run(start, given, most, callback, own)
            return self._run(own, given, most, callback, reached if own is start else None)

        return search

    def _is_decided(self, found: Outcome) -> bool:
        """Whether rows that others decide are violated: no trajectory changes them."""
        rows = found.violations[self.shooting.intervals * self.shooting.n :]
        return bool(np.where(self.shooting.decided, rows, 0.0).max(initial=0.0) > self.tolerance)

    def _with_fixed_durations(
        self, rested: Outcome, start: Point, given: Given, max_iterations: int, callback: Callback | None
    ) -> Outcome:
        """The outcome of runs that begin with fixed durations; the earlier one if no such run succeeds.

        Where free durations lead all of them astray, what was found with fixed ones still meets every constraint.
        """
        count, others = rested.iterations, list[Outcome]()
        later = None if callback is None else lambda own, *rest: callback(count + own, *rest)
        for point, held in durations.fixed(self.shooting.border, start, given):
            most = (max_iterations - count) // 3
            if most <= 0:
                break
            found, state, _ = self._run(point, held, most, later)
            count += found.iterations
            if found.status is not Status.SOLVED:
                continue
            freed = self.weighed(state.point, given, state.scales, state.dynamics, state.rows)[1]
            others.append(outcome(self.shooting, freed, Status.STALLED, count))
            if count < max_iterations:
                begin, most = found.point, max_iterations - count
                others.append(self.to_minimum(self._searches(begin, given), begin, given, most, later))
                count += others[-1].iterations
            if others[-1].status is Status.SOLVED or count >= max_iterations:
                break
        best = self._best(rested, others)
        if others and count >= max_iterations and best.status is Status.STALLED:
            best = best._replace(status=Status.MAX_ITERATIONS)
        return best._replace(iterations=count)

    def _best(self, first: Outcome, others: Sequence[Outcome]) -> Outcome:
        """The best outcome that meets every constraint: solved, acceptable, of least cost; the first if none does."""

        def rank(own: Outcome) -> tuple[int, float]:
            best = [Status.SOLVED, Status.ACCEPTABLE]
            return (best.index(own.status), 0.0) if own.status in best else (len(best), own.cost)

        no = (Status.INFEASIBLE, Status.NON_FINITE)
        known = [own for own in (first, *others) if own.violation <= self.tolerance and own.status not in no]
        return min(known, key=rank, default=first)

    def to_minimum(
        self,
        search: Search,
        start: Point | WarmStart,
        given: Given,
        max_iterations: int,
        callback: Callback | None,
    ) -> Outcome:
        """What a search finds from a start; where that is no minimum, what it finds a random step away, if better.

        What is better and meets every constraint counts even where its search came to no end.

        Args:
            search: what it finds from a start, or from where it crept, within so many iterations; the state there; and
                how far it came where it creeps along what seems to be a saddle.
        """
        found, state, crept = search(start, max_iterations, callback)
        count, seed, saddle = found.iterations, 0, False
        later = None if callback is None else lambda own, *rest: callback(count + own, *rest)
        while crept is not None or self.falls(found, state, given):
            levelled = self.steps.levelled(state)
            lower, better = found.cost - self.tolerance * float(levelled.scales.cost), None
            unfinished = list[Outcome]()
            # Where it crept enough is left to go on from there.
            share = (max_iterations - count) // (1 if crept is None else len(_AWAY) + 1)
            for size in _AWAY:
                most = min(share, max_iterations - count)
                if most <= 0:
                    break
                other = search(self._step_away(levelled, size, alone=True, seed=seed), most, later)
                count, seed = count + other.outcome.iterations, seed + 1
                if not other.outcome.cost < lower:
                    continue
                if other.outcome.status in (Status.SOLVED, Status.UNBOUNDED):
                    better = other
                    break
                if other.outcome.violation <= self.tolerance and other.outcome.status is not Status.NON_FINITE:
                    unfinished.append(other.outcome)
            if better is not None:
                found, state, crept = better
                continue
            saddle = True
            if crept is not None:
                count -= crept.iterations  # it counts them itself
                found, state, _ = search(crept.patient(), max_iterations - count, later)
                count, saddle = count + found.iterations, self.falls(found, state, given)
            lowest = min(unfinished, key=lambda own: own.cost, default=found)
            if lowest.cost < found.cost and (saddle or found.status is not Status.SOLVED):
                found, saddle = lowest, False
            break
        return found._replace(iterations=count, saddle=saddle)

    def falls(self, found: Outcome, state: Iterate, given: Given) -> bool:
        """Whether the objective falls to second order along what the constraints leave free, from a solution."""
        return found.status is Status.SOLVED and self.steps.raised(state, given) > self.steps.bent

    def _begun(self, start: Point | WarmStart, given: Given) -> Opening:
        if isinstance(start, WarmStart):
            state = self._warm(start.point, start.dynamics, start.rows, start.scales, given)
            found: Opening = self.steps.opening(state, start.scales)
            return found
        opening = self.steps.opened(start, given)
        return opening._replace(state=self._weighed_first(opening.state, opening.bound, given))

    def _weighed_first(self, state: Iterate, bound: Any, given: Given) -> Iterate:
        """A first state, with multipliers by least squares where limits and costs do not say how far controls go."""
        if bool(bound):
            return state
        slopes, state = self.steps.looked_at(state, given)
        found: Iterate = self._estimated(state, slopes)
        return found

    def _run(
        self,
        start: Point | WarmStart,
        given: Given,
        max_iterations: int,
        callback: Callback | None,
        reached: Reached | None = None,
    ) -> Searched:
        origin, status = None if isinstance(start, WarmStart) else start, None
        if reached is None:
            watch, opening = Watch(self.tolerance, max_iterations), self._begun(start, given)
            way = _Way(origin, opening.state, opening.memory, before=float(opening.state.barrier))
            status = watch.at_once(opening)
        else:
            watch = Watch(self.tolerance, max_iterations, reached.iterations, reached.restarts)
            way = _Way(origin, reached.last.state, reached.last.memory)
        way.hasty = origin is not None and watch.hasty
        while status is None:
            if reached is None:
                taken = self._steps(way, given, watch, callback is not None)
            else:
                taken, reached = reached.last, None
            way.slopes, way.state, way.memory, signs = taken.slopes, taken.state, taken.memory, seen(taken.signs)
            if way.origin is not None and bool(taken.worthless):
                way = self._in_better_scales(way, way.origin, given)
                continue
            if not bool(way.state.stuck):
                status = watch.ended(signs)
                if status is not None:
                    break
                if watch.astray(signs) and (another := self._anew(way, start, given, watch)) is not None:
                    watch.again(astray=True)
                    way = another
                    continue
                if bool(signs.creeps):
                    crept = Reached(taken, watch.count, watch.restarts)
                    return Searched(outcome(self.shooting, way.state, Status.STALLED, watch.count), way.state, crept)
                if callback is not None:
                    callback(watch.count, float(way.state.values.cost), float(way.state.errors.feasibility))
                if not signs.far and not signs.jams:
                    continue
            jammed = bool(signs.jams) and not bool(way.state.stuck)
            end = self._to_feasible(way, jammed, given, max_iterations, watch)
            if end is None:
                continue
            if watch.lost(end) and (another := self._anew(way, start, given, watch)) is not None:
                watch.again(astray=False)
                way = another
            elif end is Status.STALLED and way.hasty:  # with more steps there may be a point, or a certificate
                way.hasty = False
            else:
                status = end
        return Searched(outcome(self.shooting, way.state, status, watch.count), way.state, None)

    def _steps(self, way: _Way, given: Given, watch: Watch, one: bool) -> Stride:
        """The next steps of a way: one if it is to be, or as many as there is patience for."""
        most = int(way.slopes is not None) if one else watch.until()
        may_begin_anew = way.origin is not None and not way.misled
        orders = ordered(way.slopes is None, True, may_begin_anew, most, watch.count, way.before)
        slopes = self.steps.no_slopes if way.slopes is None else way.slopes
        taken = self.steps.steps(way.state, slopes, given, orders, way.memory)
        watch.count += int(taken.count)
        return taken

    def _in_better_scales(self, way: _Way, origin: Point, given: Given) -> _Way:
        """The way from the same start, in the scales that are due."""
        fresh = self.steps.renewed(way.state, way.slopes, way.memory)[0]
        state, bound = self.steps.begun_in(fresh, origin, given)
        memory = self.steps.opening(state, fresh).memory
        return _Way(origin, self._weighed_first(state, bound, given), memory, hasty=way.hasty, misled=True)

    def _anew(self, way: _Way, start: Any, given: Given, watch: Watch) -> _Way | None:
        """A way from a point beside the start; None if a run may not begin anew, or would end at once."""
        if way.origin is None:
            return None
        aside = self._step_away(self._begun(start, given).state, _ASIDE, seed=sum(watch.restarts))
        found = self._begun(aside, given)
        if watch.at_once(found) is not None:
            return None
        memory = found.memory._replace(creeping=np.minimum(np.asarray(way.memory.creeping), 0))  # patience stays
        return _Way(aside, found.state, memory, hasty=watch.hasty)

    def _to_feasible(self, way: _Way, jammed: bool, given: Given, most: int, watch: Watch) -> Status | None:
        """Lead a way on from a point that violates less, or from a random step aside.

        Returns:
            The status that it ends with; None if it goes on.
        """
        way.memory = way.memory._replace(jammed=np.zeros((), int))
        way.slopes, way.before = None, np.inf
        way.searches += not jammed  # else it has come some steps since the last one
        if way.searches > _SEARCHES:
            if way.shaken:
                return self._at_rest(way.state)
            way.searches, way.shaken, way.state = 0, True, self._shaken(way.state, given)
            return None
        way.state, used, rest = self.restoration.found(way.state, given, most - watch.count, way.hasty)
        watch.count += used
        way.rests += rest is not None
        if rest is not None and (way.rests > 1 or (way.hasty and rest is Status.STALLED)):
            way.state = self.steps.looked_at(way.state, given)[1]
            return rest
        if rest is not None:
            way.state = self._shaken(way.state, given)
        return None

    def _at_rest(self, state: Iterate) -> Status:
        """The status where no step does better."""
        return Status.ACCEPTABLE if error(state) <= _ACCEPTABLE * self.tolerance else Status.STALLED

    # ---- for solvers of others --------------------------------------------------------------------------------------

    def judged_at_rest(self, state: Iterate, given: Given, budget: int) -> tuple[Iterate, Status]:
        """The status where a solver does no better; INFEASIBLE where the violation comes to rest, and once more."""
        if self._at_rest(state) is Status.ACCEPTABLE:
            return state, Status.ACCEPTABLE
        here, rests = state, 0
        while budget > 0 and self.restoration.violation(here) > self.tolerance:
            here, used, rest = self.restoration.found(here, given, budget)
            budget, rests = budget - used, rests + (rest is not None)
            if rest is Status.INFEASIBLE and rests > 1:
                return self.steps.looked_at(here, given)[1], rest
            if rest is not None and rests > 1:
                break
            if rest is not None:
                here = self._shaken(here, given)
        return state, Status.STALLED

    def program(self, with_copies: bool) -> Program:
        """The problem as a nonlinear program."""
        return Program(self.shooting, self.method, with_copies=with_copies)

    def weighed(
        self, point: Point, given: Given, scales: Scales, dynamics: Any = 0.0, rows: Any = None
    ) -> tuple[Derivatives, Iterate]:
        """Derivatives at a point, and the state there with scaled multipliers, its errors measured."""
        state = self.steps.start(point, given, scales)
        inequality = self.method.inequality
        if rows is not None:
            values = self.method.scaled(state.values, scales)
            slack = jnp.where(inequality, jnp.maximum(-values.rows, 0.0), 1.0)
            rows = jnp.where(inequality, jnp.maximum(rows, 0.0), rows)
            state = state._replace(dynamics=jnp.asarray(dynamics), rows=jnp.asarray(rows), slack=slack)
        found: tuple[Derivatives, Iterate] = self.steps.looked_at(state, given)
        return found

    def rescaled(self, state: Iterate, scales: Scales, given: Given) -> Iterate:
        """The state in other scales, its errors measured."""
        found: Iterate = self.steps.looked_at(self.steps.rescaled(state, scales), given)[1]
        return found

    # ---- starts beside ----------------------------------------------------------------------------------------------

    def _shaken(self, state: Iterate, given: Given) -> Iterate:
        """A start after a small random step, for a stationary point may be a saddle."""
        return self._begun(self._step_away(state), given).state

    def _step_away(self, state: Iterate, size: float = _SHAKE, alone: bool = False, seed: int = 0) -> Point:
        """The point after a random step.

        Args:
            size: of the step, in scales.
            alone: of controls alone where there are some. Levelled scales of states can be steps of any size: an entry
                of 1 beside one of 1e3 would move by 100.
        """
        rng, free, scales = np.random.default_rng(seed), self.shooting.free, jax.tree.map(np.asarray, state.scales)
        d = np.where(self.shooting.stirred, size * rng.normal(size=free.d.shape) * scales.d, 0.0)
        u = size * rng.normal(size=free.u.shape) * scales.u
        if alone and free.u.any():
            d = np.zeros_like(d)
        return self._move(state.point, Step(d, u, np.zeros_like(scales.border)))
