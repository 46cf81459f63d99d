"""Solvers of others, on the same discrete problem: IPOPT and Fatrop, both inside CasADi's wheel.

Each works in the tangent spaces at nodes that stay while it runs. The nodes then move to what it found, and it starts
again from there, until it finds nothing to turn. What comes out is measured as everything else is: by the first-order
conditions, in this package's own scales.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from ..checks import number, short
from ..errors import TrajectoryError
from .decisions import RENEW
from .outcome import Callback, Outcome, Searched, outcome
from .program import Program, Reference
from .solver import Solver, Status
from .transcribed import Given, Point
from .warm import WarmStart
from .watch import Watch

if TYPE_CHECKING:
    from .apart import Apart
    from .casadi_program import CasadiProgram

#: How often nodes may move to what was found; the first barrier parameter and distance from limits then; no turn, rad.
_PASSES, _WARM_BARRIER, _WARM_PUSH, _SMALL_TURN = 10, 1e-6, 1e-9, 1e-6
#: Words of theirs for an end that another start does not mend. What it is, is measured.
_OVER = ("Infeasible_Problem_Detected", "Diverging_Iterates")


@runtime_checkable
class SolvedBy(Protocol):
    """A solver of others: what `Problem.solve(solver=...)` takes."""

    def run(
        self, solver: Solver, start: Point | WarmStart, given: Given, max_iterations: int, callback: Callback | None
    ) -> Outcome:
        """Solve from a start; `solver` measures what comes out."""
        ...


@dataclasses.dataclass(frozen=True)
class _Casadi:
    """A solver of CasADi's.

    Args:
        options: of the solver itself, on top of what this package sets.
        max_seconds: of a try.

    Raises:
        TrajectoryError: options that are no dict, or that `solve` sets; a time that is not above zero.
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
                f"{kind}: max_iter is what is left of max_iterations.\n  fix: solve(max_iterations=...)"
            )
        if self.max_seconds is not None:
            number("max_seconds", self.max_seconds, "above zero", lambda it: 0.0 < it < np.inf, TrajectoryError)

    def _made(self, program: Program, tolerance: float) -> CasadiProgram | Apart:
        try:
            from .apart import Apart
            from .casadi_program import CasadiProgram
        except ImportError as error:
            raise TrajectoryError(
                f"solver={type(self).__name__}() needs CasADi ({error}).\n  fix: pip install 'twistax[casadi]'"
            ) from None
        inequalities = int((program.lower < program.upper).sum())
        # What SOLVED asks of complementarity is the sum over all inequalities.
        own = {**self._settings(0.1 * tolerance, 0.1 * tolerance / max(1, inequalities)), **self.options}
        kind: Any = CasadiProgram if self.max_seconds is None else Apart
        return kind(program, self.plugin, {"print_time": 0, **self._structure(program), self.plugin: own})

    def _settings(self, tolerance: float, product: float) -> dict[str, Any]:
        """Options for a tolerance, and for the largest product of a slack and its multiplier."""
        raise NotImplementedError

    def _structure(self, program: Program) -> dict[str, Any]:
        return {}

    def _of_pass(self, first: bool, left: int) -> dict[str, Any]:
        raise NotImplementedError

    def run(
        self, solver: Solver, start: Point | WarmStart, given: Given, max_iterations: int, callback: Callback | None
    ) -> Outcome:
        """Solve from a start; a solution that is no minimum is left."""
        key = type(self), repr(sorted(self.options.items())), self.max_seconds is None
        if self.copies not in solver.made:
            solver.made[self.copies] = solver.program(self.copies)
        if key not in solver.made:
            solver.made[key] = self._made(solver.made[self.copies], solver.tolerance)
        made, due = solver.made[key], time.monotonic() + (self.max_seconds or np.inf)

        def search(own: Any, most: int, callback: Callback | None) -> Searched:
            return self._search(made, solver, own, given, most, callback, due)

        return solver.to_minimum(search, start, given, max_iterations, callback)

    def _search(
        self,
        made: CasadiProgram | Apart,
        solver: Solver,
        start: Point | WarmStart,
        given: Given,
        max_iterations: int,
        callback: Callback | None,
        due: float,
    ) -> Searched:
        """Passes of the solver, from a start until it has nothing left to turn, or until a time is over."""
        from .casadi_program import Refused

        program = made.program
        multipliers, failed = None, False
        if isinstance(start, WarmStart):
            point, scales, most = start.point, start.scales, start.scales
            dynamics = start.dynamics * np.asarray(scales.d)[1:] / float(scales.cost)
            multipliers = program.flat_multipliers(dynamics, start.rows * np.asarray(scales.rows) / float(scales.cost))
        else:
            point, opening = start, solver.steps.opened(start, given)
            scales, most = opening.state.scales, opening.memory.seen
        watch = Watch(solver.tolerance, max_iterations)
        seen = None
        if callback is not None:

            def seen(cost: float, rows: Any) -> None:
                worst = np.maximum(np.maximum(rows - program.upper, program.lower - rows), 0.0)
                callback(watch.count, cost * float(np.asarray(scales.cost)), float(worst.max(initial=0.0)))

        state = solver.weighed(point, given, scales)[1]
        opening = solver.steps.opening(state, most)
        memory, status = opening.memory, watch.at_once(opening)
        passes = 0
        while status is None:
            reference, passes = Reference(point, scales, given), passes + 1
            own = self._of_pass(multipliers is None, max_iterations - watch.count)
            try:
                attempt = made.solve(reference, multipliers, own, seen, max(due - time.monotonic(), 1e-3))
            except Refused as error:
                raise TrajectoryError(str(error)) from None
            watch.count += attempt.iterations
            if not np.isfinite(attempt.z).all():
                status = Status.NON_FINITE
                break
            reached = program.reached(attempt.z, reference, attempt.multipliers)
            point = reached.point
            slopes, state = solver.weighed(point, given, scales, reached.dynamics, reached.rows)
            fresh, change, memory = solver.steps.renewed(state, slopes, memory)
            renewed = float(change) > RENEW
            if renewed:
                scales, state = fresh, solver.rescaled(state, fresh, given)
            multipliers = program.flat_multipliers(state.dynamics, state.rows)
            status = watch.ended(solver.steps.signs(state, memory))
            if status is None and attempt.word == "Invalid_Number_Detected":
                status = Status.NON_FINITE
            if status is None and time.monotonic() >= due:
                status = Status.OUT_OF_TIME
            settled = reached.turn <= _SMALL_TURN and not renewed
            over = attempt.word in _OVER or (failed and not attempt.success)
            if status is None and (settled or over or passes >= _PASSES):
                state, status = solver.judged_at_rest(state, given, max_iterations - watch.count)
            failed = not attempt.success
        return Searched(outcome(solver.shooting, state, status, watch.count), state, None)


@dataclasses.dataclass(frozen=True)
class IPOPT(_Casadi):
    """IPOPT by CasADi, on this package's transcription: `problem.solve(solver=tx.trajectory.IPOPT())`.

    Source: Wachter and Biegler, Mathematical Programming 106 (2006).

    Args:
        options: IPOPT's own, such as {"linear_solver": "mumps", "print_level": 5}.
        max_seconds: after which a try ends as OUT_OF_TIME where it had come to, by the clock on the wall, with what
            compiles meanwhile. IPOPT then runs in a process of its own, which can be ended whatever it does, and prints
            to standard error. None: in this process, without a limit, and a little faster.

    Raises:
        TrajectoryError: options that are no dict, or that `solve` sets; a time that is not above zero.
    """

    plugin: ClassVar[str] = "ipopt"

    def _settings(self, tolerance: float, product: float) -> dict[str, Any]:
        quiet = {"print_level": 0, "sb": "yes"}
        return {**quiet, "tol": tolerance, "compl_inf_tol": product, "nlp_scaling_method": "none"}

    def _of_pass(self, first: bool, left: int) -> dict[str, Any]:
        if first:
            return {"max_iter": max(left, 1)}
        pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
        near = {f"warm_start_{name}": _WARM_PUSH for name in pushes}
        return {"max_iter": max(left, 1), "warm_start_init_point": "yes", "mu_init": _WARM_BARRIER, **near}


@dataclasses.dataclass(frozen=True)
class Fatrop(_Casadi):
    """Fatrop by CasADi, which factors stage by stage as this package's own solver does.

    Source: Vanroye, Sathya, De Schutter, Decre, FATROP, arXiv:2303.16746.

    Args:
        options: Fatrop's own, such as {"print_level": 1}.
        max_seconds: as of `IPOPT`. Fatrop 1.1.8 can go round without end while it regularises a step, and calls nothing
            back there, so it has a limit unless this is None.

    Raises:
        TrajectoryError: options that are no dict, or that `solve` sets; a time that is not above zero.
    """

    max_seconds: float | None = 600.0

    plugin: ClassVar[str] = "fatrop"
    copies: ClassVar[bool] = True

    def _settings(self, tolerance: float, product: float) -> dict[str, Any]:
        return {"print_level": 0, "tolerance": min(tolerance, product)}

    def _structure(self, program: Program) -> dict[str, Any]:
        states, controls, rows = (list(a) for a in zip(*program.stages))
        return {
            "structure_detection": "manual",
            "N": len(states) - 1,
            "nx": states,
            "nu": controls,
            "ng": rows,
            "equality": (program.lower == program.upper).tolist(),
        }

    def _of_pass(self, first: bool, left: int) -> dict[str, Any]:
        return {"max_iter": max(left, 1), **({} if first else {"mu_init": _WARM_BARRIER})}
