"""IPOPT and Fatrop, which CasADi's wheel contains, for the same discrete problem.

They call the same functions as this package's solver, in the units of the statement. States on groups are steps in the
tangent spaces at nodes that are fixed while a solver runs. The nodes then move to its result, and the solver starts
again from there, until no node rotates. Every result is assessed like those of this package's solver: by the
first-order conditions, in this package's scales.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy import ndarray as Array

from ...checks import number, short
from ...errors import TrajectoryError
from ..strategy import strategies
from ..strategy.core_solver import CoreSolver
from ..strategy.outcome import Callback, Outcome
from ..strategy.status import Status
from ..strategy.warm import WarmStart
from ..transcription.iterate import Instance, Iterate
from .program import NonlinearProgram

#: The maximal number of passes of a solver; the initial barrier parameter and distance from limits of a warm-started
#: pass; the rotation that counts as none, rad.
_PASSES, _WARM_BARRIER, _WARM_PUSH, _SMALL_TURN = 10, 1e-6, 1e-9, 1e-6
#: The ratio of the solver's tolerance to that of `solve`; a result is acceptable within this multiple of the tolerance
#: of `solve`.
_CLOSER, _ACCEPTABLE = 1e-2, 100.0
#: Return statuses that end the search, and whether the constraints are satisfied.
_OVER = {
    ("Infeasible_Problem_Detected", False): Status.INFEASIBLE,
    ("Diverging_Iterates", True): Status.UNBOUNDED,
}


@runtime_checkable
class SolvedBy(Protocol):
    """The interface of `Problem.solve(solver=...)`."""

    def run(
        self,
        core: CoreSolver,
        start: Iterate | WarmStart,
        instance: Instance,
        max_iterations: int,
        callback: Callback | None,
    ) -> Outcome:
        """Solve from a start; `core` provides the problem's functions and measures the errors of the result."""
        ...


@dataclasses.dataclass(frozen=True)
class _Casadi:
    """A solver in CasADi.

    Args:
        options: options of the solver, in addition to those that this package sets.
        max_seconds: the time limit of a try.

    Raises:
        TrajectoryError: options that are not a dict, or that `solve` sets; a time that is not positive.
    """

    options: Any = dataclasses.field(default_factory=dict)
    max_seconds: float | None = None

    plugin: ClassVar[str]
    copies: ClassVar[bool] = False

    def __post_init__(self) -> None:
        kind = type(self).__name__
        if not isinstance(self.options, Mapping):
            raise TrajectoryError(
                f"{kind} expects a dict of options, got {short(self.options)}; e.g. {{'print_level': 5}}"
            )
        if "max_iter" in self.options:
            raise TrajectoryError(
                f"{kind}: the option max_iter is an argument of solve.\n  fix: solve(max_iterations=...)"
            )
        if self.max_seconds is not None:
            number("max_seconds", self.max_seconds, "above zero", lambda it: 0.0 < it < np.inf, TrajectoryError)

    def _made(self, program: NonlinearProgram, tolerance: float) -> Any:
        try:
            from .casadi_program import CasadiProgram
            from .subprocess_solver import SubprocessSolver
        except ImportError as error:
            raise TrajectoryError(
                f"solver={type(self).__name__}() needs CasADi ({error}).\n  fix: pip install 'twistax[casadi]'"
            ) from None
        options = {**self._settings(_CLOSER * tolerance), **self.options}
        kind: Any = CasadiProgram if self.max_seconds is None else SubprocessSolver
        return kind(program, self.plugin, {"print_time": 0, **self._structure(program), self.plugin: options})

    def _settings(self, tolerance: float) -> dict[str, Any]:
        raise NotImplementedError

    def _structure(self, program: NonlinearProgram) -> dict[str, Any]:
        return {}

    def _of_pass(self, warm: bool, scaled: bool, left: int) -> dict[str, Any]:
        """Options of one pass: warm start, scaling, and the iteration limit."""
        raise NotImplementedError

    def run(
        self,
        core: CoreSolver,
        start: Iterate | WarmStart,
        instance: Instance,
        max_iterations: int,
        callback: Callback | None,
    ) -> Outcome:
        """Solve from a start; repeat from another point if the solution is not a minimum."""
        if isinstance(start, WarmStart) or core.measure.has_determined_rows:
            begun = core.run_once(start, instance, 0)
            if begun.status is not Status.MAX_ITERATIONS:
                return begun
        count, due = 0, time.monotonic() + (self.max_seconds or np.inf)

        def search(begin: Iterate | WarmStart) -> Outcome:
            nonlocal count
            run = _Run(core, instance, max_iterations - count, due)
            outcome = self._search(run, begin, _counted(callback, count))
            count += outcome.iterations
            return outcome

        return dataclasses.replace(strategies.at_a_minimum(core, search, search(start)), iterations=count)

    def _search(self, run: _Run, start: Iterate | WarmStart, callback: Callback | None) -> Outcome:
        """Passes of the solver: repeated about moved nodes while they rotate, and with other scaling after a failure.

        The first pass is in the units of the statement, as for a problem that is stated in the solver's own interface.
        """
        from .casadi_program import SolverRefused

        core, instance, here, units, count = run.core, run.instance, start, None, 0
        made = self._prepared(core, instance)
        for _ in range(_PASSES):
            first = made.program.start(here, instance, units)
            options = self._of_pass(isinstance(here, WarmStart), units is not None, max(run.left - count, 1))
            progress = _progress(made.program, _counted(callback, count), 1.0 if units is None else units.cost)
            try:
                result = made.solve(first, options, progress, max(run.due - time.monotonic(), 1e-3))
            except SolverRefused as error:
                raise TrajectoryError(str(error)) from None
            count += result.iterations
            if not np.isfinite(result.x).all():
                outcome = core.run_once(here, instance, 0)
                return dataclasses.replace(outcome, status=Status.NON_FINITE, iterations=count)
            reached = made.program.reached(result.x, result.of_bounds, result.of_rows)
            outcome = core.measured(reached.point, reached.dynamics, reached.rows, instance)
            outcome = dataclasses.replace(outcome, iterations=count)
            status = run.ended(outcome, result.word)
            if status is not None:
                return dataclasses.replace(outcome, status=status)
            turned = reached.turn > _SMALL_TURN
            if units is not None and not (result.success and turned):
                break
            if not result.success:  # the units of the statement may be the cause of the failure
                units, here = core.units(start.point if isinstance(start, WarmStart) else start, instance), start
                continue
            here = WarmStart(None, outcome.point, outcome.dynamics, outcome.rows, outcome.scales, instance.params)
            if not turned:
                units = core.units(reached.point, instance)
        return run.at_rest(outcome)

    def _prepared(self, core: CoreSolver, instance: Instance) -> Any:
        key = type(self), repr(sorted(self.options.items())), self.max_seconds is None
        if key not in core.made:
            if self.copies not in core.made:
                core.made[self.copies] = NonlinearProgram(core.staged, instance, with_copies=self.copies)
            core.made[key] = self._made(core.made[self.copies], core.tolerance)
        return core.made[key]


@dataclasses.dataclass(frozen=True)
class _Run:
    """The limits of one search: remaining iterations and end time."""

    core: CoreSolver
    instance: Instance
    left: int
    due: float

    def ended(self, outcome: Outcome, word: str) -> Status | None:
        """The final status if a pass ends the search, else None."""
        tolerance = self.core.tolerance
        if outcome.status is Status.SOLVED:
            return Status.SOLVED
        if word == "Invalid_Number_Detected":
            return Status.NON_FINITE
        if outcome.iterations >= self.left:
            return Status.MAX_ITERATIONS
        if time.monotonic() >= self.due:
            return Status.OUT_OF_TIME
        return _OVER.get((word, outcome.violation <= tolerance))

    def at_rest(self, outcome: Outcome) -> Outcome:
        """The outcome if the solver makes no progress: INFEASIBLE if the core does not find a feasible point either."""
        tolerance = self.core.tolerance
        if outcome.status is Status.SOLVED:
            return outcome
        if max(outcome.violation, *outcome.errors) <= _ACCEPTABLE * tolerance:
            return dataclasses.replace(outcome, status=Status.ACCEPTABLE)
        if outcome.violation > tolerance:
            other = self.core.run_once(outcome.point, self.instance, self.left - outcome.iterations)
            if other.status is Status.INFEASIBLE:
                return dataclasses.replace(other, iterations=outcome.iterations + other.iterations)
        return dataclasses.replace(outcome, status=Status.STALLED)


def _counted(callback: Callback | None, before: int) -> Callback | None:
    return None if callback is None else lambda k, *rest: callback(before + k, *rest)


def _progress(
    program: NonlinearProgram, callback: Callback | None, unit: float
) -> Callable[[float, Array], None] | None:
    """The callback before each step of a pass, with f in a unit, and g."""
    if callback is None:
        return None
    steps = itertools.count()

    def progress(cost: float, rows: Array) -> None:
        worst = np.maximum(np.maximum(rows, program.lower_rows - rows), 0.0)
        callback(next(steps), cost * unit, float(worst.max(initial=0.0)))

    return progress


@dataclasses.dataclass(frozen=True)
class IPOPT(_Casadi):
    """IPOPT, from CasADi, on the transcription of this package: `problem.solve(solver=tx.trajectory.IPOPT())`.

    Source: Wachter and Biegler, Mathematical Programming 106 (2006).

    Args:
        options: options of IPOPT, such as {"linear_solver": "mumps", "print_level": 5}.
        max_seconds: wall time in s, with compile time, after which a run ends with OUT_OF_TIME at its last iterate.
            IPOPT then runs in a separate process, which can be terminated, and prints to standard error. With None it
            runs in this process, without a limit, and is faster.

    Raises:
        TrajectoryError: options that are not a dict, or that `solve` sets; a time that is not positive.
    """

    plugin: ClassVar[str] = "ipopt"

    def _settings(self, tolerance: float) -> dict[str, Any]:
        return {"print_level": 0, "sb": "yes", "tol": tolerance}

    def _of_pass(self, warm: bool, scaled: bool, left: int) -> dict[str, Any]:
        options = {"max_iter": left} | ({"nlp_scaling_method": "none"} if scaled else {})
        if not warm:
            return options
        pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
        near = {f"warm_start_{name}": _WARM_PUSH for name in pushes}
        return {**options, "warm_start_init_point": "yes", "mu_init": _WARM_BARRIER, **near}


@dataclasses.dataclass(frozen=True)
class Fatrop(_Casadi):
    """Fatrop, from CasADi, an interior-point method with a factorisation by stages, like the solver of this package.

    Source: Vanroye, Sathya, De Schutter, Decre, FATROP, arXiv:2303.16746.

    Args:
        options: options of Fatrop, such as {"print_level": 1}.
        max_seconds: in s, as for `IPOPT`. Fatrop 1.1.8 can enter an infinite loop while it regularises a step, where it
            calls no callback; so it has a limit unless this is None.

    Raises:
        TrajectoryError: options that are not a dict, or that `solve` sets; a time that is not positive.
    """

    max_seconds: float | None = 600.0

    plugin: ClassVar[str] = "fatrop"
    copies: ClassVar[bool] = True

    def _settings(self, tolerance: float) -> dict[str, Any]:
        return {"print_level": 0, "tolerance": tolerance}

    def _structure(self, program: NonlinearProgram) -> dict[str, Any]:
        states, controls, rows = (list(a) for a in zip(*program.stages))
        return {
            "structure_detection": "manual",
            "N": len(states) - 1,
            "nx": states,
            "nu": controls,
            "ng": rows,
            "equality": program.equality.tolist(),
        }

    def _of_pass(self, warm: bool, scaled: bool, left: int) -> dict[str, Any]:
        return {"max_iter": left, **({"mu_init": _WARM_BARRIER} if warm else {})}
