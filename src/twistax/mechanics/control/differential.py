"""Differential inverse kinematics: velocities that best satisfy several tasks within limits, by a quadratic program."""

from __future__ import annotations

import copy
import dataclasses
import enum
import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import instance, listed, number, real_array, reals
from ...errors import InputError, ModelError
from ...progress import FirstCalls
from ...scalar.fast import part_of_package
from ...scalar.varying_entries import varying_entries
from ...solver.qp import QPStatus
from ...solver.squares import LeastSquares
from ...system.export import CFiles
from ..algorithms.dynamics import checked
from ..kinematic_tree import KinematicTree
from ..tasks.configuration_space import Arrays, ConfigurationSpace
from ..tasks.rows import ConstraintRows, TaskRows, inputs_of
from ..tasks.task import Task
from .velocity_limits import VelocityBounds, as_freedoms, constraint_bounds, velocity_bounds


class StepStatus(enum.IntEnum):
    """The status of a step of a `DifferentialController`.

    - `SOLVED`: the velocities are the optimum.
    - `OVERRUN`: the velocities are the optimum, but under the acceleration limit a joint cannot stop before its
      position limit, or cannot reduce its speed to the speed limit in one step, or a constraint cannot hold. They
      brake; `DifferentialStep.overrun` names the joint, or those that move the constraint.
    - `INFEASIBLE`: no velocities satisfy the equalities, the constraints and the limits together.
    - `NOT_FINITE`: positions, targets or velocities have an entry that is not finite.
    - `FAILED`: the solver stopped before it found the optimum.

    In the last three cases, the velocities are as close to zero as the limits allow.
    """

    SOLVED = 0
    OVERRUN = 1
    INFEASIBLE = 2
    NOT_FINITE = 3
    FAILED = 4


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["qd", "x", "status", "errors", "overrun", "constraints", "start", "iterations"],
    meta_fields=["joints"],
)
@dataclasses.dataclass(frozen=True)
class DifferentialStep:
    """The result of a step; arrays have leading axes under `jax.vmap`.

    Attributes:
        qd: (n,) velocities.
        x: the positions after dt at these velocities.
        status: (), the number of a `StepStatus`.
        errors: by task the error e (m,) before the step; the equalities follow the tasks.
        overrun: (n,) whether a joint cannot satisfy its limits, or moves a constraint that cannot hold.
        constraints: residuals (k,) before the step; satisfied if not positive.
        start: the start of the solver for the next step.
        iterations: () iterations of the solver; 0 if its start was optimal.
        joints: the name of the joint for each degree of freedom.
    """

    qd: jax.Array
    x: dict[str, jax.Array]
    status: jax.Array
    errors: tuple[jax.Array, ...]
    overrun: jax.Array
    constraints: jax.Array
    start: jax.Array
    iterations: jax.Array
    joints: tuple[str, ...]


class DifferentialController:
    """Differential inverse kinematics: joint velocities for several weighted tasks, within limits.

    A call solves a dense quadratic program,

        minimise the sum of $|w (J qd - k e)|^2 / 2$ over tasks, $+ (mu + regularization) |qd|^2 / 2$, subject to $J qd
        = k e$ for the equalities, $c' <= -k_c c$ for the constraints $c(q) <= 0$,
                    and limits of position, speed and acceleration,

    with weights w, gains k and errors e of the tasks, and mu from their `damping`. With acceleration limits, $c'$ is
    also limited so that the constraint can stop at zero, with half of its largest deceleration. It works under `jit`
    and `vmap`. Positions have the form that `reach` and `tx.integrate` use. Weights, gains, limits and dt are arguments
    of the compiled function, so `replace` does not recompile.

    Source: S. Caron and others, Pink (2022), for the cost and the damping; O. Kanoun, F. Lamiraux, P. Wieber, Kinematic
    control of redundant manipulators, IEEE Transactions on Robotics 27 (2011), for limits in the program.

    Args:
        mechanism: a tree or a chain without loop constraints.
        tasks: the weighted tasks.
        dt: the period, s.
        equalities: tasks that are satisfied exactly, such as feet that do not move; their weights are ignored.
        constraints: inequalities of positions, such as {"table": signed_distance(...) >= 0.02}, as for `tx.System`.
        speed: limits of velocities, a number or (n,). None: the limits of the joints.
        acceleration: limits of accelerations, a number or (n,), infinite for no limit. None: no limits.
        limit_gain: the largest fraction of the distance to a position limit that a step may move, for joints without an
            acceleration limit.
        constraint_gain: $k_c$, 1/s. None: half of 1/dt.
        regularization: a term on the diagonal of the Hessian, which makes velocities zero that no task determines.
    Raises:
        ModelError: loop constraints, no tasks, an object that is not a task or not an inequality, or an unknown frame.
        InputError: a number out of its range.

    Example:
        `DifferentialController(arm, [FrameTask("flange", target=T), PostureTask(q0, weight=1e-3)], dt=1e-3)({"q": q})`
    """

    def __init__(
        self,
        mechanism: KinematicTree,
        tasks: Iterable[Task],
        *,
        dt: float,
        equalities: Iterable[Task] = (),
        constraints: Any = (),
        speed: Any = None,
        acceleration: Any = None,
        limit_gain: float = 0.5,
        constraint_gain: float | None = None,
        regularization: float = 1e-12,
    ) -> None:
        owner = "DifferentialController"
        checked(owner, mechanism)
        self.mechanism, self.space = mechanism, ConfigurationSpace(owner, mechanism)
        self.tasks = TaskRows(owner, self.space, tasks)
        self.equalities = TaskRows(owner, self.space, equalities)
        self.constraints = ConstraintRows(owner, self.space, constraints)
        if not self.tasks.tasks:
            raise ModelError(f"{owner} expects tasks, got none")
        parts = [*(self.tasks.expressions or ()), *(self.equalities.expressions or ())]
        parts += [] if self.constraints.expression is None else [self.constraints.expression]
        #: The controls and parameters that are the targets of calls.
        self.controls, self.parameters = inputs_of(owner, self.space, parts)
        self.expressions = parts
        n, sizes = mechanism.dofs, (sum(self.tasks.sizes), sum(self.equalities.sizes))
        self.solver = LeastSquares(n, *sizes, sum(self.constraints.sizes.values()))
        self.settings = _Settings(self, dt, speed, acceleration, limit_gain, constraint_gain, regularization)
        self._after = part_of_package(self.space.after)
        self._call = jax.jit(self._step)
        self._first_calls = FirstCalls("DifferentialController")

    def replace(
        self, *, tasks: Iterable[Task] | None = None, equalities: Iterable[Task] | None = None, **changes: Any
    ) -> DifferentialController:
        """A copy with other `dt`, `speed`, `acceleration`, `limit_gain`, `constraint_gain` or `regularization`.

        It recompiles only if acceleration limits are added or removed.

        Args:
            tasks, equalities: the controller's tasks with other weights, gains or damping, made by
                `dataclasses.replace`.
        Raises: InputError for numbers out of their range; ModelError for other tasks.
        """
        owner, controller = "DifferentialController", copy.copy(self)
        if unknown := sorted(set(changes) - set(self.settings.arguments)):
            raise InputError(
                f"{owner}: the arguments of replace are {listed(self.settings.arguments)}, got {listed(unknown)}"
            )
        if tasks is not None:
            controller.tasks = self.tasks.with_numbers(owner, tasks)
        if equalities is not None:
            controller.equalities = self.equalities.with_numbers(owner, equalities)
        controller.settings = _Settings(controller, **{**self.settings.arguments, **changes})
        return controller

    def __call__(
        self,
        x: Mapping[str, Any],
        targets: Mapping[str, Any] | None = None,
        *,
        qd: Any = None,
        warm: DifferentialStep | None = None,
    ) -> DifferentialStep:
        """The velocities for a step.

        Args:
            x: positions by state, "q" (w,) and "<joint>_position" on groups.
            targets: by name, for tasks without a fixed target. A numeric target that is omitted keeps its value.
            qd: present velocities (n,), required for acceleration limits.
            warm: the previous step, whose active set is tried first.
        Raises: InputError for unknown or missing names, or arrays of the wrong shape.
        """
        mapping = "arrays by name, such as {'q': q}"
        instance("DifferentialController: x", x, Mapping, mapping, InputError)
        instance("DifferentialController: targets", targets, Mapping | None, mapping, InputError)
        x = {name: _real(name, value) for name, value in x.items()}
        targets = {name: _real(name, value) for name, value in (targets or {}).items()}
        known = [leaf.name for leaf in (*self.controls, *self.parameters)]
        if unknown := [name for name in targets if name not in known]:
            raise InputError(f"DifferentialController has no target {unknown[0]!r}; known are {listed(known)}")
        if missing := [leaf.name for leaf in self.controls if leaf.name not in targets]:
            raise InputError(f"DifferentialController expects targets for {listed(missing)}, got {listed(targets)}")
        if set(x) != set(self.space.names):
            raise InputError(f"DifferentialController: x expects {listed(self.space.names)}, got {listed(x)}")
        limited = self.settings.limits_acceleration
        if limited and qd is None:
            raise InputError(
                "DifferentialController expects the present velocities qd, because it has acceleration limits"
            )
        qd = _real("qd", qd) if limited else None
        if limited and np.shape(qd) != (self.mechanism.dofs,):
            raise InputError(f"DifferentialController expects qd ({self.mechanism.dofs},), got {np.shape(qd)}")
        instance("DifferentialController: warm", warm, DifferentialStep | None, "the step before", InputError)
        numbers, values, zero = self.settings.constants()
        params = {name: targets.pop(name, value) for name, value in values.items()}
        start = zero if warm is None else warm.start
        with self._first_calls(limited):
            step: DifferentialStep = self._call(x, targets, params, qd, start, numbers)
        return step

    def to_c(
        self,
        directory: str | Path,
        *,
        name: str = "differential",
        states: Sequence[tuple[Any, ...]] | None = None,
        tolerance: float = 1e-6,
    ) -> CFiles:
        """Write the step as C99 code without allocation and global state. It needs only libm.

        Weights, gains, limits and dt are constants of the files. The header documents the interface. The test program
        `<name>_test.c` exits with 0 if its velocities agree with those of Python.

        Args:
            directory: the folder of the files.
            name: the name of the files, and the prefix of C names.
            states: (x, targets, qd) for the test program; the last two are optional. None: random positions, for
                controllers whose tasks have fixed targets.
            tolerance: tolerance of the test program, relative to the largest velocity.
        Raises: InputError for invalid names, folders or states; ModelError for functions that have no C form.
        """
        from .code import write_differential

        return write_differential(self, directory, name=name, states=states, tolerance=tolerance)

    def problem(
        self, x: Arrays, u: Arrays, params: Arrays, qd: Any, numbers: Mapping[str, Any]
    ) -> tuple[tuple[Any, ...], VelocityBounds, Any, Any]:
        """The parts of the quadratic program in the order of `LeastSquares`, followed by bounds,
        errors and residuals.
        """
        dt = numbers["dt"]
        e, J = self.tasks(x, u, params)
        b, A = self.equalities(x, u, params)
        c, C = self.constraints(x, u, params)
        r = numbers["gains"] * e
        damped = numbers["damping"] * (numbers["weights"] * r * dt) ** 2
        mu = jnp.sum(damped) + numbers["regularization"]
        bounds = velocity_bounds(
            self.space, x, qd, dt, numbers["speed"], numbers["acceleration"], numbers["limit_gain"]
        )
        rows, late = constraint_bounds(c, C, qd, dt, numbers["acceleration"], numbers["constraint_gain"])
        bounds = bounds._replace(overrun=jnp.maximum(bounds.overrun, late))
        ends = (A, numbers["equality_gains"] * b, C, jnp.full_like(rows, -np.inf), rows, bounds.lower, bounds.upper)
        return (J, numbers["weights"] ** 2, r, mu, *ends), bounds, (e, b), c

    def _step(self, x: Arrays, u: Arrays, params: Arrays, qd: Any, start: Any, numbers: Any) -> DifferentialStep:
        wide = [value for value in (*x.values(), *u.values()) if jnp.issubdtype(value.dtype, jnp.floating)]
        dtype = jnp.result_type(*wide) if wide else jax.dtypes.canonicalize_dtype(float)
        cast = lambda tree: jax.tree.map(lambda a: jnp.asarray(a, dtype), tree)  # noqa: E731
        x, u, params, qd, numbers = (cast(part) for part in (x, u, params, qd, numbers))
        arguments, structure = jax.tree.flatten((x, u, params, qd, numbers))
        shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype), arguments)
        results = list[Any]()

        def flat(*arrays: Any) -> list[Any]:
            entries, shape = jax.tree.flatten(self.problem(*jax.tree.unflatten(structure, arrays)))
            results.append(shape)
            return entries

        entries = varying_entries(flat, *shapes)(*arguments)
        parts, bounds, (e, b), c = jax.tree.unflatten(results[0], entries)
        solution = self.solver(*parts, cast(start))
        solved = solution.status == QPStatus.SOLVED.value
        still = jnp.clip(jnp.zeros_like(bounds.lower), bounds.lower, bounds.upper)
        still = jnp.where(jnp.isfinite(still), still, 0.0)
        velocity = jnp.where(solved, solution.x, still)
        overrun = bounds.overrun > 0.0
        good = jnp.where(jnp.any(overrun), int(StepStatus.OVERRUN), int(StepStatus.SOLVED))
        finite = functools.reduce(jnp.logical_and, [jnp.all(~jnp.isnan(p)) for p in parts])
        bad = jnp.where(
            solution.status == QPStatus.INFEASIBLE.value, int(StepStatus.INFEASIBLE), int(StepStatus.FAILED)
        )
        bad = jnp.where(finite, bad, int(StepStatus.NOT_FINITE))
        errors = [*self._split(e, self.tasks.sizes), *self._split(b, self.equalities.sizes)]
        return DifferentialStep(
            qd=velocity,
            x=self._after(x, velocity * numbers["dt"]),
            status=jnp.where(solved, good, bad),
            errors=tuple(errors),
            overrun=overrun,
            constraints=c,
            start=solution.start,
            iterations=solution.iterations,
            joints=self.space.joints,
        )

    @staticmethod
    def _split(values: jax.Array, sizes: Sequence[int]) -> list[jax.Array]:
        return jnp.split(values, np.cumsum(sizes)[:-1]) if sizes else []


def _real(name: str, value: Any) -> Any:
    """The value as an array of real numbers. Usual arrays are returned without a call of NumPy, which takes time in a
    loop of control.
    """
    if (type(value) is np.ndarray or isinstance(value, jax.Array)) and value.dtype.kind in "fiu":
        return value
    return real_array(f"DifferentialController: {name}", value)


class _Settings:
    """The numbers of a controller, checked.

    Attributes:
        arguments: the values that the user passed.
        arrays: the values as arrays by name, for the compiled function.
        limits_acceleration: whether steps need present velocities.
    """

    def __init__(
        self,
        controller: DifferentialController,
        dt: float,
        speed: Any,
        acceleration: Any,
        limit_gain: float,
        constraint_gain: float | None,
        regularization: float,
    ) -> None:
        owner, n = "DifferentialController", controller.mechanism.dofs
        positive = lambda size: 0.0 < size < np.inf  # noqa: E731
        number(f"{owner}: dt", dt, "a positive number", positive)
        number(f"{owner}: limit_gain", limit_gain, "a number in (0, 1]", lambda size: 0.0 < size <= 1.0)
        number(f"{owner}: regularization", regularization, "a number of 0 or more", lambda size: 0.0 <= size < np.inf)
        chosen = 0.5 / dt if constraint_gain is None else constraint_gain
        number(f"{owner}: constraint_gain", chosen, "a positive number", positive)
        for name, value in (("speed", speed), ("acceleration", acceleration)):
            sizes = np.ones(()) if value is None else reals(f"{owner}: {name}", value, InputError)
            if sizes.shape not in ((), (n,)) or not (sizes > 0.0).all():
                raise InputError(f"{owner}: {name} expects positive numbers () or ({n},), got {value!r}")
        self.arguments = {"dt": dt, "speed": speed, "acceleration": acceleration, "limit_gain": limit_gain}
        self.arguments |= {"constraint_gain": constraint_gain, "regularization": regularization}
        most = controller.mechanism.qd.max
        tasks, equalities = controller.tasks, controller.equalities
        numbers = {
            "dt": dt,
            "gains": np.where(np.isnan(tasks.gains), 1.0 / dt, tasks.gains),
            "equality_gains": np.where(np.isnan(equalities.gains), 1.0 / dt, equalities.gains),
            "weights": tasks.weights,
            "damping": tasks.damping,
            "speed": as_freedoms(most if speed is None else speed, n, np.inf),
            "acceleration": as_freedoms(acceleration, n, np.inf),
            "limit_gain": limit_gain,
            "constraint_gain": chosen,
            "regularization": regularization,
        }
        self.arrays = {name: np.asarray(value, float) for name, value in numbers.items()}
        self.limits_acceleration = acceleration is not None
        values = {leaf.name: leaf.value for leaf in controller.parameters}
        self._constants = (self.arrays, values, np.zeros(controller.solver.start_size))
        self._placed = dict[Any, tuple[Arrays, Arrays, jax.Array]]()

    def constants(self) -> tuple[Arrays, Arrays, jax.Array]:
        """`arrays`, the values of the controller's parameters, and the start of a step without a previous one.

        They are arrays of JAX: a conversion would take a third of the time of each call.
        """
        dtype = jax.dtypes.canonicalize_dtype(float)
        if dtype not in self._placed:
            with jax.ensure_compile_time_eval():  # the first call may be inside a traced function
                self._placed[dtype] = jax.tree.map(lambda value: jnp.asarray(value, dtype), self._constants)
        return self._placed[dtype]
