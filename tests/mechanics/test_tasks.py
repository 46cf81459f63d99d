"""Tasks: Jacobians are derivatives of errors; operational space and computed torque do what they say."""

import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints_of_every_kind import mimicking_tree
from mechanics_oracles import pose

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import ModelError, ShapeError
from twistax.mechanics import (
    CenterOfMassTask,
    FrameTask,
    JointLimitTask,
    Link,
    LookAtTask,
    ManipulabilityTask,
    Mechanism,
    MomentumTask,
    OrientationTask,
    PositionTask,
    PostureTask,
    RelativeFrameTask,
    Task,
    joints,
)

EXAMPLES = Path(__file__).parents[2] / "examples"
RNG = np.random.default_rng(4)
TREE = mimicking_tree().mechanism
WIDTH = TREE.q["q"].shape[0]
TASKS: dict[str, Task] = {
    "frame": FrameTask("tool", pose(RNG)),
    "position": PositionTask("hinge", RNG.normal(size=3)),
    "orientation": OrientationTask("tool", pose(RNG)[:3, :3]),
    "relative": RelativeFrameTask("tool", "hinge", pose(RNG)),
    "look at": LookAtTask("tool", axis=(1.0, 2.0, -1.0), target=RNG.normal(size=3)),
    "posture": PostureTask(RNG.normal(size=WIDTH)),
    "center of mass": CenterOfMassTask(RNG.normal(size=3)),
}


def positions() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    x = {"q": rng.uniform(-1.0, 1.0, size=WIDTH), "root_position": pose(rng)}
    return x | {"ball_position": pose(rng)[:3, :3]}


def four_joints() -> Mechanism:
    """A Panda whose wrist does not move."""
    return mechanics.load(EXAMPLES / "panda.urdf").lock({"joint5": 0.1, "joint6": 1.0, "joint7": 0.2})


@functools.cache
def dynamics() -> Any:
    return tx.compile(TREE.inverse_system())


def rate_of(error: Any, x: dict[str, Any], qd: np.ndarray, h: float = 1e-4) -> Any:
    """The rate of an error along a motion that passes x at qd."""
    lowered, ends = tx.lower(error), list[Any]()
    for time in (h, -h):
        final = tx.integrate(dynamics(), {**x, "qd": qd}, t1=time, dt=h, u={"qdd": np.zeros(TREE.dofs)}).xs
        ends.append(np.asarray(lowered(0.0, {name: value[-1] for name, value in final.items() if name != "qd"})))
    return (ends[0] - ends[1]) / (2.0 * h)


@pytest.mark.parametrize("name", TASKS)
def test_a_jacobian_is_the_derivative_of_the_error(name: str) -> None:
    task, x = TASKS[name], positions()
    J = np.asarray(evaluated(task.jacobian(TREE), x))
    for qd in np.random.default_rng(3).normal(size=(2, TREE.dofs)):
        assert np.allclose(rate_of(task.error(TREE), x, qd), -J @ qd, atol=1e-5)
    assert np.abs(J).max() > 0.1


def test_momentum_limits_and_manipulability() -> None:
    arm, q = four_joints(), np.array([0.3, -0.4, 0.2, -2.0])
    momentum = MomentumTask(np.arange(6.0))
    A = evaluated([momentum.error(arm), momentum.jacobian(arm)], {"q": q})
    h = evaluated(mechanics.centroidal_momentum(arm), {"q": q, "qd": q})
    assert np.allclose(A[0], np.arange(6.0))
    assert np.allclose(A[1] @ q, h)
    e, J = evaluated([JointLimitTask().error(arm), JointLimitTask().jacobian(arm)], {"q": np.asarray(arm.q.max)})
    assert np.allclose(e, -1.0)
    assert np.allclose(np.diag(J), 2.0 / (np.asarray(arm.q.max) - np.asarray(arm.q.min)))
    lowered = tx.lower(mechanics.frame_jacobian(arm, "flange")[:3])

    def logarithm(q):
        J = lowered(0.0, {"q": q})
        return 0.5 * jnp.linalg.slogdet(J @ J.T + 1e-6 * np.eye(3))[1]

    task = ManipulabilityTask("flange", target=0.2)
    e, slope = evaluated([task.error(arm), task.jacobian(arm)], {"q": q})
    assert np.allclose(e, np.log(0.2) - logarithm(q), atol=1e-12)
    assert np.allclose(slope[0], jax.grad(logarithm)(q), atol=1e-9)


def test_manipulability_near_a_singular_configuration() -> None:
    """A yaw joint and two pitch joints, stretched out: J has rank 2."""
    body, at = mechanics.SpatialInertia(mass=1.0, inertia=np.eye(3)), tx.pose(position=[1.0, 0.0, 0.0])
    links = [
        Link(joints.Revolute("yaw", (0.0, 0.0, 1.0)), body, np.eye(4)),
        Link(joints.Revolute("shoulder", (0.0, 1.0, 0.0)), body, np.eye(4), parent="yaw"),
        Link(joints.Revolute("elbow", (0.0, 1.0, 0.0)), body, at, parent="shoulder"),
        Link(joints.Fixed("tool"), None, at, parent="elbow"),
    ]
    arm, task = Mechanism(links), ManipulabilityTask("tool", target=0.2)
    lowered = tx.lower([task.error(arm), task.jacobian(arm), mechanics.frame_jacobian(arm, "tool")[:3]])
    assert np.linalg.matrix_rank(np.asarray(lowered(0.0, {"q": np.zeros(3)})[2])) == 2
    for q in (np.zeros(3), np.array([0.3, 0.2, 1e-5]), np.array([0.3, 0.2, -1e-3])):
        e, slope, J = (np.asarray(value) for value in lowered(0.0, {"q": q}))
        assert np.allclose(e, np.log(0.2) - 0.5 * np.linalg.slogdet(J @ J.T + 1e-6 * np.eye(3))[1], atol=1e-8)
        for value, expected in zip(lowered(0.0, {"q": q.astype(np.float32)}), (e, slope), strict=False):
            assert np.allclose(value, expected, rtol=1e-4, atol=1e-4)


def test_operational_space_and_computed_torque() -> None:
    arm, rng = four_joints(), np.random.default_rng(0)
    q, qd, force, other = (rng.normal(size=k) for k in (4, 4, 3, 4))
    J = mechanics.frame_jacobian(arm, "flange", axes=mechanics.ALIGNED)[:3]
    space = mechanics.operational_space(arm, J)
    bias = mechanics.bias_forces(arm)
    tau = J.T @ (space.inertia @ tx.Constant(force)) + space.null_space @ tx.Constant(other) + bias
    moved = J @ mechanics.forward_dynamics(arm, tau=tau)
    x = {"q": q, "qd": qd}
    assert np.allclose(evaluated(moved, x), force)
    assert np.allclose(evaluated(J @ space.inverse, x), np.eye(3))
    wanted = mechanics.computed_torque(arm, q - arm.q, -arm.qd, stiffness=9.0, damping=6.0, acceleration=other)
    away = {"q": q + 0.1, "qd": qd}
    qdd = evaluated(mechanics.forward_dynamics(arm, tau=wanted), away)
    assert np.allclose(qdd, other - 6.0 * qd - 0.9)
    with pytest.raises(ShapeError, match=r"J with shape \(m, 4\)"):
        mechanics.operational_space(arm, np.eye(3))


def test_what_is_no_task(unchecked: None) -> None:
    arm = mechanics.load(EXAMPLES / "panda.urdf")
    for wrong, message in (
        (lambda: FrameTask("hand", weight=-1.0), "weight to be finite and 0 or more"),
        (lambda: FrameTask("hand", gain=np.inf), "gain to be finite and 0 or more"),
        (lambda: FrameTask("hand", np.zeros((4, 4))).error(arm), "target to be a pose"),
        (lambda: FrameTask("nothing").error(arm), "no frame 'nothing'"),
        (lambda: PostureTask(joints=["nothing"]).error(arm), "joint 'nothing'"),
        (lambda: PostureTask(joints=["root"]).error(TREE), "on a group"),
        (lambda: ManipulabilityTask("flange", target=0.0).error(arm), "target to be positive"),
        (lambda: ManipulabilityTask("joint1").jacobian(mechanics.chain_models.equal_links(2)), "singular everywhere"),
    ):
        with pytest.raises(ModelError, match=message):
            wrong()
