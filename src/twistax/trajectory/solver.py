"""The solver's loop: Newton steps, new scales, the search for feasible points where no step is, and what came out."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..lowering.array_call import array_call
from ..lowering.on_disk import compiled
from . import estimate, feasibility, scaling, warm
from .interior_point import InteriorPoint, largest
from .iterate import Errors, Scales
from .iterate import State as Iterate
from .program import Program
from .stride import Stride, no_slopes, stride
from .transcribed import Derivatives, Given, Point, Step, Transcribed, Values, jitted
from .warm import WarmStart
from .watch import RENEW, Status, Watch, error, row_violations

#: Called with (iterations so far, objective, largest violation) before every step.
Callback = Callable[[int, float, float], None]

Tree = TypeVar("Tree")

#: Unknowns of a stage up to which steps run as one kernel: beyond, products of matrices take XLA's threads.
_SMALL = 40
#: A result is acceptable within so many tolerances.
_ACCEPTABLE = 100.0
#: A feasible point is worth leaving the search for if it leaves so much of the violation and the filter does not know
#: better, or if it leaves so little.
_WORTH, _LITTLE = 0.5, 0.1
#: Of a search for feasible points: relative slope of a stationary point, its damping, and how often it starts anew.
_FLAT, _MOST_DAMPING, _SEARCHES = 1e-7, 1e12, 12
#: The least slack after such a search, and by how much a stationary point is shaken once, in scales.
_SLACK, _SHAKE = 1e-3, 0.1
#: Where multipliers have run away: the step aside from the start, in scales, for a run that begins anew.
_ASIDE = 0.01
#: Steps away from a solution that is no minimum, in scales: a longer one where the search comes back.
_AWAY = (0.1, 0.3, 1.0)
#: Random starts: how much larger than scales, or than those of the guess, gaps may be, and shares of steps to them.
_LOST, _SHARES = 30.0, tuple(0.5**k for k in range(11))
#: A solution that needs more than this on the diagonal, scaled, is no minimum; scales of entries of a vector may be
#: so far apart then.
_CURVED, _LEVEL = 1e-6, 10.0


class Outcome(NamedTuple):
    """Where a run of the solver ended."""

    point: Point
    values: Values
    errors: Errors
    dynamics: Array  # (intervals, n) multipliers in the problem's units
    rows: Array  # (rows,)
    scaled_rows: Array  # (rows,) multipliers, scaled
    slack: Array  # (rows,) in the problem's units
    violations: Array  # (intervals * n + rows,) scaled: of the dynamics, then of the rows
    scales: Scales
    status: Status
    iterations: int
    saddle: bool = False  # whether the objective falls to second order from there, and no search beside it found better

    @property
    def cost(self) -> float:
        return float(self.values.cost)

    @property
    def violation(self) -> float:
        return float(self.violations.max(initial=0.0))


class Solver:
    """Solves a transcribed problem again and again; what it needs compiles once.

    Attributes:
        probe, bent: a step from memory of the damping `probe` tries none, a third of it, then more; raised above `bent`
            the objective falls to second order along what the constraints leave free.
    """

    probe, bent = 3.0 * _CURVED, 1.5 * _CURVED

    def __init__(self, shooting: Transcribed, tolerance: float) -> None:
        self.shooting, self.tolerance = shooting, tolerance
        method = self.method = InteriorPoint(shooting, tolerance)
        self._move = shooting.moved
        self._start = jitted(method.start, 0)
        self._warm = jitted(lambda *args: warm.begin(method, *args), 0)
        own = functools.partial(stride, method, tolerance)
        size = shooting.n + shooting.m + shooting.border.size
        self._stride = jitted(functools.partial(array_call, own) if size <= _SMALL else own)
        self._none = no_slopes(shooting)
        self._rescaled = jitted(method.rescaled, 0)
        self._begin = jitted(lambda state: feasibility.begin(method, state), 0)
        self._reduce = jitted(lambda *args: feasibility.reduce(method, *args))
        self._judged = jitted(self._judge, 0)
        self._estimated = jitted(functools.partial(estimate.estimated, method))
        #: What solvers of others made of the problem, by solver.
        self.made: dict[Any, Any] = {}

    def prepare(self, point: Point, given: Given) -> None:
        """Compile what every run needs, side by side. Compiled functions do not care who calls them, as jit does."""
        unit = scaling.unit_scales(self.shooting)
        with ThreadPoolExecutor() as pool:

            def result(function: Any, level: int, *args: Any) -> Any:
                """The shapes of what a function gives; it is traced here and compiled in another thread."""
                program = function.trace(*args)
                jobs.append(pool.submit(compiled, program, program.lower(), level))
                return program.out_info

            jobs: list[Future[Any]] = []
            state = result(self._start, 0, point, given, unit)
            result(self._stride, 1, state, self._none, given, np.int64(0), np.float64(0.0))
            self._start, self._stride = (job.result() for job in jobs)

    def perturbed(self, point: Point, given: Given, rng: np.random.Generator) -> Point:
        """A point with every free entry of states, controls and border moved by a random step.

        The step is halved until gaps of the dynamics there are finite and no more than a few times those at the point:
        what is exponential in a state, as air is in a height, else makes starts that mean nothing.
        """
        scales, _ = self.first_scales(point, given)
        free = self.shooting.free
        d = np.where(self.shooting.stirred, 0.4 * rng.normal(size=free.d.shape) * scales.d, 0.0)
        u = 0.15 * rng.normal(size=free.u.shape) * scales.u
        here, (low, high) = np.asarray(point.border), np.asarray(given.limits).T
        spread = np.minimum((high - low) / 6.0, 0.4 * np.asarray(scales.border))
        border = np.where(free.border, rng.normal(size=here.shape) * spread, 0.0)
        gap = lambda at: float(largest(self._start(at, given, scales).values.defects / scales.d[1:]))  # noqa: E731
        most = _LOST * max(1.0, gap(point))
        for share in _SHARES:
            moves = np.clip(here + share * border, low, high) - here
            found = self._move(point, Step(share * d, share * u, moves))
            if gap(found) <= most:
                break
        return found

    def first_scales(self, point: Point, given: Given) -> tuple[Scales, Scales]:
        """Scales at a point, and the largest seen."""
        return self.scales_of(*self._first_look(point, given))

    def _first_look(self, point: Point, given: Given) -> tuple[Derivatives, Iterate]:
        """Derivatives at a point, second ones of the objective, and the state there in scales of 1."""
        state = self._start(point, given, scaling.unit_scales(self.shooting))
        return self._looked_at(unweighed(state), given)

    def scales_of(self, slopes: Derivatives, state: Iterate) -> tuple[Scales, Scales]:
        """Scales from derivatives at a state, with multipliers that are zero, and the largest seen."""
        gaps = np.asarray(state.values.defects)
        scales, sloped = scaling.measured(self.shooting, state.point, slopes, state.scales, gaps)
        return scales, scaling.not_below(scales, scales._replace(cost=np.zeros(())), sloped)[1]

    def run(
        self, start: Point | WarmStart, given: Given, max_iterations: int, callback: Callback | None = None
    ) -> Outcome:
        """Solve from a start; a solution that is no minimum is left."""
        search = lambda own, most, callback: self._run(own, given, most, callback)  # noqa: E731
        return self.to_minimum(search, start, given, max_iterations, callback)

    def to_minimum(
        self,
        search: Callable[[Any, int, Callback | None], tuple[Outcome, Iterate]],
        start: Point | WarmStart,
        given: Given,
        max_iterations: int,
        callback: Callback | None,
    ) -> Outcome:
        """What a search finds from a start; where that is no minimum, what it finds a random step away, if better.

        Args:
            search: gives the outcome from a start within so many iterations, and the state there.
        """
        found, state = search(start, max_iterations, callback)
        count, saddle = found.iterations, False
        later = None if callback is None else lambda own, *rest: callback(count + own, *rest)
        while found.status is Status.SOLVED and not saddle:
            levels = self.levels(state.scales)
            state = state if levels is None else self._rescaled(state, levels)
            if not self._bends_down(state, given):
                break
            saddle, lower = True, found.cost - self.tolerance * float(state.scales.cost)
            for size in _AWAY:
                if count >= max_iterations:
                    break
                other, there = search(self._step_away(state, size, alone=True), max_iterations - count, later)
                count += other.iterations
                if other.status in (Status.SOLVED, Status.UNBOUNDED) and other.cost < lower:
                    found, state, saddle = other, there, False
                    break
        return found._replace(iterations=count, saddle=saddle)

    def levels(self, scales: Scales) -> Scales | None:
        """Scales in which bends count along what hardly moves at a saddle, too; None if these are such scales."""
        found = scaling.levelled(self.shooting, scales)
        return found if scaling.change(found, scales) > _LEVEL else None

    def _bends_down(self, state: Iterate, given: Given) -> bool:
        """Whether the objective falls to second order along what the constraints leave free.

        Solvers of others end with slacks of zero: with their multipliers they make the barrier parameter at least.
        """
        own_slack, own_rows, barrier = (np.asarray(a) for a in (state.slack, state.rows, state.barrier))
        slack = np.maximum(own_slack, barrier / np.maximum(own_rows, np.sqrt(barrier)))
        slack = np.where(self.method.inequality, slack, own_slack)
        rows = np.where(self.method.inequality, np.maximum(own_rows, barrier / slack), own_rows)
        probed = state._replace(slack=slack, rows=rows, damping=np.float64(self.probe))
        return float(self._steps(probed, self._looked_at(state, given)[0], given).state.raised) > self.bent

    def _looked_at(self, state: Iterate, given: Given) -> tuple[Derivatives, Iterate]:
        """The derivatives at a state, and the state measured."""
        found = self._steps(state, self._none, given, 0)
        return found.slopes, found.state

    def _steps(self, state: Iterate, slopes: Derivatives, given: Given, most: int = 1, low: float = -np.inf) -> Stride:
        found: Stride = self._stride(state, slopes, given, np.int64(most), np.float64(low))
        return found

    def _begun(self, start: Point | WarmStart, given: Given) -> tuple[Iterate, Scales]:
        """The first state, and the largest scales seen."""
        if isinstance(start, WarmStart):
            return self._warm(start.point, start.dynamics, start.rows, start.scales, given), start.scales
        slopes, unit = self._first_look(start, given)
        scales, seen = self.scales_of(slopes, unit)
        return self._begun_in(scales, slopes, start, given), seen

    def _begun_in(self, scales: Scales, slopes: Derivatives, start: Point, given: Given) -> Iterate:
        """The first state in given scales, from what the first look there saw."""
        state = self._start(start, given, scales)
        if not estimate.is_bound(self.method, self.shooting.steered, state, slopes):
            slopes, state = self._looked_at(state, given)
            state = self._estimated(state, slopes)
        return state

    def _run(
        self, start: Point | WarmStart, given: Given, max_iterations: int, callback: Callback | None
    ) -> tuple[Outcome, Iterate]:
        state, seen = self._begun(start, given)
        watch = self.watch(seen, max_iterations)

        def ended(state: Iterate, status: Status) -> tuple[Outcome, Iterate]:
            return self.outcome(state, status, watch.count), state

        status = watch.at_once(_seen(state))
        if status is not None:
            return ended(state, status)
        slopes: Derivatives | None = None
        searches, rests, shaken, before = 0, 0, False, float(state.barrier)
        origin = None if isinstance(start, WarmStart) else start  # where a run that begins anew begins
        misled = False
        while True:
            if slopes is None:
                slopes, state = self._looked_at(state, given)
            here, known = _seen((state, slopes))
            fresh = watch.renewed(here, known, before)
            if fresh is not None and origin is not None and not misled and watch.misled(here, fresh):
                state = self._begun_in(fresh, self._first_look(origin, given)[0], origin, given)
                misled, before, slopes = True, np.inf, None
                watch.anew(fresh)
                continue
            if fresh is not None:
                slopes, state = self._looked_at(self._rescaled(state, fresh), given)
                here = _seen(state)
            status = watch.ended(here)
            if status is not None:
                return ended(state, status)
            if origin is not None and watch.astray(here):
                aside = self._step_away(self._begun(start, given)[0], _ASIDE, seed=watch.restarts)
                other, seen = self._begun(aside, given)
                if watch.at_once(_seen(other)) is None:
                    searches, shaken, before, origin, slopes, state = 0, False, np.inf, aside, None, other
                    watch.anew(seen)
                    continue
            if callback is not None:
                callback(watch.count, float(here.values.cost), float(here.errors.feasibility))
            if not watch.runs_off(here):
                taken = self._steps(state, slopes, given, watch.until() if callback is None else 1, watch.low)
                slopes, state, before = taken.slopes, taken.state, float(taken.before)
                watch.count += int(taken.count)
                if not bool(state.stuck):
                    continue
            searches, before, slopes = searches + 1, np.inf, None
            if searches > _SEARCHES and shaken:
                return ended(state, self._at_rest(state))
            if searches > _SEARCHES:
                searches, shaken, state = 0, True, self._shaken(state, given)
                continue
            state, used, rest = self._feasible(state, given, max_iterations - watch.count)
            watch.count += used
            rests += rest is not None
            if rest is not None and rests > 1:
                return ended(self._looked_at(state, given)[1], rest)
            if rest is not None:
                state = self._shaken(state, given)

    def _at_rest(self, state: Iterate) -> Status:
        """The status where no step does better."""
        return Status.ACCEPTABLE if error(state) <= _ACCEPTABLE * self.tolerance else Status.STALLED

    # ---- for solvers of others --------------------------------------------------------------------------------------

    def judged_at_rest(self, state: Iterate, given: Given, budget: int) -> tuple[Iterate, Status]:
        """The status where a solver does no better; INFEASIBLE where the violation comes to rest, and once more."""
        if self._at_rest(state) is Status.ACCEPTABLE:
            return state, Status.ACCEPTABLE
        here, rests = state, 0
        while budget > 0 and float(self._begin(here).largest) > self.tolerance:
            here, used, rest = self._feasible(here, given, budget)
            budget, rests = budget - used, rests + (rest is not None)
            if rest is Status.INFEASIBLE and rests > 1:
                return self._looked_at(here, given)[1], rest
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
        state = self._start(point, given, scales)
        inequality = self.method.inequality
        if rows is not None:
            values = self.method.scaled(state.values, scales)
            slack = jnp.where(inequality, jnp.maximum(-values.rows, 0.0), 1.0)
            rows = jnp.where(inequality, jnp.maximum(rows, 0.0), rows)
            state = state._replace(dynamics=jnp.asarray(dynamics), rows=jnp.asarray(rows), slack=slack)
        found: tuple[Derivatives, Iterate] = self._looked_at(state, given)
        return found

    def rescaled(self, state: Iterate, scales: Scales, given: Given) -> Iterate:
        """The state in other scales, its errors measured."""
        found: Iterate = self._looked_at(self._rescaled(state, scales), given)[1]
        return found

    # ---- a search for feasible points -------------------------------------------------------------------------------

    def _feasible(self, state: Iterate, given: Given, budget: int) -> tuple[Iterate, int, Status | None]:
        """A point that violates less; how many steps it took; INFEASIBLE or STALLED if no step helps.

        INFEASIBLE where the violation has no slope, in scales of that point; STALLED where it has, but no step helps.
        """
        search = self._begin(state)
        theta, _, _ = self._judged(state, search)
        count, rest, in_scale = 0, None, False
        while count < budget:
            slopes, _ = self._looked_at(feasibility.at(search, state), given)
            search = self._reduce(search, state, slopes, given)
            count += 1
            reached, known, _ = self._judged(state, search)
            if float(search.largest) <= 0.1 * self.tolerance:
                break
            if float(reached) <= (_LITTLE if bool(known) else _WORTH) * float(theta):
                break
            flat = float(search.slope) <= _FLAT * float(search.size) ** 0.5
            if flat and not in_scale:  # a slope may be small in scales that are far off
                in_scale, fresh = True, scaling.measured(self.shooting, search.point, slopes, state.scales)[0]
                if scaling.change(fresh, state.scales) > RENEW:
                    state = self._rescaled(state._replace(point=search.point, values=search.values), fresh)
                    search = self._begin(state)
                    theta = self._judged(state, search)[0]
                    continue
            if flat or float(search.damping) > _MOST_DAMPING:
                if float(search.largest) > self.tolerance:
                    rest = Status.INFEASIBLE if flat else Status.STALLED
                break
        _, _, slack = self._judged(state, search)
        rows = jnp.where(self.method.inequality, state.barrier / slack, 0.0)
        state = state._replace(
            point=search.point,
            values=search.values,
            slack=slack,
            dynamics=jnp.zeros_like(state.dynamics),
            rows=rows,
            filter=jnp.full_like(state.filter, jnp.inf),
            filtered=jnp.zeros_like(state.filtered),
        )
        return state, count, rest

    def _judge(self, state: Iterate, search: feasibility.Search) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Violation, whether the filter knows better, and slacks of a feasible point."""
        method = self.method
        values = method.scaled(search.values, state.scales)
        slack = jnp.where(method.inequality, jnp.maximum(-values.rows, _SLACK), 1.0)
        theta, phi = method.theta(values, slack), method.phi(values, slack, state.barrier)
        known = ((theta >= state.filter[0]) & (phi >= state.filter[1])).any()
        return theta, known, slack

    def _shaken(self, state: Iterate, given: Given) -> Iterate:
        """A start after a small random step, for a stationary point may be a saddle."""
        return self._begun(self._step_away(state), given)[0]

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

    def watch(self, seen: Scales, most: int) -> Watch:
        return Watch(self.shooting, self.tolerance, seen, most)

    def outcome(self, state: Iterate, status: Status, count: int) -> Outcome:
        scales, w = jax.tree.map(np.asarray, (state.scales, state.rows))
        defects = np.abs(np.asarray(state.values.defects) / scales.d[1:]).ravel()
        rows = np.where(self.shooting.exists | self.shooting.decided, row_violations(self.shooting, state), 0.0)
        return Outcome(
            point=state.point,
            values=state.values,
            errors=Errors(*(float(e) for e in state.errors)),
            dynamics=np.asarray(state.dynamics) * scales.cost / scales.d[1:],
            rows=np.where(self.shooting.exists, w * scales.cost / scales.rows, 0.0),
            scaled_rows=np.where(self.shooting.exists, w, 0.0),
            slack=np.asarray(state.slack) * scales.rows,
            violations=np.concatenate([defects, rows]),
            scales=scales,
            status=status,
            iterations=max(count, 1),
        )


def _seen(tree: Tree) -> Tree:
    """The same by NumPy, without a copy: a number of an array of JAX's takes several times as long to read."""
    found: Tree = jax.tree.map(np.asarray, tree)
    return found


def unweighed(state: Iterate) -> Iterate:
    """A state whose multipliers are zero: second derivatives are the objective's."""
    return state._replace(dynamics=np.zeros(state.dynamics.shape), rows=np.zeros(state.rows.shape))
