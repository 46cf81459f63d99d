"""Two bodies that a very stiff spring and damper hold together at a point: a ball joint in penalty form."""

import numpy as np

import twistax as tx

from ..scene import Array, Scene, about, newton_euler, placed, said, stored_end, total_momentum

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
    momenta = []
    for g, V, m, J, force in zip(poses, twists, MASSES, MOMENTS, (pull, -pull)):
        M, R = np.array([*3 * (m,), *J]), g[:3, :3]
        body_force = R.T @ force
        wrench = tx.lie.wrench(force=body_force, torque=tx.linalg.Cross(R.T @ (middle - g[:3, 3]), body_force))
        rates |= {g: V, V: newton_euler(M, V, wrench)}
        momenta.append(M * V)
    return tx.System(rates=rates, outputs={"gap": tx.linalg.Norm(gap), **total_momentum(poses, momenta)})


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


STIFF_JOINT = Scene(
    **said("stiff-joint"),
    build=system,
    start=_start(),
    duration=2.0,
    params={"k": STIFFNESS, "c": DAMPING},
    reference=stored_end("stiff-joint"),
    invariants=("linear_momentum", "angular_momentum"),
)
