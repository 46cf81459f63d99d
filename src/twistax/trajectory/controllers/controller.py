"""A model-predictive controller: a problem that is solved again from each measured state, in preallocated memory."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import number, whole
from ...errors import TrajectoryError
from ...jax_inside import in_double
from ...solver.core import CoreStatus, Units
from ...solver.options import Options
from ...solver.prepared import LOST, PreparedSolve
from ...system.export import CFiles
from ..result.trajectory import Trajectory, trajectory_at
from ..strategy.measure import COST
from ..strategy.status import AT_OPTIMUM, Status
from ..strategy.warm import warm_start, with_ends
from .export import MEMORY, write_controller
from .first_node import FirstNode
from .gains import Gains
from .in_programs import in_order
from .log import ControllerLog, StepRecord
from .plan_controls import FirstControls, plan_controls
from .plan_units import BARRIER_LEAST, BARRIER_MOST, BARRIER_SHARE, PlanUnits
from .prepared_data import PreparedData, load
from .requirements import need_controllable, why_not_shiftable
from .shift import Shift

Values = dict[str, Array]


class Controller:
    """Model-predictive control: the controls for a measured state, by a few iterations of the solver from the last
    plan.

    `problem.controller(...)` makes one. Each sampling period has three calls:

        controller.prepare(params={reference: r})    # what is known before the measurement
        u = controller.feedback({p: 1.0, v: 0.2})    # the controls of the first interval
        controller.shift()                           # after an interval of the plan has passed

    `feedback` solves $min J$ of the problem with $x_0 = x$, the measured state, from the plan and the multipliers of
    the last call. With `max_iterations=2` this is a real-time iteration: the plan converges while the system moves.
    With `max_iterations=100` it is a full solve, which ends early after `max_seconds`.

    For a problem of several phases the measured state is that of the first node of the first phase, and `phases` has
    the plan of each phase. Such a plan is not shifted: each call starts from the last plan as it is. The first phase
    becomes shorter while time passes: leave its duration free, or set what remains by `prepare(final_time=...)`.

    A continuous control is applied as its value at the first node, which the solver chooses anew in each call.

    A controller has its own memory, so different controllers may run in different threads; the solve itself does not
    hold Python's lock. One controller serves one thread at a time. A pickled or copied controller continues from the
    same plan. In `jax.jit` and `jax.lax.scan` the calls are host
    callbacks in the order of the program. For derivatives and `jax.vmap` use `tx.trajectory.solution`.

    Args:
        problem: with a fixed initial state, in the first phase if there are several.
        warm: a result of this problem as the first plan; by default the problem is solved for it. It determines the
            solver's units. They are measured again, which takes some milliseconds, if a measured state differs from the
            plan by more than ten units.
        max_iterations: the maximal number of iterations in a call. A single iteration takes a short step where limits
            become active, for example after a disturbance.
        max_seconds: wall time after which a call ends with the iterate of the smallest error, checked before each
            iteration.
        hessian: another approximation of second derivatives than the problem's, such as `tx.trajectory.GaussNewton()`.
        tolerance: tolerance of the scaled first-order conditions; a call that satisfies it ends.
        log: the number of calls that the log keeps.

    Attributes:
        log: a `ControllerLog` of the last calls.
        status: the `Status` of the last solve; SOLVED means that the first-order conditions hold on the mesh.

    Raises:
        TrajectoryError: functionals of the path; a free initial state; a fixed initial value of a continuous control;
            invalid numbers.

    Source: Diehl, Bock, Schloeder, A real-time iteration scheme for nonlinear optimization in optimal feedback control,
    SIAM J. Control Optim. 43 (2005).
    """

    def __init__(
        self,
        problem: Any,
        warm: Any = None,
        *,
        max_iterations: int = 2,
        max_seconds: float | None = None,
        hessian: Any = None,
        tolerance: float = 1e-6,
        log: int = 10_000,
    ) -> None:
        if hessian is not None:
            problem = problem.with_phases([{"hessian": hessian}] * len(problem.parts))
        whole("max_iterations", max_iterations, 1, TrajectoryError)
        whole("log", log, 1, TrajectoryError)
        if max_seconds is not None:
            number("max_seconds", max_seconds, "above zero", lambda size: size > 0.0, TrajectoryError)
        need_controllable(problem)
        self.problem, self._seconds = problem, max_seconds
        self.part = problem.parts[0]
        with in_double():
            start = warm_start(problem.solve() if warm is None else warm)
            _, instance, _, ends = problem.started(begin=start.point)
            start = with_ends(start, problem, ends, instance)
            solver = problem.core(tolerance, start.point, instance).alone(instance)
            self.staged = staged = solver.staged
            self.largest_step = solver.largest_step
            units = solver.units(start.point, instance) if start.units is None else start.units
            self._made = problem, dataclasses.replace(start, units=units), max_iterations, max_seconds, tolerance, log
            self._plan_units = PlanUnits(staged, units)
            options = solver.options(max_iterations) | {"warm_start": 1.0, "excess": 0.0}
            bounds = staged.limits(staged.coordinates(staged.flat(start.point)), instance)
            self.prepared = PreparedSolve(
                staged.transcription, self.units, solver.largest_step, bounds, Options(**options)
            )
            load(self.prepared, staged, start)
        by_phase = [plan_controls(staged, k, part) for k, part in enumerate(problem.parts)]
        self.first_node, self.first_controls = FirstNode(staged, self.part.phase.dynamics), FirstControls(by_phase[0])
        self.data = PreparedData(problem, staged, self.prepared, by_phase, instance)
        self.moves_on = None if why_not_shiftable(problem) else Shift(staged, self.part.continuous.rates)
        self._gains = Gains(self.prepared, staged, self.units)
        self.log, self.status = ControllerLog(log), Status.STOPPED

    def __getstate__(self) -> dict[str, Any]:
        plan = {"iterate": self.prepared.saved(), "units": self._plan_units.saved()}
        return {"made": self._made, "data": self.data.saved(), "log": self.log, "status": self.status, **plan}

    def __setstate__(self, state: dict[str, Any]) -> None:
        names = ("problem", "warm", "max_iterations", "max_seconds", "tolerance", "log")
        Controller.__init__(self, **dict(zip(names, state["made"], strict=True)))
        self.prepared.load(state["iterate"])
        self._plan_units.load(state["units"], self.prepared)
        self.data.load(state["data"])
        self._gains = Gains(self.prepared, self.staged, self.units)
        self.log, self.status = state["log"], state["status"]

    def __repr__(self) -> str:
        nodes = sum(part.nodes for part in self.problem.parts)
        return f"Controller({nodes} nodes, {self.log!r})"

    # ---- prepare, feedback, shift -----------------------------------------------------------------------------------

    @in_order()
    def prepare(
        self,
        params: Mapping[Any, Any] | None = None,
        *,
        final: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        limits: Mapping[Any, Any] | None = None,
    ) -> None:
        """Set data that are known before the state is measured. They remain in use until the next change.

        Args:
            params: values of parameters by leaf or name, including references and weights. Parameters in `by_node` have
                a row for each node, or one row for all.
            final: values of states at the end, if the problem fixes them.
            final_time: the final time in s, or its limits (low, high) if it is free.
            limits: (low, high) of controls, by leaf or name, in their unit; numbers, arrays of a control's shape, or
                arrays (intervals, *shape), (nodes, *shape) for continuous controls.

        For a problem of phases final, final_time and limits are dicts from names of phases to the values described
        here; final_time sets the duration of a phase.

        Raises:
            InputError, ShapeError, ModelError, TrajectoryError: unknown names, other shapes, numbers that are not
                finite, low above high.
        """
        if not params is final is final_time is None:
            with in_double():
                self.data.set_numbers(params, final, final_time)
        if limits is not None:
            self.data.set_limits(limits)

    @in_order(lambda self: _shapes(self), lambda self, x: self.first_node.named(x))
    def feedback(self, x: Mapping[Any, Any]) -> Values:
        """The controls for a measured state: a few iterations of the solver from the last plan.

        Args:
            x: the state by leaf or name; every state of the system is required.
        Returns:
            the controls of the first interval, by name; of a continuous control the value at the first node. After a
            failed solve they are those of the previous plan: check `status`. After a timeout they are those of the
            iterate with the smallest error.
        Raises:
            InputError, ShapeError: a state is missing, has another shape or numbers that are not finite, or is not an
                element of its group.
        """
        begin = time.perf_counter()
        solve, options, before = self.prepared, self.prepared.options, self.first_node.point(self.prepared)
        barrier = min(max(BARRIER_SHARE * self._measured(x), BARRIER_LEAST), BARRIER_MOST)
        options.barrier_start = barrier
        options.slack_push = options.bound_push = min(barrier**0.5, 1e-2)
        ended = solve(None if self._seconds is None else self._seconds - (time.perf_counter() - begin))
        if ended in LOST:  # the plan before this call
            self.first_node.write(solve, before)
        self.status = _STATUS.get(ended, Status.STALLED)
        measure = solve.measure
        record = StepRecord(
            self.status,
            int(measure("iterations")),
            time.perf_counter() - begin,
            self.problem.sign * measure("cost"),
            measure("violation"),
            COST * measure("error"),
        )
        self.log.append(record)
        return self._first_controls()

    @in_order()
    def shift(self) -> None:
        """Shift the plan by one interval: its second node is the first one of the next solve.

        The last control stays constant for one more interval, and the last state is integrated with it. A continuous
        control continues with its last value and derivatives, but its last derivative, which is piecewise constant, is
        zero.

        Raises:
            TrajectoryError: the problem has several phases; interval lengths differ.
        """
        if self.moves_on is None:
            raise TrajectoryError(f"shift: {why_not_shiftable(self.problem)}")
        if self._plan_units.are_new:
            self._measure_units()
        self.moves_on(self.prepared)

    def _measured(self, x: Mapping[Any, Any]) -> float:
        """Write the measured state into the first node; return its largest move, in units of the states."""
        solve, node, units = self.prepared, self.first_node, self._plan_units
        base = node.read(x)
        difference = node.difference(solve, base)
        node.write(solve, base)
        if units.are_far_below(difference):
            self._measure_units()
        return units.largest(difference)

    def _measure_units(self) -> None:
        if self._plan_units.measure(self.prepared):
            self._gains = Gains(self.prepared, self.staged, self.units)

    def constant_units(self) -> AbstractContextManager[None]:
        """A context in which the units are constant, as in the C code."""
        return self._plan_units.constant()

    @property
    def units(self) -> Units:
        """The units that the solver uses."""
        return self._plan_units.units

    def _first_controls(self) -> Values:
        return self.first_controls.named(self.prepared.z[self.first_controls.points])

    # ---- between two solves -----------------------------------------------------------------------------------------

    @property
    @in_order(lambda self: _shapes(self, self.first_node.n))
    def gains(self) -> Values:
        """Derivatives of the first controls with respect to the measured state: control name -> (*shape, n).

        $u(x) = u_0 + K Log(x_0^-1 x)$ to first order, with the present active limits. n is the number of tangents of
        the states, in the order of their declaration. K is the gain of a Riccati recursion along the plan, including
        variations of free times, free parameters and equalities at nodes. It is computed on access, which takes about
        as long as one iteration of the solver.

        Raises:
            TrajectoryError: the plan is not a strict minimum.
        """
        n = self.first_node.n
        return self.first_controls.named(self._gains(n, self.first_controls.columns), n)

    @in_order(lambda self: _shapes(self), lambda self, x: self.first_node.named(x))
    def correct(self, x: Mapping[Any, Any]) -> Values:
        """The first controls, corrected for a newer state by the gains; use it between two solves.

        The correction is $u = u_0 + K Log(x_0^-1 x)$, clipped to the limits of the controls.

        Args:
            x: as for `feedback`.
        Raises:
            InputError, ShapeError: as `feedback` does.
            TrajectoryError: the plan is not a strict minimum.
        """
        solve, node = self.prepared, self.first_node
        points, columns = self.first_controls.points, self.first_controls.columns
        moved = self._gains(node.n, columns) @ node.difference(solve, node.read(x))
        return self.first_controls.named(np.clip(solve.z[points] + moved, solve.lower[columns], solve.upper[columns]))

    # ---- the plan ---------------------------------------------------------------------------------------------------

    @property
    def phases(self) -> tuple[Trajectory, ...]:
        """The plan of each phase; times start at 0 now, and continue from phase to phase."""
        point, segments = self.staged.point(self.prepared.z.copy()), self.staged.transcribed.segments
        plans = (trajectory_at(p, s.of(point), self.params) for p, s in zip(self.problem.parts, segments))
        return tuple(Trajectory(**plan) for plan in plans)

    @property
    def _plan(self) -> Trajectory:
        if not self.problem.alone:
            raise TrajectoryError(
                "the plan of a problem of several phases has states, controls and times by phase.\n"
                "  fix: controller.phases[0].xs"
            )
        return self.phases[0]

    @property
    def xs(self) -> Values:
        """The states of the plan, by name, (nodes, ...)."""
        return self._plan.xs

    @property
    def us(self) -> Values:
        """The controls of the plan, by name, (intervals, ...), or (nodes, ...) for continuous ones."""
        return self._plan.us

    @property
    def ts(self) -> Array:
        """The times of the nodes, (nodes,), s, from now."""
        return self._plan.ts

    @property
    def message(self) -> str:
        """A sentence on the last solve. After a failure it names the limits, and the constraints of states alone, that
        the measured state violates; they apply to the nodes after it.
        """
        if self.status in (*AT_OPTIMUM, Status.NON_FINITE):
            return f"{self.status}."
        xs = self.staged.transcribed.segments[0].of(self.staged.point(self.prepared.z.copy())).xs
        violated = self.part.violated_by_state({name: values[0] for name, values in xs.items()}, self.params)
        named = ", ".join(f"{name!r} by {size:.3g}" for name, size in violated.items())
        return f"{self.status}." + f" The measured state violates {named}." * bool(named)

    @property
    def params(self) -> Values:
        """Values of the parameters by name, for the next solve."""
        return self.data.params

    # ---- C code -----------------------------------------------------------------------------------------------------

    def to_c(
        self,
        directory: str | Path,
        *,
        name: str = "controller",
        states: Sequence[Mapping[str, Any]] | None = None,
        tolerance: float | None = None,
        memory: int = MEMORY,
        dtype: Any = np.float64,
    ) -> CFiles:
        """Write C99 code: `name.h` with the interface, `name.c`, and `name_test.c` with reference values.

        The code consists of the solver's core, the functions of the problem, and `name_init`, `name_prepare`,
        `name_feedback` and `name_shift`. `name_init` sets the present plan. The code allocates no
        memory, has no global state, and needs only libm. The header states the size of the workspace and the number of
        operations of an iteration.

        Args:
            directory: the folder of the files, which is created if missing.
            name: the name of the files, and the prefix of all functions.
            states: measured states of the test program, which shifts the plan after each; or random ones near it.
            tolerance: of the test program, relative to the largest entry of an iterate; 1e-9, or 5e-3 for float32.
            memory: bytes that the controller may use for a faster solve; 0: as few as it can. The header states them.
            dtype: float64 or float32, the precision of the code. The header states to which accuracy a call is solved.
        Returns:
            The paths `header`, `source` and `test`.
        Raises:
            TrajectoryError: a function of the problem has no scalar form.
            InputError: a name that is not a C identifier; another dtype; a directory that is not writable, or that
                contains other files of these names.
        """
        return write_controller(self, directory, name, dtype, memory, states=states, tolerance=tolerance)

    @property
    def measures(self) -> dict[str, float]:
        """Measures of the last solve in the solver's scales: cost, error, violation, iterations and others.

        A controller does not test for a minimum: `excess` is NaN, and `minimum` is 0 even at a minimum.
        """
        return self.prepared.measures


def _shapes(controller: Controller, *more: int) -> dict[str, tuple[int, ...]]:
    return {name: (*shape, *more) for name, shape in controller.first_controls.shapes.items()}


#: The `Status` for each exit status of the core.
_STATUS = {status: Status[status.name] for status in CoreStatus if status.name in Status.__members__}
_STATUS[CoreStatus.STOPPED] = Status.OUT_OF_TIME
