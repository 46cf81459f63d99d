"""How problems of one phase and of several are solved: once or many times, from guesses or warm."""

from __future__ import annotations

import dataclasses
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import numpy as np
from numpy import ndarray as Array

from ..checks import callable_with, number, short, whole
from ..errors import TrajectoryError
from ..jax_inside import in_double
from ..scalar.walk import uncollected
from .accuracy import MESH
from .between import held
from .border import Border
from .budget import Budget
from .cases import Cases, prepared
from .core_solver import CoreSolver
from .external import SolvedBy
from .found import Tried
from .hessians import by_updates
from .many import solve_all
from .mesh import Remeshed
from .outcome import Callback, Outcome
from .redundant_rows import redundant_rows
from .refine import refined
from .staged import Staged
from .stiff import IMPLICIT, IMPLICIT_NAME, LARGEST, stiffness
from .strategies import Strategy
from .transcribed import Given, Point, Transcribed
from .undetermined import Undetermined, undetermined
from .warm import WarmStart, warm_start, with_ends
from .watch import AT_OPTIMUM, Status

#: The solver's tolerance over that of a refinement.
CLOSER = 0.1

#: The tolerance of a solver that only looks at solutions.
_LOOKED_AT = 1e-6

#: Threads that solve one problem make its first solver once: that decides which rows there are.
_MAKING = threading.RLock()

One = TypeVar("One")
Many = TypeVar("Many")


class Started(NamedTuple):
    """What the arguments of a solve amount to: where it starts, what it is for, its parameters and ends."""

    point: Point
    given: Given
    params: dict[str, Array]
    ends: Any


class Solvable(ABC, Generic[One, Many]):
    """A problem that can be solved.

    Attributes:
        shooting: the discrete problem.
        border: the unknowns that all stages share.
        params: all parameters.
    """

    shooting: Transcribed
    border: Border
    params: dict[str, Array]

    @property
    @abstractmethod
    def parts(self) -> Sequence[Any]:
        """The problem of each phase."""

    @property
    @abstractmethod
    def sign(self) -> float:
        """1 where less is better, -1 where more is."""

    @abstractmethod
    def started(
        self,
        guess: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        params: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        final_time_guess: Any = None,
        free: Mapping[Any, Any] | None = None,
        sizes: Sequence[Mapping[str, Array]] | None = None,
        begin: Point | None = None,
    ) -> Started:
        """What `solve` with these arguments starts from and is for; NumPy's arrays of double precision.

        Args:
            begin: where it starts, in place of guesses.
            sizes: of the controls of each part, by name, for bounds of what is zero at the start.
        """

    @abstractmethod
    def at_ends(self, xs: Any, ends: Any) -> Any:
        """States at the nodes with what ends fix in place.

        Raises:
            TrajectoryError: they are those of another problem.
        """

    @abstractmethod
    def axes(self) -> dict[str, Any]:
        """How many axes each argument of `started` has, in dicts as the arguments are."""

    @abstractmethod
    def result(self, tried: Tried) -> One:
        """The best of several tries."""

    @abstractmethod
    def on(self, meshes: Sequence[Remeshed]) -> Any:
        """The same problem on other meshes, one for each phase, without a guess."""

    @abstractmethod
    def transcribed_by(self, transcription: Any) -> Any:
        """The same problem, its phases integrated in another way."""

    @abstractmethod
    def results(self, tried: Sequence[Tried]) -> Many:
        """The results of many cases."""

    def built(self) -> None:
        """Forget what was compiled."""
        self._cores: dict[tuple[float, int, int], CoreSolver] = {}
        self._implicit: Any = None

    def solve(
        self,
        guess: Mapping[Any, Any] | None = None,
        *,
        warm: Any = None,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        params: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        final_time_guess: Any = None,
        free: Mapping[Any, Any] | None = None,
        guesses: int = 1,
        seed: int | None = None,
        callback: Callback | None = None,
        max_iterations: int = 1000,
        max_seconds: float | None = None,
        tolerance: float = 1e-6,
        solver: Any = None,
        between: float | None = None,
        refine: Any = None,
        mesh_tolerance: float = MESH,
        strategies: Collection[Any] = tuple(Strategy),
    ) -> One:
        """Optimise, from one guess or from several, and return the best result.

        The first call compiles, later ones do not. Neither do problems that differ in numbers or nodes alone from one
        that was solved before: numbers in expressions are arguments of the compiled functions. What changes the
        structure compiles anew: a zero, a factor of one, an exponent or a table. Several threads may solve one problem
        at once.

        Where explicit steps are unstable and no optimum comes out, the problem is solved by collocation with Radau IIA
        of order 5, and the message says so; `result.problem` is the one that was solved.

        In a problem of phases guess, initial, final, final_time and final_time_guess are dicts from names of phases to
        what is said here; those left out keep what they have.

        Args:
            guess: values by leaf or name on top of the problem's own guess.
            warm: start from a result, or from what its `shifted` gives, instead of a guess: with its multipliers, its
                scales, and a barrier that fits how far it is from what is asked now.
            initial, final: values by state or name in place of the problem's own. The same entries are fixed.
            params: values of parameters, by leaf or name, in place of the problem's own.
            free: other limits of free parameters, by leaf or name; the same sides stay open.
            final_time: a number where the problem has one, limits where it has limits.
            final_time_guess: where a free final time starts.
            guesses: how many tries. Without a seed the first starts from the guess itself, or from `warm`; the others
                start from the perturbed guess.
            seed: perturb every try's guess. The same seed gives the same tries: every free entry of a state's tangent
                moves by 0.4 of its scale and every control by 0.15 (one standard deviation), a free final time and free
                parameters by 0.4 of their scale, which is the guess of a time, but by a sixth of their limits' distance
                at most (and stay within them). All of it is halved until no gap of the dynamics is thirty times as
                large as its scale, and as the guess's gaps.
            callback: called with (iteration, cost, violation) before each step. Where it returns True the search ends
                with status STOPPED, and the result is the iterate with the smallest error, with its measures.
                `IPOPT` and `Fatrop` call it and go on.
            max_iterations: iterations a try may use.
            max_seconds: wall time after which the search ends with status OUT_OF_TIME, and the same iterate; the look
                at the mesh comes after it. `IPOPT` and `Fatrop` have one of their own.
            tolerance: how far, in scaled form, the first-order conditions may be from holding.
            solver: the solver of others that is to solve, `tx.trajectory.IPOPT()` or `tx.trajectory.Fatrop()`; the
                interior point of this package if left out.
            between: how far limits may be exceeded along a dense rollout, in their scales, such as 1e-6. They are
                tightened where it exceeds them, and the problem is solved again, warm. Left out they hold where they
                are asked.
            mesh_tolerance: the largest error of the mesh that a SOLVED result has; beyond it the status is COARSE. Each
                interval, integrated closely again from its planned start, ends within this of its planned end, in
                scales of the states, and the objective is off by this share at most: see `result.accuracy`. An infinite
                one takes any mesh, as a controller that solves again at every step may want it.
            refine: make the mesh finer until each interval, integrated closely again from its planned start, ends
                within this of its planned end, in scales of the states, and the objective changes by no more than this,
                relative, from a mesh to the next, such as 1e-6. The result stands on the last mesh, `result.problem`;
                `result.meshes` has all of them. Finer meshes compile nothing. The status is COARSE, too, where a
                thousand nodes are not enough.
            strategies: what is done around the interior point method, members of `Strategy`; an empty tuple leaves the
                method alone. Solvers of others have some of their own.

        Raises:
            ModelError, ShapeError, InputError: a guess, an end or a parameter that does not fit.
            TrajectoryError: other entries fixed, times or numbers without meaning; limits of a parameter that is not
                free, or on other sides; a warm start of another problem, or beside a guess.
        """
        whole("guesses", guesses, 1, TrajectoryError)
        given_too = {"guess": guess, "final_time_guess": final_time_guess, "seed": seed}
        if warm is not None and any(value is not None for value in given_too.values()):
            names = ", ".join(name for name, value in given_too.items() if value is not None)
            raise TrajectoryError(f"solve: warm is a start already; leave out {names}")
        check_options(max_iterations, tolerance)
        if refine is not None:
            number("refine", refine, "above zero and below 1", lambda size: 0.0 < size < 1.0, TrajectoryError)
            tolerance = min(tolerance, CLOSER * refine)
        if between is not None:
            number("between", between, "above zero and below 1", lambda size: 0.0 < size < 1.0, TrajectoryError)
        check_mesh_tolerance(mesh_tolerance)
        if seed is not None:
            whole("seed", seed, 0, TrajectoryError)
        if solver is not None and (isinstance(solver, type) or not isinstance(solver, SolvedBy)):
            raise TrajectoryError(
                f"solver expects tx.trajectory.IPOPT() or tx.trajectory.Fatrop(), or nothing, got {solver!r}"
            )
        if solver is not None and by_updates(self.parts):
            raise TrajectoryError(
                f"QuasiNewton() has no second derivatives for {solver!r}.\n  fix: leave out hessian= or solver="
            )
        if callback is not None:
            callable_with("callback", callback, ["iteration", "cost", "violation"], TrajectoryError)
        sign = self.sign
        report: Callback | None = None
        if callback is not None:
            report = lambda count, cost, violation: callback(count, sign * cost, violation)  # noqa: E731
        for strategy in strategies if isinstance(strategies, Collection) else [strategies]:
            if not isinstance(strategy, Strategy):
                raise TrajectoryError(
                    f"strategies expects members of tx.trajectory.Strategy in a tuple, got {short(strategies)}"
                )
        if max_seconds is not None:
            number("max_seconds", max_seconds, "above zero", lambda size: size > 0.0, TrajectoryError)
            if solver is not None:
                raise TrajectoryError(f"max_seconds: give it to the solver, {type(solver).__name__}(max_seconds=...)")
        budget = Budget(max_iterations, max_seconds, report)
        with in_double():
            begin = time.perf_counter()
            arguments = (guess, initial, final, params, final_time, final_time_guess, free)
            known = None if warm is None else warm_start(warm)
            alone = None if known is None or guesses > 1 else known.point
            plain, given, own, ends = self.started(*arguments, begin=alone)
            warmed = None if known is None else with_ends(known, self, ends, given)
            core = self._core(float(tolerance), plain, given)
            if self._is_bounded and (warm is None or guesses > 1):
                plain = self.started(*arguments, self._sizes(core, plain, given)).point
            first = plain if warmed is None else warmed
            compiled = time.perf_counter()
            outcomes = []

            def run(start: Point | WarmStart, given: Given) -> Outcome:
                core.busy = True  # what a callback solves or looks at has another solver
                try:
                    if solver is None:
                        budget.used = 0
                        return core.run(start, given, budget, strategies)
                    found: Outcome = solver.run(core, start, given, max_iterations, report)
                    return found
                finally:
                    core.busy = False

            for attempt in range(guesses):
                if budget.ended is not None:
                    break
                start = first
                if seed is not None or attempt > 0:
                    rng = np.random.default_rng([seed or 0, attempt])
                    start = core.perturbed(plain, given, rng)
                found = run(start, given)
                if between is not None and refine is None and found.status is Status.SOLVED:
                    found = held(self, found, given, own, run, between, core.staged)
                exceeded = tolerance if between is None else max(tolerance, between)
                outcomes.append(core.judge.judged(found, given, mesh_tolerance, exceeded))
            done = time.perf_counter()
        result = self.result(Tried(outcomes, own, tolerance, compiled - begin, done - compiled))
        asked: dict[str, Any] = {"initial": initial, "final": final, "params": params, "final_time": final_time}
        asked |= {"free": free, "max_iterations": max_iterations, "tolerance": tolerance}
        asked |= {"solver": solver, "callback": callback, "mesh_tolerance": mesh_tolerance}
        asked["strategies"] = strategies
        said = ""
        if Strategy.IMPLICIT_STEPS in strategies and warm is None and solver is None and budget.ended is None:
            also = {"guess": guess, "final_time_guess": final_time_guess, "guesses": guesses, "seed": seed}
            also |= {"between": between, "max_seconds": budget.seconds_left}
            result, said = self._by_implicit_steps(result, plain, given, {**asked, **also})
        if refine is None:
            return result
        spent: list[Any] = [result]

        def again(problem: Any, warm: Any, between: float | None = None) -> Any:
            asked["max_seconds"] = budget.seconds_left
            spent.append(problem.solve(warm=warm, between=between, **asked))
            return spent[-1]

        finest: Any = refined(result, refine, again)
        if between is not None and finest.solved:
            finest = dataclasses.replace(again(finest.problem, finest, between), meshes=finest.meshes)
        times = {name: sum(getattr(each, name) for each in spent) for name in ("compile_seconds", "solve_seconds")}
        message = finest.message if finest.message.endswith(said) else finest.message + said
        return dataclasses.replace(finest, message=message, **times)

    def solve_many(
        self,
        guess: Mapping[Any, Any] | None = None,
        *,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        params: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        free: Mapping[Any, Any] | None = None,
        max_iterations: int = 1000,
        tolerance: float = 1e-6,
        mesh_tolerance: float = MESH,
    ) -> Many:
        """Solve many cases at once, each as `solve` does, and no case at the cost of another.

        Arguments are those of `solve`. Values with one more axis in front are one for each case; the others are shared.
        A guess with an axis of cases has one of nodes or intervals too.

        As many cases at a time as there are processors.

        Raises:
            ShapeError: arguments for different numbers of cases.
            TrajectoryError: no argument has an axis of cases.
            TwistaxError: as `solve` does, with the number of the case.
        """
        check_options(max_iterations, tolerance)
        check_mesh_tolerance(mesh_tolerance)
        given = {"guess": guess, "initial": initial, "final": final, "params": params, "final_time": final_time}
        cases = Cases(self.axes(), {**given, "free": free})
        with in_double():
            begin = time.perf_counter()
            points, givens, own = prepared(self, cases)
            first = jax.tree.map(lambda a: np.asarray(a)[0], (points, givens))
            core = self._core(float(tolerance), *first)
            if self._is_bounded:
                points = prepared(self, cases, lambda *own: self._sizes(core, *own), (points, givens))[0]
            compiled = time.perf_counter()
            outcomes = solve_all(core, points, givens, max_iterations, mesh_tolerance)
            done = time.perf_counter()
        times = (compiled - begin) / cases.count, (done - compiled) / cases.count
        return self.results([Tried([o], params, float(tolerance), *times) for o, params in zip(outcomes, own)])

    @property
    def _is_bounded(self) -> bool:
        return any(part.bounded for part in self.parts)

    def _sizes(self, core: CoreSolver, point: Point, given: Given) -> list[dict[str, Array]]:
        """Sizes of the controls of each part, continuous ones too, by name, as they are measured at a start."""
        units, found = core.units(point, given), []
        for own, part, sizes in zip(self.parts, self.shooting.segments, units.parts):
            held, states = part.shooting.local.controls.slices, part.shooting.dynamics.group.slices
            of_controls = {name: sizes.u[columns] for name, columns in held.items()}
            found.append(of_controls | {name: sizes.d[states[name]] for name in own.restated.smooth})
        return found

    def staged(self, point: Point, given: Given) -> Staged:
        """The problem as the core has it, of this thread."""
        return self._core(1e-6, point, given).staged

    def _core(self, tolerance: float, point: Point, given: Given) -> CoreSolver:
        """The solver of this thread; its kernels compile once, its memory is of one solve at a time."""
        key = (tolerance, threading.get_ident(), 0)
        while key in self._cores and self._cores[key].busy:
            key = (*key[:2], key[2] + 1)
        if key not in self._cores:
            with _MAKING, uncollected():
                first = next((core.staged for core in self._cores.values()), None)
                staged = Staged(self.shooting, self.parts, given) if first is None else first.alone(given)
                if first is None:
                    staged.drop(redundant_rows(staged, point, given), given)
                self._cores[key] = CoreSolver(staged, self.parts, given, tolerance)
        return self._cores[key]

    def _by_implicit_steps(self, result: Any, start: Point, given: Given, asked: dict[str, Any]) -> tuple[Any, str]:
        """A result, or a better one by implicit steps where explicit ones are unstable; and a sentence that says so."""
        at_once = result.status is Status.INFEASIBLE and result.iterations <= 1
        if result.status in AT_OPTIMUM or at_once or result.iterations >= asked["max_iterations"]:
            return result, ""
        with in_double():
            staged = self._core(float(asked["tolerance"]), start, given).staged
            fastest = max(stiffness(staged, point, given) for point in (start, result.warm.point))
        if fastest <= LARGEST:
            return result, ""
        if self._implicit is None:
            self._implicit = self.transcribed_by(IMPLICIT)
        other = self._implicit.solve(**asked)
        said = f" Explicit steps are unstable here, an eigenvalue of the rates times a step is {fastest:.2g}: "
        is_finite = result.status is Status.NON_FINITE and other.status is not Status.NON_FINITE
        if other.status not in AT_OPTIMUM and not is_finite:
            other, said = result, f"{said}{IMPLICIT_NAME} did not help."
        else:
            said += f"solved again by {IMPLICIT_NAME}."
        return dataclasses.replace(other, message=other.message + said), said

    def undetermined(self, warm: WarmStart) -> list[Undetermined]:
        """The controls that a solution of it does not determine; with exact second derivatives alone."""
        if any(part.hessian is not None for part in self.parts):
            return []
        with in_double():
            given = self.started().given._replace(params=warm.params)
            core = self._core(_LOOKED_AT, warm.point, given)
            return undetermined(core.staged, warm, given, [part.restated.derivatives for part in self.parts])


def check_mesh_tolerance(size: Any) -> None:
    """Raise TrajectoryError unless it makes sense."""
    number("mesh_tolerance", size, "above zero", lambda own: own > 0.0, TrajectoryError)


def check_options(max_iterations: Any, tolerance: Any) -> None:
    """Raise TrajectoryError unless both make sense."""
    whole("max_iterations", max_iterations, 1, TrajectoryError)
    number("tolerance", tolerance, "above zero and below 0.1", lambda size: 0.0 < size < 0.1, TrajectoryError)
