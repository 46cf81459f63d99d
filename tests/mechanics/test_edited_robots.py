"""Edits of public robots beside Pinocchio: removed limbs, locked joints, and trees with another root."""

from typing import Any

import numpy as np
import pytest
from mechanics_oracles import pose
from test_editing import inputs, near, random_state
from test_models_pinocchio import ROBOTS

from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import Mechanism

pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
pytestmark = pytest.mark.slow


def pair(name: str, *, floating: bool) -> tuple[Mechanism, Any]:
    """A robot, and Pinocchio's model of it on a free joint."""
    (path,) = ROBOTS.rglob(name)
    robot = mechanics.load(path, floating=floating, physical=False, quarter_turns=0.0)
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    model.armature[:] = 0.0
    return robot, model


def places(robot: Mechanism, model: Any, positions: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Pinocchio's positions, and its index of each of our velocities."""
    q, at = pin.neutral(model), np.zeros(robot.dofs, dtype=int)
    for segment in robot.segments:
        name = segment.link.joint.name
        joint = model.joints[model.getJointId("root_joint" if name == "root" else name)]
        x, place = positions[name], slice(joint.idx_q, joint.idx_q + joint.nq)
        q[place] = (
            x if joint.nq == 1 else pin.SE3ToXYZQUAT(pin.SE3(x)) if joint.nq == 7 else (np.cos(x[0]), np.sin(x[0]))
        )
        at[list(segment.freedoms)] = joint.idx_v + np.arange(joint.nv)
    return q, at


def compared(robot: Mechanism, model: Any, root: str | None = None) -> None:
    """Mass matrix, bias and accelerations. With `root` the base of the robot is this frame of the floating model."""
    fixed = root is not None and "root" not in robot.joints
    positions, rates = random_state(robot)
    state = inputs(robot, positions, rates)
    tau, data = np.linspace(-1.0, 1.0, robot.dofs), model.createData()
    wanted = {"M": mechanics.mass_matrix(robot), "b": mechanics.bias_forces(robot)}
    values = evaluated(wanted | {"qdd": mechanics.forward_dynamics(robot, tau=tau)}, state)
    q, at = places(robot, model, positions)
    new, G, a = np.zeros(model.nv), np.eye(model.nv), np.zeros(model.nv)
    new[at] = state["qd"]
    if root is not None:  # the velocities are G times those with the twist of the new root
        frame = model.getFrameId(root)
        pin.framesForwardKinematics(model, data, q)
        T = pin.SE3.Identity() if fixed else pin.SE3(positions["root"])
        q[:7] = pin.SE3ToXYZQUAT(T * data.oMf[frame].inverse() * data.oMi[1])
        pin.computeJointJacobians(model, data, q)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
        G = np.linalg.inv(np.vstack([J, np.eye(model.nv)[6:]]))
        pin.forwardKinematics(model, data, q, G @ new, a)
        a[:6] = -np.linalg.solve(J[:, :6], pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector)
    bias = (G.T @ pin.rnea(model, data, q, G @ new, a))[at]
    M = np.triu(pin.crba(model, data, q))
    M = (G.T @ (M + np.triu(M, 1).T) @ G)[np.ix_(at, at)]
    near(values["M"], M)
    near(values["b"], bias)
    # Accelerations are as uncertain as the mass matrix is ill-conditioned.
    near(M @ values["qdd"] + bias, tau, 1e-12 * (1.0 + np.max(np.abs(M) @ np.abs(values["qdd"]) + np.abs(bias))))


@pytest.mark.parametrize(
    ("name", "joint"),
    [("talos_reduced.urdf", "leg_left_1_joint"), ("g1_29dof_rev_1_0.urdf", "left_shoulder_pitch_joint")],
)
def test_without_a_limb_and_with_locked_joints(name: str, joint: str) -> None:
    robot, model = pair(name, floating=True)
    rng, locked = np.random.default_rng(0), list(robot.joints[-6::2])
    positions, q = dict(zip(locked, rng.uniform(-1.0, 1.0, size=3), strict=True)), pin.neutral(model)
    for one, x in positions.items():
        q[model.joints[model.getJointId(one)].idx_q] = x
    compared(robot.lock(positions), pin.buildReducedModel(model, [model.getJointId(one) for one in locked], q))
    limb = list(model.subtrees[model.getJointId(joint)])
    for i in limb:
        model.inertias[i] = pin.Inertia.Zero()
    compared(robot.without(robot.link(joint).name), pin.buildReducedModel(model, limb, q))


def test_an_arm_and_its_hand_with_another_root() -> None:
    (arm, model), (hand, other) = (pair(f"{name}.urdf", floating=False) for name in ("ur5_robot", "allegro_right_hand"))
    other = pin.buildModelFromUrdf(str(next(ROBOTS.rglob("allegro_right_hand.urdf"))))
    T = pose(np.random.default_rng(1))
    whole = arm.attach(hand, "tool0", T)
    both = pin.appendModel(model, other, model.getFrameId("tool0"), pin.SE3(T))
    for frame in ("palm_link", "link_2.0"):
        compared(whole.rerooted(frame), both, frame)
    compared(whole.rerooted("palm_link").rerooted("tool0"), both, "tool0")


def test_a_quadruped_with_another_root() -> None:
    robot, model = pair("solo12.urdf", floating=True)
    compared(robot.rerooted("HR_FOOT"), model, "HR_FOOT")
