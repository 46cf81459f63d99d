"""The steps of `Problem.solve`: one solve or several, from guesses or from a warm start."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import callable_with, number, short, whole
from ...errors import TrajectoryError, TwistaxError
from ...jax_inside import in_double
from ...progress import Progress
from ..adapters.solvers import SolvedBy
from ..contact.relaxed import lowered, with_interior
from ..hessians.options import by_updates
from ..result.between_nodes import hold_between_nodes
from ..result.many import many_results
from ..result.quality import Attempts
from ..result.refine import refined
from ..result.result import best_result
from ..strategy.accuracy import MESH
from ..strategy.batch import solve_all
from ..strategy.budget import Budget
from ..strategy.core_solver import CoreSolver
from ..strategy.other_starts import perturbed
from ..strategy.outcome import Callback, Outcome
from ..strategy.status import AT_OPTIMUM, Status
from ..strategy.stiffness import IMPLICIT_NAME, LARGEST, stiffness
from ..strategy.strategies import Strategy
from ..strategy.strategies import solved as with_strategies
from ..strategy.warm import WarmStart, warm_start, with_ends
from ..transcription.iterate import Instance, Iterate
from .cases import Cases, started_cases
from .start import axes

#: The ratio of the solver's tolerance to that of a mesh refinement.
CLOSER = 0.1
#: Arguments of a solve that define its start.
_STARTS = ("guess", "final_time_guess", "seed")


@dataclasses.dataclass(frozen=True)
class SolveOptions:
    """The arguments of `Problem.solve`.

    Raises:
        TrajectoryError: invalid numbers, or a warm start together with a guess.
    """

    guess: Any = None
    warm: Any = None
    initial: Any = None
    final: Any = None
    params: Any = None
    final_time: Any = None
    final_time_guess: Any = None
    free: Any = None
    guesses: int = 1
    seed: int | None = None
    callback: Any = None
    progress: Any = None
    max_iterations: int = 1000
    max_seconds: float | None = None
    tolerance: float = 1e-6
    solver: Any = None
    between: float | None = None
    refine: Any = None
    mesh_tolerance: float = MESH
    strategies: Any = tuple(Strategy)

    def __post_init__(self) -> None:
        error = TrajectoryError
        whole("guesses", self.guesses, 1, error)
        known = [name for name in _STARTS if getattr(self, name) is not None]
        if self.warm is not None and known:
            raise error(f"solve: warm replaces a guess; leave out {', '.join(known)}")
        whole("max_iterations", self.max_iterations, 1, error)
        number("tolerance", self.tolerance, "above zero and below 0.1", lambda size: 0.0 < size < 0.1, error)
        number("mesh_tolerance", self.mesh_tolerance, "above zero", lambda size: size > 0.0, error)
        for name in ("refine", "between"):
            if getattr(self, name) is not None:
                number(name, getattr(self, name), "above zero and below 1", lambda size: 0.0 < size < 1.0, error)
        if self.seed is not None:
            whole("seed", self.seed, 0, error)
        if self.callback is not None:
            callable_with("callback", self.callback, ["iteration", "cost", "violation"], error)
        if self.progress is not None and not isinstance(self.progress, (bool, Progress)):
            got = short(self.progress)
            raise error(f"progress expects True, False, None or a tx.trajectory.Progress, got {got}")
        for strategy in self.strategies if isinstance(self.strategies, Collection) else [self.strategies]:
            if not isinstance(strategy, Strategy):
                got = short(self.strategies)
                raise error(f"strategies expects members of tx.trajectory.Strategy in a tuple, got {got}")
        if self.solver is not None and (isinstance(self.solver, type) or not isinstance(self.solver, SolvedBy)):
            expected = "tx.trajectory.IPOPT() or tx.trajectory.Fatrop(), or nothing"
            raise error(f"solver expects {expected}, got {self.solver!r}")
        if self.max_seconds is not None:
            number("max_seconds", self.max_seconds, "above zero", lambda size: size > 0.0, error)
            if self.solver is not None:
                raise error(
                    "solve: max_seconds is an argument of the solver here.\n"
                    f"  fix: {type(self.solver).__name__}(max_seconds=...)"
                )

    @property
    def needed(self) -> float:
        """The tolerance of the solver; mesh refinement needs a smaller one."""
        return float(self.tolerance if self.refine is None else min(self.tolerance, CLOSER * self.refine))

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments of `Problem.started`."""
        names = ("guess", "initial", "final", "params", "final_time", "final_time_guess", "free")
        return {name: getattr(self, name) for name in names}

    def again(self, **changed: Any) -> dict[str, Any]:
        """The arguments of another solve of the same problem on one mesh, from another start."""
        left_out = ("warm", "guesses", "between", "refine", *_STARTS)
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        kept = {name: value for name, value in fields.items() if name not in left_out}
        return {**kept, "tolerance": self.needed, **changed}


def solved(problem: Any, options: SolveOptions) -> Any:
    """Solve a problem; see `Problem.solve`."""
    if options.solver is not None and by_updates(problem.parts):
        raise TrajectoryError(
            f"QuasiNewton() has no second derivatives for {options.solver!r}.\n  fix: leave out hessian= or solver="
        )
    line = options.progress
    if not isinstance(line, Progress):
        # A callback replaces the printed line.
        line = Progress(shown=False if line is None and options.callback is not None else line)
    with line:
        options = dataclasses.replace(options, progress=line)
        once = functools.partial(_with_line, problem, line)
        if options.warm is not None or Strategy.LOWERED_RELAXATIONS not in options.strategies:
            return once(options)
        return lowered(problem, options, once)


def _with_line(problem: Any, line: Progress, options: SolveOptions) -> Any:
    """Solve, and show each iteration."""
    if _is_by_implicit_steps(problem, options):
        result = problem.implicit.solve(**{it.name: getattr(options, it.name) for it in dataclasses.fields(options)})
        return dataclasses.replace(result, message=f"{result.message} Solved by {IMPLICIT_NAME}, as the start was.")
    callback, sign = options.callback, problem.sign
    report: Callback | None = None
    if callback is not None or line.shown:

        def report(count: int, cost: float, violation: float, step: float | None = None) -> Any:
            line(count, sign * cost, violation, step)
            return None if callback is None else callback(count, sign * cost, violation)

    budget = Budget(options.max_iterations, options.max_seconds, report)
    result, start, instance = _on_one_mesh(problem, options, budget, report)
    remark = ""
    implicit = Strategy.IMPLICIT_STEPS in options.strategies and options.warm is None and options.solver is None
    if implicit and budget.ended is None:
        names = ("guess", "final_time_guess", "guesses", "seed", "between")
        same_start = {name: getattr(options, name) for name in names}
        again = options.again(max_seconds=budget.seconds_left, **same_start)
        result, remark = _by_implicit_steps(problem, result, start, instance, again)
    if options.refine is None:
        return result
    return _on_finer_meshes(result, options, budget, remark)


def _on_one_mesh(
    problem: Any, options: SolveOptions, budget: Budget, report: Callback | None
) -> tuple[Any, Iterate, Instance]:
    """The best result of all tries, the first guess, and the data of the problem."""
    between, tolerance = options.between, options.needed
    with in_double():
        begin = time.perf_counter()
        options.progress.note("compiling")
        warm = None if options.warm is None else warm_start(options.warm)
        alone = None if warm is None or options.guesses > 1 else warm.point
        plain, instance, params, ends = problem.started(**options.arguments, begin=alone)
        warm = None if warm is None else with_ends(warm, problem, ends, instance)
        core = problem.core(tolerance, plain, instance)
        if (warm is None or options.guesses > 1) and any(part.bounded for part in problem.parts):
            sizes = sizes_of_controls(problem, core, plain, instance)
            plain = problem.started(**options.arguments, sizes=sizes).point
        instance = with_interior(problem, core, plain, instance)
        compiled = time.perf_counter()
        options.progress.note("running")
        outcomes: list[Outcome] = []

        def run(start: Iterate | WarmStart, instance: Instance) -> Outcome:
            core.busy = True  # what a callback solves or evaluates uses another solver
            try:
                if options.solver is None:
                    budget.used = 0
                    return with_strategies(core, start, instance, budget, options.strategies)
                outcome: Outcome = options.solver.run(core, start, instance, options.max_iterations, report)
                return outcome
            finally:
                core.busy = False

        for attempt in range(options.guesses):
            if budget.ended is not None:
                break
            start: Iterate | WarmStart = plain if warm is None else warm
            if options.seed is not None or attempt > 0:
                rng = np.random.default_rng([options.seed or 0, attempt])
                start = perturbed(core, plain, instance, rng)
            outcome = run(start, instance)
            if between is not None and options.refine is None and outcome.status is Status.SOLVED:
                outcome = hold_between_nodes(problem, outcome, instance, params, run, between, core.staged)
            options.progress.note("integrating each interval closely")
            exceeded = tolerance if between is None else max(tolerance, between)
            outcomes.append(core.judge.judged(outcome, instance, options.mesh_tolerance, exceeded))
        done = time.perf_counter()
    tried = Attempts(outcomes, params, tolerance, compiled - begin, done - compiled)
    return best_result(problem, tried), plain, instance


def _is_by_implicit_steps(problem: Any, options: SolveOptions) -> bool:
    """Whether the warm start belongs to the implicit problem that replaced this one."""
    if options.warm is None or Strategy.IMPLICIT_STEPS not in options.strategies or problem.stands_in:
        return False
    return getattr(warm_start(options.warm).problem, "stands_in", False)


def _by_implicit_steps(
    problem: Any, result: Any, start: Iterate, instance: Instance, again: dict[str, Any]
) -> tuple[Any, str]:
    """The result, or a better one with implicit steps if explicit steps are unstable; with a
    sentence for its message.
    """
    at_once = result.status is Status.INFEASIBLE and result.iterations <= 1
    if result.status in AT_OPTIMUM or at_once or result.iterations >= again["max_iterations"]:
        return result, ""
    with in_double():
        staged = problem.core(float(again["tolerance"]), start, instance).staged
        fastest = max(stiffness(staged, point, instance) for point in (start, result.warm.point))
    if fastest <= LARGEST:
        return result, ""
    other = problem.implicit.solve(**again)
    remark = f" Explicit steps are unstable here, an eigenvalue of the rates times a step is {fastest:.2g}: "
    is_finite = result.status is Status.NON_FINITE and other.status is not Status.NON_FINITE
    if other.status not in AT_OPTIMUM and not is_finite:
        other, remark = result, f"{remark}{IMPLICIT_NAME} did not help."
    else:
        remark += f"solved again by {IMPLICIT_NAME}."
    return dataclasses.replace(other, message=other.message + remark), remark


def _on_finer_meshes(first: Any, options: SolveOptions, budget: Budget, remark: str) -> Any:
    """The result of a refinement, with the wall time of all meshes."""
    results = [first]

    def again(problem: Any, warm: Any, between: float | None = None) -> Any:
        results.append(problem.solve(**options.again(warm=warm, between=between, max_seconds=budget.seconds_left)))
        return results[-1]

    finest = refined(first, options.refine, again)
    if options.between is not None and finest.solved:
        finest = dataclasses.replace(again(finest.problem, finest, options.between), meshes=finest.meshes)
    times = {
        name: sum(getattr(solved_one, name) for solved_one in results) for name in ("compile_seconds", "solve_seconds")
    }
    message = finest.message if finest.message.endswith(remark) else finest.message + remark
    return dataclasses.replace(finest, message=message, **times)


def solved_many(problem: Any, arguments: Mapping[str, Any], options: SolveOptions) -> Any:
    """Solve many cases; see `Problem.solve_many`."""
    cases, tolerance = Cases(axes(problem), arguments), options.needed
    with in_double():
        begin = time.perf_counter()
        plain = started_cases(problem, cases)
        first = next(case for case in plain if not isinstance(case, TwistaxError))
        core = problem.core(tolerance, first.point, first.instance)
        every = plain
        if any(part.bounded for part in problem.parts):

            def sizes(k: int) -> Any:
                case = plain[k]
                return None if isinstance(case, TwistaxError) else sizes_of_controls(problem, core, *case[:2])

            every = started_cases(problem, cases, sizes)
        fitting = [case for case in every if not isinstance(case, TwistaxError)]
        compiled = time.perf_counter()
        outcomes = solve_all(core, fitting, options.max_iterations, options.mesh_tolerance)
        done = time.perf_counter()
    times = (compiled - begin) / cases.count, (done - compiled) / cases.count
    left, tried = iter(zip(outcomes, fitting, strict=True)), []
    for case in every:
        if isinstance(case, TwistaxError):
            params = {name: np.full(value.shape, np.nan) for name, value in first.params.items()}
            outcome = outcomes[0].refused(str(case))
        else:
            outcome, (_, _, params, _) = next(left)
        tried.append(Attempts([outcome], params, tolerance, *times))
    return many_results(problem, tried)


def sizes_of_controls(problem: Any, core: CoreSolver, point: Iterate, instance: Instance) -> list[dict[str, Array]]:
    """Typical sizes of the controls of each phase by name, measured at a start."""
    units, by_phase = core.units(point, instance, with_rows=False), []
    for part, segment, sizes in zip(problem.parts, problem.shooting.segments, units.parts):
        columns_of, states = segment.shooting.local.controls.slices, segment.shooting.dynamics.group.slices
        of_held = {name: sizes.u[columns] for name, columns in columns_of.items()}
        by_phase.append(of_held | {name: sizes.d[states[name]] for name in part.continuous.smooth})
    return by_phase
