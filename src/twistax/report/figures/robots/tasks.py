"""Inverse kinematics, differential control and regressors of robots from files, beside the packages of their users."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

import twistax as tx

from .... import mechanics
from ....mechanics import (
    CenterOfMassTask,
    DifferentialController,
    FrameTask,
    Mechanism,
    PostureTask,
    ReachStatus,
    reach,
)
from ...harness.expected import at_most, between, needed
from ...harness.measurement import Section, slow
from ...harness.timing import Race, Timed, agree, batch, printed, seconds_of
from .mechanisms import robot_file

_TIP, _TOLERANCE, _SEEDS, _ITERATIONS = "panda_hand", 1e-5, 8, 100
#: Poses for the packages that solve one pose after the other.
_FEW = 1000

# ---- inverse kinematics ----------------------------------------------------------------------------------------------


@functools.cache
def _panda() -> Mechanism:
    return mechanics.load(robot_file("Panda")[0])


@functools.cache
def _poses() -> tuple[Array, Array]:
    """10,000 positions within the limits of the Panda, and the poses of its hand there."""
    arm, hand = _panda(), tx.lower(_panda().pose(_TIP))
    q = np.random.default_rng(0).uniform(arm.q.min, arm.q.max, size=(10_000, arm.dofs))
    return q, np.asarray(jax.jit(jax.vmap(lambda q: hand(0.0, {"q": q})))(q))


def _starts() -> Array:
    """The seeds of all packages: the middle of the limits, and random positions."""
    low, high = np.asarray(_panda().q.min), np.asarray(_panda().q.max)
    more = np.random.default_rng(1).uniform(low, high, size=(_SEEDS - 1, len(low)))
    return np.concatenate([[0.5 * (low + high)], more])


def _statuses(T: Array) -> Callable[[], Any]:
    return lambda: reach(_panda(), {_TIP: T}, seeds=_SEEDS).status


def _reached(count: int) -> float:
    return float(np.mean(np.asarray(_statuses(_poses()[1][:count])()) == ReachStatus.REACHED))


def _batched() -> float:
    """The wall time of a pose in a batch, us."""
    call, count = _statuses(_poses()[1]), len(_poses()[1])
    jax.block_until_ready(call())
    return median(seconds_of(call) for _ in range(3)) / count * 1e6


@functools.cache
def _one_call() -> float:
    """The median wall time of calls for one pose, ms."""
    jax.block_until_ready(_statuses(_poses()[1][0])())
    return median(seconds_of(_statuses(T)) for T in _poses()[1][:_FEW]) * 1e3


def _repeated(solve: Callable[[int, Array], bool]) -> tuple[float, float]:
    """The share of poses that a package reaches from one of the seeds, and the wall time of a pose, ms."""
    starts, begin = _starts(), time.perf_counter()
    reached = sum(any(solve(i, start) for start in starts) for i in range(_FEW))
    return reached / _FEW, (time.perf_counter() - begin) / _FEW * 1e3


def _until_reached(step: Any, configuration: Any, task: Any) -> bool:
    """Newton steps of a differential solver with limits, as its documentation integrates them."""
    for _ in range(_ITERATIONS):
        error = task.compute_error(configuration)
        if max(np.linalg.norm(error[:3]), np.linalg.norm(error[3:])) < _TOLERANCE:
            return True
        configuration.integrate_inplace(step(configuration, [task], 1.0, solver="daqp", damping=1e-8), 1.0)
    return False


@functools.cache
def _pink() -> tuple[float, float]:
    pin, pink = needed("pinocchio", "pin"), needed("pink", "pin-pink")
    model = pin.buildModelFromUrdf(str(robot_file("Panda")[0]))
    data, T = model.createData(), [pin.SE3(T) for T in _poses()[1][:_FEW]]

    def solve(i: int, start: Array) -> bool:
        task = pink.tasks.FrameTask(_TIP, 1.0, 1.0)
        task.set_target(T[i])
        return _until_reached(pink.solve_ik, pink.Configuration(model, data, start), task)

    return _repeated(solve)


@functools.cache
def _mink() -> tuple[float, float]:
    mink, mujoco = needed("mink"), needed("mujoco")
    text = _panda().to_mjcf(leave_out=["speed", "frames", "shapes", "collision"])
    model, tip = mujoco.MjModel.from_xml_string(text), "panda_link7"
    T = [mink.Configuration(model, q).get_transform_frame_to_world(tip, "body") for q in _poses()[0][:_FEW]]

    def solve(i: int, start: Array) -> bool:
        task = mink.FrameTask(tip, "body", 1.0, 1.0)
        task.set_target(T[i])
        return _until_reached(mink.solve_ik, mink.Configuration(model, start), task)

    return _repeated(solve)


@functools.cache
def _frax() -> tuple[float, float]:
    """Damped least squares with clipped limits over frax's kinematics, all seeds and poses as one batch."""
    robot, arm = needed("frax.robots.franka_panda", "frax").load_panda(), _panda()
    low, high = jnp.asarray(arm.q.min), jnp.asarray(arm.q.max)

    def error(q: Any, T: Any) -> Any:
        X = robot.ee_transform(q)
        return jnp.concatenate([T[:3, 3] - X[:3, 3], X[:3, :3] @ tx.SO3.log(X[:3, :3].T @ T[:3, :3])])

    def left(start: Any, T: Any) -> Any:
        def step(q: Any, _: Any) -> Any:
            J = robot.ee_jacobian(q)
            return jnp.clip(q + J.T @ jnp.linalg.solve(J @ J.T + 1e-6 * jnp.eye(6), error(q, T)), low, high), None

        e = error(jax.lax.scan(step, start, None, length=_ITERATIONS)[0], T)
        return jnp.maximum(jnp.linalg.norm(e[:3]), jnp.linalg.norm(e[3:]))

    starts = jnp.asarray(_starts())
    solve = jax.jit(jax.vmap(lambda T: jnp.min(jax.vmap(lambda start: left(start, T))(starts))))
    T = jax.jit(jax.vmap(robot.ee_transform))(_poses()[0][:_FEW])
    remains = np.asarray(solve(T))
    return float(np.mean(remains < _TOLERANCE)), seconds_of(lambda: solve(T)) / _FEW * 1e3


def _beside(name: str, solve: Callable[[], tuple[float, float]], ours: Callable[[], float]) -> Section:
    """The share of poses that another package reaches, and its time over ours."""
    what = f"the same, {_FEW} poses, {name}"
    return [
        slow(f"{what}: reached", name, between(), lambda: solve()[0]),
        slow(f"{what}: time over ours", name, between(low=1.0), lambda: solve()[1] / ours()),
    ]


# ---- differential control --------------------------------------------------------------------------------------------

_ENDS = ("left_wrist_yaw_link", "right_wrist_yaw_link", "left_ankle_roll_link", "right_ankle_roll_link")


def _controllers() -> dict[str, Timed]:
    """A step of six tasks of a G1 (35 degrees of freedom), ours and pink's."""
    pin, pink, (path, _) = needed("pinocchio", "pin"), needed("pink", "pin-pink"), robot_file("G1")
    robot, dt, root = mechanics.load(path, floating=True), 0.01, np.asarray(tx.pose(position=[0.1, 0.2, 0.8]))
    low, high = np.asarray(robot.q["q"].min), np.asarray(robot.q["q"].max)
    q = np.clip(0.2 * np.random.default_rng(0).normal(size=len(low)), low + 0.05, high - 0.05)
    x = {"q": q, "root_position": root}
    wanted = {name: robot.pose(name) for name in _ENDS} | {"center": mechanics.center_of_mass(robot)}
    at = {name: np.array(value) for name, value in tx.lower(wanted)(0.0, x).items()}
    for hand in _ENDS[:2]:
        at[hand][:3, 3] += [0.05, 0.02, 0.08]
    at["center"] += [0.01, 0.0, 0.0]
    tasks = [FrameTask(name, at[name], weight=[1, 1, 1, 0.5, 0.5, 0.5], gain=20.0, damping=1e-2) for name in _ENDS]
    controller = DifferentialController(
        robot,
        [*tasks, CenterOfMassTask(at["center"], weight=2.0, gain=10.0), PostureTask(0.5 * q, weight=0.1, gain=5.0)],
        dt=dt,
    )
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    place = lambda angles: np.concatenate([pin.SE3ToXYZQUAT(pin.SE3(root)), angles])  # noqa: E731
    theirs: list[Any] = []
    for name in _ENDS:
        theirs.append(pink.tasks.FrameTask(name, 1.0, 0.5, gain=20.0 * dt, lm_damping=1e-2))
        theirs[-1].set_target(pin.SE3(at[name]))
    theirs.append(pink.tasks.ComTask(cost=2.0, gain=10.0 * dt))
    theirs[-1].set_target(at["center"])
    theirs.append(pink.tasks.PostureTask(cost=0.1, gain=5.0 * dt))
    theirs[-1].set_target(place(0.5 * q))
    configuration = pink.Configuration(model, model.createData(), place(q))
    return {
        "pink": Timed(lambda: pink.solve_ik(configuration, theirs, dt, solver="daqp")),
        "twistax": Timed(lambda: controller(x).qd),
    }


_CONTROLLERS = Race(_controllers, 1e-6)

# ---- regressors ------------------------------------------------------------------------------------------------------


def _regressors() -> dict[str, Timed]:
    """The regressor of a Panda in a batch, compared with Pinocchio's, which is called for one point after the other."""
    pin, path, count = needed("pinocchio", "pin"), robot_file("Panda")[0], 1000
    arm = mechanics.load(path, quarter_turns=0.0)  # angles as they are in the file
    q, qd, qdd = tx.State("q", shape=(arm.dofs,)), tx.State("qd", shape=(arm.dofs,)), tx.Control("qdd", (arm.dofs,))
    known = mechanics.inverse_dynamics_regressor(arm, q, qd, qdd, drives=[])
    system = tx.System(rates={q: qd, qd: qdd}, outputs={"Y": known.matrix})
    dynamics = tx.compile(system, backend=tx.Native(threads=1))
    points = np.random.default_rng(2).normal(size=(3, count, arm.dofs))
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    ours = batch(lambda q, qd, qdd: dynamics.outputs(0.0, {"q": q, "qd": qd}, {"qdd": qdd})["Y"], *points)

    def theirs() -> Array:
        for q, qd, qdd in zip(*points, strict=True):
            pin.computeJointTorqueRegressor(model, data, q, qd, qdd)
        return data.jointTorqueRegressor

    # A column of ours belongs to a link, one of Pinocchio's to a joint with all links that are fixed to it.
    Y = np.asarray(ours.call())[-1]
    column = {name: k for k, name in enumerate(known.names)}
    columns = [column[f"panda_link{i}.{part}"] for i in range(1, 8) for part in _BODY]
    agree(float(np.abs(Y[:, columns] - theirs()).max() / np.abs(Y).max()), 1e-12)
    return {"twistax": ours, "Pinocchio": Timed(theirs, count)}


_BODY = ("mass", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_REGRESSORS = Race(_regressors, np.inf, read=lambda result: 0.0)

# ---- compilation -----------------------------------------------------------------------------------------------------

_COMPILE = """
import re, sys, time, numpy as np, jax, twistax as tx
from twistax import mechanics
jax.config.update("jax_enable_x64", True)
tx.compile(tx.System(rates={{(x := tx.State("x")): -x}}))(0.0, {{"x": 1.0}})
memory = lambda: float(re.search(r"VmHWM:\\s*([0-9]+)", open("/proc/self/status").read())[1]) / 1024.0
before, begin = memory(), time.process_time()
dynamics = tx.compile(mechanics.load({path!r}, floating=True, physical=False).system())
x = {{s.name: np.eye(4) if s.name == "root_position" else np.zeros(s.shape) for s in dynamics.system.states}}
u = {{c.name: np.zeros(c.shape) for c in dynamics.system.controls}}
jax.block_until_ready(dynamics(0.0, x, u))
if {jacobian}:
    jax.block_until_ready(dynamics.jacobian(0.0, x, u))
print(time.process_time() - begin if {seconds} else memory() - before)
"""


def _compiling(robot: str, jacobian: bool, seconds: bool) -> float:
    """The processor time from the file to the first result, s, or the memory that it takes, MB, in a new process."""
    code = _COMPILE.format(path=str(robot_file(robot)[0]), jacobian=jacobian, seconds=seconds)
    return printed(code, TWISTAX_CACHE="off", JAX_PLATFORMS="cpu")


def _compilations(robot: str, value: float, both: float) -> Section:
    return [
        slow(f"compiling {robot} from its file", "tx.compile", at_most(value, "s"), _compiling, robot, False, True),
        slow(f"the same, and its Jacobian: {robot}", "tx.compile", at_most(both, "s"), _compiling, robot, True, True),
        slow(f"peak memory of both: {robot}", "tx.compile", at_most(300.0, "MB"), _compiling, robot, True, False),
    ]


ROBOTS: Section = [
    slow("10,000 poses of a Panda within its limits, 8 seeds: reached", "reach", between(low=0.995), _reached, 10_000),
    slow("the same: a pose of a batch", "reach", at_most(100.0, "us"), _batched),
    slow("the same: one call", "reach", at_most(2.0, "ms"), _one_call),
    slow(f"the same, {_FEW} poses: reached", "reach", between(low=0.995), _reached, _FEW),
    *_beside("pink", _pink, _one_call),
    *_beside("mink", _mink, _one_call),
    *_beside("frax", _frax, lambda: _batched() * 1e-3),
    slow(
        "G1, 35 degrees of freedom, 6 tasks: a step",
        "DifferentialController",
        at_most(500.0, "us"),
        _CONTROLLERS.seconds,
        "twistax",
        1e-6,
    ),
    slow("the same: time over pink", "DifferentialController", between(), _CONTROLLERS.ratio, "twistax", "pink"),
    slow(
        "regressor of a Panda, 1,000 points: time over Pinocchio",
        "inverse_dynamics_regressor",
        at_most(1.0),
        _REGRESSORS.ratio,
        "twistax",
        "Pinocchio",
    ),
    *_compilations("ANYmal", 4.0, 9.0),
    *_compilations("G1", 7.0, 16.0),
]
