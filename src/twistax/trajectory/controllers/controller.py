"""A model-predictive controller: a problem that is solved again from each measured state, in preallocated memory."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import listed, number, reals, short, whole
from ...errors import InputError, ShapeError, TrajectoryError
from ...jax_inside import in_double
from ...solver.core import CoreStatus, Units
from ...solver.options import Options
from ...solver.prepared import LOST, PreparedSolve
from ...system import name_of
from ...system.export import CFiles
from ..strategy.measure import COST
from ..strategy.status import Status
from ..strategy.warm import warm_start, with_ends
from .barrier import BARRIER_LEAST, BARRIER_MOST, BARRIER_SHARE
from .export import MEMORY, write_controller
from .first_node import FirstNode
from .gains import Gains
from .in_programs import in_order
from .log import ControllerLog, StepRecord
from .plan_units import PlanUnits
from .requirements import need_controllable, need_shiftable
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

    A controller has its own memory, so different controllers may run in different threads; the solve itself does not
    hold Python's lock. One controller serves one thread at a time. In `jax.jit` and `jax.lax.scan` the calls are host
    callbacks in the order of the program, without derivatives.

    Args:
        problem: of one phase, with piecewise constant controls and a fixed initial state.
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
        params: values of the parameters by name, for the next solve.

    Raises:
        TrajectoryError: a problem of phases, with continuous controls or with functionals of the path; a free initial
            state; invalid numbers.

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
        (self.part,) = problem.parts
        with in_double():
            start = warm_start(problem.solve() if warm is None else warm)
            _, instance, _, ends = problem.started(begin=start.point)
            start = with_ends(start, problem, ends, instance)
            solver = problem.core(tolerance, start.point, instance).alone(instance)
            self.staged = staged = solver.staged
            self.largest_step = solver.largest_step
            units = solver.units(start.point, instance) if start.units is None else start.units
            self._plan_units = PlanUnits(staged, units)
            options = solver.options(max_iterations) | {"warm_start": 1.0, "excess": 0.0}
            bounds = staged.limits(staged.coordinates(staged.flat(start.point)), instance)
            self.prepared = PreparedSolve(
                staged.transcription, self.units, solver.largest_step, bounds, Options(**options)
            )
            self._node = FirstNode(staged, self.part.dynamics)
            self._load(start)
        self.params, self.numbers = dict(instance.params), np.array(staged.numbers.vector(instance))
        staged.transcription.set_data(self.numbers)
        self.moves_on, self._gains = Shift(staged), Gains(self.prepared, staged, self.units)
        self._place_controls()
        self.log, self.status = ControllerLog(log), Status.STOPPED

    def _load(self, start: Any) -> None:
        """Write a warm start into the memory of the solver."""
        solve, staged = self.prepared, self.staged
        solve.z[:] = z = staged.flat(start.point)
        solve.v[:] = staged.coordinates(z)
        solve.lam[:] = staged.unpadded(start.dynamics)
        solve.y[:], solve.ye[:], solve.zl[:], solve.zu[:] = staged.split_rows(np.asarray(start.rows))
        solve.s[:] = 0.0  # the residuals of its rows
        first = {name: np.asarray(values)[0] for name, values in start.point.xs.items()}
        solve.z[: self._node.size] = staged.parts[0].point.joined(first)

    def _place_controls(self) -> None:
        """Find the positions of piecewise constant controls in a stage."""
        self.controls, user = {}, {control.name for control in self.part.phase.dynamics.controls}
        for control in self.part.dynamics.controls:
            if control.name in user:
                self.controls[control.name] = (self.part.shooting.local.controls.slices[control.name], control.shape)

    def __repr__(self) -> str:
        return f"Controller({self.part.nodes} nodes, {self.log!r})"

    # ---- prepare, feedback, shift -----------------------------------------------------------------------------------

    @in_order()
    def prepare(
        self,
        params: Mapping[Any, Any] | None = None,
        *,
        final: Mapping[Any, Any] | None = None,
        limits: Mapping[Any, Any] | None = None,
    ) -> None:
        """Set data that are known before the state is measured. They remain in use until the next change.

        Args:
            params: values of parameters by leaf or name, including references and weights. Parameters in `by_node` have
                a row for each node, or one row for all.
            final: values of states at the end, if the problem fixes them.
            limits: (low, high) of piecewise constant controls, by leaf or name, in their unit; numbers, arrays of a
                control's shape,
                or arrays (intervals, *shape).
        Raises:
            InputError, ShapeError, ModelError, TrajectoryError: unknown names, other shapes, numbers that are not
                finite, low above high.
        """
        if params is not None or final is not None:
            with in_double():
                self._set_numbers(params or {}, final)
        for key, sides in (limits or {}).items():
            self._limit(name_of(key), sides)

    def _set_numbers(self, params: Mapping[Any, Any], final: Mapping[Any, Any] | None) -> None:
        if not isinstance(params, Mapping):
            raise InputError(f"prepare: params must be a dict from parameters to values, got {short(params)}")
        numbers, by_node = self.staged.numbers, self.part.by_node
        rows = False
        for key, value in params.items():
            name = name_of(key)
            if name not in self.params:
                raise InputError(f"unknown key {name!r} in params; expected: {listed(self.params, name)}")
            if name in by_node.leaves:
                self.params[name], rows = by_node.values(name, value), True
                continue
            array = reals(f"params[{name!r}]", value, InputError)
            if array.shape != np.shape(self.params[name]):
                raise ShapeError(f"params[{name!r}] expects shape {np.shape(self.params[name])}, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"params[{name!r}] expects finite numbers, got {short(array)}")
            self.params[name] = array
            self.numbers[numbers.places([name], [])] = array.ravel()
        self.part.check_weights(self.params)
        if rows:
            begin, _ = numbers.node_rows(0)
            self.numbers[begin:] = by_node.rows(self.params).ravel()
        if final is not None:
            ends = self.part.other_ends(None, final)
            for name, value in self.part.filled(ends.final).items():
                self.numbers[numbers.places([], [name])] = np.ravel(value)
        self.staged.transcription.set_data(self.numbers)

    def _limit(self, name: str, sides: Any) -> None:
        if name not in self.controls:
            raise InputError(
                f"limits names {name!r}; the piecewise constant controls are: {listed(self.controls, name)}"
            )
        columns, shape = self.controls[name]
        if not isinstance(sides, (tuple, list)) or len(sides) != 2:
            raise InputError(f"limits[{name!r}] expects (low, high), got {short(sides)}")
        intervals = self.part.nodes - 1
        low, high = (reals(f"limits[{name!r}]", side, InputError) for side in sides)
        for side in (low, high):
            if side.shape not in ((), shape, (intervals, *shape)):
                raise ShapeError(f"limits[{name!r}] expects shape {shape} or {(intervals, *shape)}, got {side.shape}")
        if not (low <= high).all():
            raise InputError(f"limits[{name!r}] expects low <= high, got {short(low)} and {short(high)}")
        first, n = self.staged.transcription.stages.first, self._node.n
        places = first[:-1, None] + n + np.arange(columns.start, columns.stop)
        for bound, side in ((self.prepared.lower, low), (self.prepared.upper, high)):
            bound[places] = np.broadcast_to(side, (intervals, *shape)).reshape(intervals, -1)

    @in_order(lambda self: self._shapes(), lambda self, x: self._node.named(x))
    def feedback(self, x: Mapping[Any, Any]) -> Values:
        """The controls for a measured state: a few iterations of the solver from the last plan.

        Args:
            x: the state by leaf or name; every state of the system is required.
        Returns:
            the controls of the first interval, by name. After a failed solve they are those of the previous plan:
            check `status`. After a timeout they are those of the iterate with the smallest error.
        Raises:
            InputError, ShapeError: a state is missing, has another shape or numbers that are not finite, or is not an
                element of its group.
        """
        begin = time.perf_counter()
        solve, options, before = self.prepared, self.prepared.options, self._node.point(self.prepared)
        barrier = min(max(BARRIER_SHARE * self._measured(x), BARRIER_LEAST), BARRIER_MOST)
        options.barrier_start = barrier
        options.slack_push = options.bound_push = min(barrier**0.5, 1e-2)
        ended = solve(None if self._seconds is None else self._seconds - (time.perf_counter() - begin))
        if ended in LOST:  # the plan before this call
            self._node.write(solve, before)
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

        The last control stays constant for one more interval, and the last state is integrated with it.

        Raises:
            TrajectoryError: interval lengths differ.
        """
        need_shiftable(self.problem)
        if self._plan_units.are_new:
            self._measure_units()
        self.moves_on(self.prepared)

    def _measured(self, x: Mapping[Any, Any]) -> float:
        """Write the measured state into the first node; return its largest move, in units of the states."""
        solve, node, units = self.prepared, self._node, self._plan_units
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

    def _shapes(self, *more: int) -> dict[str, tuple[int, ...]]:
        return {name: (*shape, *more) for name, (_, shape) in self.controls.items()}

    def _first_controls(self) -> Values:
        here = self.prepared.z[self._node.size :]
        return {name: here[columns].reshape(shape).copy() for name, (columns, shape) in self.controls.items()}

    # ---- between two solves -----------------------------------------------------------------------------------------

    @property
    @in_order(lambda self: self._shapes(self._node.n))
    def gains(self) -> Values:
        """Derivatives of the first controls with respect to the measured state: control name -> (*shape, n).

        $u(x) = u_0 + K Log(x_0^-1 x)$ to first order, with the present active limits. n is the number of tangents of
        the states, in the order of their declaration. K is the gain of a Riccati recursion along the plan, including
        variations of free times, free parameters and equalities at nodes. It is computed on access, which takes about
        as long as one iteration of the solver.

        Raises:
            TrajectoryError: the plan is not a strict minimum.
        """
        n = self._node.n
        columns = self._gains(n)
        return {name: columns[part].reshape(*shape, n) for name, (part, shape) in self.controls.items()}

    @in_order(lambda self: self._shapes(), lambda self, x: self._node.named(x))
    def correct(self, x: Mapping[Any, Any]) -> Values:
        """The first controls, corrected for a newer state by the gains; use it between two solves.

        The correction is $u = u_0 + K Log(x_0^-1 x)$, clipped to the limits of the controls.

        Args:
            x: as for `feedback`.
        Raises:
            InputError, ShapeError: as `feedback` does.
            TrajectoryError: the plan is not a strict minimum.
        """
        solve, node = self.prepared, self._node
        moved = self._gains(node.n) @ node.difference(solve, node.read(x))
        here = slice(node.n, node.n + len(moved))
        flat = np.clip(solve.z[node.size :][: len(moved)] + moved, solve.lower[here], solve.upper[here])
        return {name: flat[columns].reshape(shape) for name, (columns, shape) in self.controls.items()}

    @property
    def xs(self) -> Values:
        """The states of the plan, by name, (nodes, ...)."""
        return dict(self.staged.point(self.prepared.z).xs)

    @property
    def us(self) -> Values:
        """The controls of the plan, by name, (intervals, ...)."""
        us = self.staged.point(self.prepared.z).us
        return {name: us[:, part].reshape(len(us), *shape) for name, (part, shape) in self.controls.items()}

    @property
    def ts(self) -> Array:
        """The times of the nodes, (nodes,), s, from now."""
        return np.asarray(self.part.mesh.shares * self.staged.point(self.prepared.z).border[0])

    # ---- C code -----------------------------------------------------------------------------------------------------

    def to_c(
        self,
        directory: str | Path,
        *,
        name: str = "controller",
        states: Sequence[Mapping[str, Any]] | None = None,
        tolerance: float = 1e-9,
        memory: int = MEMORY,
    ) -> CFiles:
        """Write C99 code: `name.h` with the interface, `name.c`, and `name_test.c` with reference values.

        The code consists of the solver's core, the functions of the problem, and `name_init`, `name_prepare`,
        `name_feedback` and `name_shift`, in double precision. `name_init` sets the present plan. The code allocates no
        memory, has no global state, and needs only libm. The header states the size of the workspace and the number of
        operations of an iteration.

        Args:
            directory: the folder of the files, which is created if missing.
            name: the name of the files, and the prefix of all functions.
            states: measured states of the test program, which shifts the plan after each of them; by default random
                states near the plan.
            tolerance: tolerance of the test program's comparison, relative to the largest entry of an iterate.
            memory: bytes that the controller may use for a faster solve; with 0 the memory is minimal. The header
                states its size.
        Returns:
            The paths `header`, `source` and `test`.
        Raises:
            TrajectoryError: a function of the problem has no scalar form.
            InputError: a name that is not a C identifier; a directory that is not writable, or that contains other
                files of these names.
        """
        return write_controller(self, directory, name=name, states=states, tolerance=tolerance, memory=memory)

    @property
    def measures(self) -> dict[str, float]:
        """Measures of the last solve in the solver's scales: cost, error, violation, iterations and others.

        A controller does not test for a minimum: `excess` is NaN, and `minimum` is 0 even at a minimum.
        """
        return self.prepared.measures


#: The `Status` for each exit status of the core.
_STATUS = {status: Status[status.name] for status in CoreStatus if status.name in Status.__members__}
_STATUS[CoreStatus.STOPPED] = Status.OUT_OF_TIME
