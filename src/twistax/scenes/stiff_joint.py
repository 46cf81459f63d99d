"""Two bodies held together at a point by a very stiff spring and damper: a ball joint as simulators like to have it."""

from __future__ import annotations

import numpy as np

import twistax as tx

from .arrays import Array, about, placed
from .scene import Scene

__all__ = ["DAMPING", "MASSES", "MOMENTS", "POINTS", "STIFFNESS", "STIFF_JOINT", "system"]

#: N/m and N s/m: the joint gives way by 1e-8 m in 1 N, and its gap closes at some 1e4/s.
STIFFNESS, DAMPING = 1e8, 2e4
#: Masses, kg, and principal moments of inertia, kg m2.
MASSES = (1.0, 2.0)
MOMENTS = ((0.10, 0.15, 0.20), (0.50, 0.30, 0.40))
#: Where the joint is, in body axes of each body from its centre of mass, m.
POINTS = np.array([[0.5, -0.1, 0.2], [-0.6, 0.2, -0.1]])


def system() -> tx.System:
    """States g1, V1, g2, V2: poses (body to world, at the centres of mass) and body twists.

    M V' = W - ad*_V(M V). With d the gap between the two points and d' its rate, in world axes, the joint pulls them
    together with k d + c d'. Both forces act at the middle of the gap, so that they balance as wrenches too.
    Parameters: k, N/m; c, N s/m.

    Outputs: gap, |d|, m; and, constant in the true motion, linear_momentum (3,), N s, and angular_momentum (3,) about
    the world's origin, N m s, in world axes.
    """
    poses = [tx.State("g1", group=tx.SE3), tx.State("g2", group=tx.SE3)]
    twists = [tx.State("V1", shape=(6,)), tx.State("V2", shape=(6,))]
    k, c = tx.Parameter("k"), tx.Parameter("c")
    ends = [tx.lie.Act(g, point) for g, point in zip(poses, POINTS)]
    speeds = [g[:3, :3] @ (V[:3] + tx.linalg.Cross(V[3:], point)) for g, V, point in zip(poses, twists, POINTS)]
    gap = ends[1] - ends[0]
    pull = k * gap + c * (speeds[1] - speeds[0])
    middle = 0.5 * (ends[0] + ends[1])

    rates: dict[tx.State | str, tx.Expr] = {}
    momentum: tx.Expr = tx.Constant(np.zeros(6))
    for g, V, m, J, force in zip(poses, twists, MASSES, MOMENTS, (pull, -pull)):
        M, R = np.array([*3 * (m,), *J]), g[:3, :3]
        body_force = R.T @ force
        wrench = tx.lie.wrench(force=body_force, torque=tx.linalg.Cross(R.T @ (middle - g[:3, 3]), body_force))
        # As ad*_V(M V), without the round-off of v x m v, which is zero.
        spin = tx.lie.twist(linear=np.zeros(3), angular=tx.lie.angular(V))
        rates |= {g: V, V: (wrench - tx.lie.AdjointDual(spin, M * V)) / M}
        momentum = momentum + tx.lie.SE3AdjointDual(g) @ (M * V)
    return tx.System(
        rates=rates,
        outputs={
            "gap": tx.linalg.Norm(gap),
            "linear_momentum": tx.lie.linear(momentum),
            "angular_momentum": tx.lie.angular(momentum),
        },
    )


def _start() -> dict[str, Array]:
    """The points of the joint 1e-4 m apart, and drifting apart at 0.1 m/s."""
    R1, R2 = about((0.0, 0.0, 1.0), 0.4), about((0.6, 0.8, 0.0), 0.7)
    V1 = np.array([0.1, -0.2, 0.3, 1.0, 0.5, -1.2])
    w2 = np.array([-0.4, 0.8, 1.5])
    joint = R1 @ POINTS[0] + [1e-4, 0.0, 0.0]
    speed = R1 @ (V1[:3] + np.cross(V1[3:], POINTS[0])) + [0.0, 0.1, 0.0]
    return {
        "g1": placed(R1, np.zeros(3)),
        "V1": V1,
        "g2": placed(R2, joint - R2 @ POINTS[1]),
        "V2": np.concatenate([R2.T @ speed - np.cross(w2, POINTS[1]), w2]),
    }


# fmt: off
#: As `python -m twistax.scenes.references stiff-joint` finds it.
_END = {
    "g1": np.array(
        [
            [-0.2584095112351402, 0.5287089911519955, -0.8085117977978151, 2.208651344431769],
            [0.5342764348145276, -0.6190695253594174, -0.575588059269078, -0.23473337236860192],
            [-0.8048435970454718, -0.5807062299014062, -0.12250330137837644, 0.23759152272156825],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "V1": np.array([-0.10328209907931353, 0.6334966260873066, -0.8531285522139254, 1.7578141143033388,
                    0.019740611783841955, -1.3566378999062962]),
    "g2": np.array(
        [
            [-0.7631717968945125, -0.5289191977627273, -0.37123212504150793, 1.4756308656693045],
            [0.4738607889194474, -0.8486652557004193, 0.23499624782447234, 0.45674334378241505],
            [-0.4393458331991324, 0.0034301610712588414, 0.8983114564813172, -0.30572270743894103],
            [0.0, 0.0, 0.0, 1.0],
        ]
    ),
    "V2": np.array([-0.12757578203091605, -0.27677305172238614, -0.0038088902872072702, -0.6416267107663982,
                    0.8921111589503384, 1.053014512441119]),
}
# fmt: on

STIFF_JOINT = Scene(
    name="stiff-joint",
    title="two bodies on a stiff joint",
    summary=(
        "Two bodies of 1 and 2 kg tumble freely for 2 s, held together at a point by a spring of 1e8 N/m and a damper "
        "of 2e4 N s/m: the joint gives way by 2e-8 m and settles in a millisecond."
    ),
    source="written for this scene; Newton-Euler with the wrench of the joint",
    build=system,
    start=_start(),
    duration=2.0,
    params={"k": STIFFNESS, "c": DAMPING},
    reference=_END,
    invariants=("linear_momentum", "angular_momentum"),
)
