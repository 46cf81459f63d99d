"""The leap of a quadruped with complementarity constraints: against Pinocchio's inverse dynamics at each step, and
against IPOPT with a transcription by hand in CasADi.
"""

import functools
import os
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow
EXAMPLE = Path(__file__).parents[2] / "examples" / "leap.py"
MU, LEAST, GRAVITY = 0.6, 1e-3, 9.81  # friction, the last relaxation, m/s2
DIRECTIONS = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)


@functools.cache
def _run(folder: str) -> SimpleNamespace:
    pytest.importorskip("matplotlib")
    before = Path.cwd()
    os.chdir(folder)  # the example writes its figure there
    try:
        return SimpleNamespace(**runpy.run_path(str(EXAMPLE)))
    finally:
        os.chdir(before)


@pytest.fixture
def leap(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    return _run(str(tmp_path_factory.getbasetemp()))


def forces_of(leap: SimpleNamespace) -> Any:
    return np.stack([leap.result.us[f"force_{foot}"] for foot in leap.feet], axis=1)


def test_each_step_satisfies_dynamics_and_contact_laws_by_pinocchio(leap: SimpleNamespace) -> None:
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromXML(leap.robot.to_urdf())
    data, frames = model.createData(), [model.getFrameId(foot, pin.FrameType.BODY) for foot in leap.feet]
    xs, qdd, forces = leap.result.xs, leap.result.us["qdd"], forces_of(leap)

    def place(k: int) -> Any:
        angles = np.stack([np.cos(xs["q"][k]), np.sin(xs["q"][k])], axis=1).ravel()
        return np.concatenate([pin.SE3ToXYZQUAT(pin.SE3(xs["trunk_position"][k])), angles])

    h, places = leap.TIME / (leap.NODES - 1), [place(k) for k in range(leap.NODES)]
    flights = 0
    for k, (a, force) in enumerate(zip(qdd, forces), start=1):
        q, v = places[k], xs["qd"][k]
        np.testing.assert_allclose(xs["qd"][k - 1] + h * a, v, atol=1e-9)
        np.testing.assert_allclose(pin.difference(model, pin.integrate(model, places[k - 1], h * v), q), 0.0, atol=1e-9)
        tau = pin.rnea(model, data, q, v, a)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        for frame, f in zip(frames, force):
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
            tau, gap, slip = tau - J.T @ f, data.oMf[frame].translation[2], (J @ v)[:2]
            assert gap > -1e-6
            assert gap * f[2] < 1.01 * LEAST
            assert np.linalg.norm(f[:2]) <= MU * f[2] + 1e-5
            assert (MU * f[2] * DIRECTIONS @ slip + f[:2] @ slip).max() < 1.01 * LEAST
        np.testing.assert_allclose(tau[:6], 0.0, atol=1e-8)
        assert np.abs(tau[6:]).max() < 25.0 + 1e-5
        flights += force[:, 2].max() < 1.0
    assert flights >= 5


def test_ipopt_stays_at_the_optimum_by_a_transcription_by_hand(leap: SimpleNamespace) -> None:
    ca = pytest.importorskip("casadi")
    from scipy.spatial.transform import Rotation

    xs, K = leap.result.xs, leap.NODES - 1
    step = _step(ca, leap.TIME / K)
    T = xs["trunk_position"]
    turns = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    at = np.hstack([T[:, :3, 3], turns * np.sign(turns[:, 3:]), xs["q"], xs["qd"]]).T
    along = np.hstack([leap.result.us["qdd"], forces_of(leap).reshape(K, 12)]).T
    opti = ca.Opti()
    x, u = opti.variable(37, K + 1), opti.variable(30, K)
    zero, below, tau, costs, heights = step.map(K)(x[:, :-1], x[:, 1:], u)
    opti.subject_to(ca.vec(zero) == 0.0)
    opti.subject_to(ca.vec(below) <= 0.0)
    opti.subject_to(opti.bounded(-25.0, ca.vec(tau), 25.0))
    opti.subject_to(opti.bounded(-15.0, ca.vec(x[25:, :]), 15.0))
    opti.subject_to(x[:, 0] == at[:, 0])
    opti.subject_to(heights[:, K // 2 - 1] >= leap.HIGH)
    opti.subject_to(x[:6, K] == ca.DM([leap.FAR, 0.0, leap.STAND, 0.0, 0.0, 0.0]))
    opti.subject_to(x[19:, K] == 0.0)
    opti.minimize(ca.sum2(costs))
    opti.set_initial(x, at)
    opti.set_initial(u, along)
    pushes = dict.fromkeys(("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac"), 1e-8)
    options = {"print_level": 0, "sb": "yes", "tol": 1e-8, "mu_init": 1e-9, "max_iter": 500, **pushes}
    opti.solver("ipopt", {"print_time": False}, options)
    opti.solve()
    assert opti.value(opti.f) == pytest.approx(leap.result.cost, rel=1e-5)


def _step(ca: Any, h: float) -> Any:
    """A step of the backward Euler method as a function of states (p, quaternion, q, v, w, q') at both ends, and of
    (accelerations, forces): its equations, inequalities, torques, cost and the heights of the feet.
    """
    p, turn, q, qd = ca.SX.sym("p", 3), ca.SX.sym("turn", 4), ca.SX.sym("q", 12), ca.SX.sym("qd", 18)
    before = ca.SX.sym("before", 37)
    qdd, f = ca.SX.sym("qdd", 18), ca.SX.sym("f", 12)
    base, tau, feet = _newton_euler(ca, p, turn, q, qd, qdd, f)
    v, w = qd[:3], qd[3:6]
    turning = 0.5 * ca.vertcat(turn[3] * w + ca.cross(turn[:3], w), -ca.dot(turn[:3], w))
    speed = ca.jtimes(feet, ca.vertcat(p, turn, q), ca.vertcat(_rotation(ca, turn) @ v, turning, qd[6:]))
    below = []
    for i in range(0, 12, 3):
        N, t, slip, gap = f[i + 2], f[i : i + 2], speed[i : i + 2], feet[i + 2]
        below += [-N, -gap, gap * N - LEAST, ca.dot(t, t) - (MU * N) ** 2]
        below += [MU * N * ca.dot(ca.DM(d), slip) + ca.dot(t, slip) - LEAST for d in DIRECTIONS]
    half, moved = _exponential(ca, h * w, h * v)
    start = before[3:7]
    product = ca.vertcat(
        start[3] * half[:3] + half[3] * start[:3] + ca.cross(start[:3], half[:3]),
        start[3] * half[3] - ca.dot(start[:3], half[:3]),
    )
    zero = ca.vertcat(
        p - before[:3] - _rotation(ca, start) @ moved,
        turn - product,
        q - before[7:19] - h * qd[6:],
        qd - before[19:] - h * qdd,
        base,
    )
    cost = h * (1e-2 * ca.dot(tau, tau) + 1e-4 * ca.dot(qdd, qdd) + 1e-4 * ca.dot(f, f))
    after, controls = ca.vertcat(p, turn, q, qd), ca.vertcat(qdd, f)
    return ca.Function("step", [before, after, controls], [zero, ca.vertcat(*below), tau, cost, feet[2::3]])


def _rotation(ca: Any, turn: Any) -> Any:
    K = ca.skew(turn[:3])
    return ca.SX.eye(3) + 2.0 * turn[3] * K + 2.0 * K @ K


def _exponential(ca: Any, w: Any, v: Any) -> tuple[Any, Any]:
    """The quaternion and the translation of Exp([v; w])."""
    square = ca.dot(w, w) + 1e-30
    angle, K = ca.sqrt(square), ca.skew(w)
    half = ca.vertcat(ca.sin(angle / 2.0) / angle * w, ca.cos(angle / 2.0))
    left = (1.0 - ca.cos(angle)) / square * K + (angle - ca.sin(angle)) / (square * angle) * K @ K
    return half, v + left @ v


def _newton_euler(ca: Any, p: Any, turn: Any, q: Any, qd: Any, qdd: Any, f: Any) -> tuple[Any, Any, Any]:
    """Force and torque that are left at the trunk, torques of the joints, and positions of the feet, by vectors."""
    bar, down = np.diag([2e-3, 2e-3, 2e-4]), (0.0, 0.0, -0.18)
    bodies: list[Any] = [(None, None, None, 8.0, 0.0, np.diag([0.06, 0.16, 0.19]))]  # parent, axis, offset, mass, com z
    for x, y in ((0.2, 0.12), (0.2, -0.12), (-0.2, 0.12), (-0.2, -0.12)):
        first = len(bodies)
        bodies.append((0, (1, 0, 0), (x, y, 0.0), 0.2, 0.0, np.diag([2e-4] * 3)))
        bodies.append((first, (0, 1, 0), (0.0, 0.0, 0.0), 0.6, -0.08, bar))
        bodies.append((first + 1, (0, 1, 0), down, 0.2, -0.08, 0.4 * bar))
    R0, v, w = _rotation(ca, turn), qd[:3], qd[3:6]
    states = [(R0, p, w, qdd[3:6], qdd[:3] + ca.cross(w, v) + GRAVITY * R0.T @ ca.DM([0.0, 0.0, 1.0]))]
    turns: list[Any] = [None]
    for i, (parent, axis, offset, *_) in enumerate(bodies[1:]):
        R_parent, place, w, alpha, a = states[parent]
        n, r, K = ca.DM(axis), ca.DM(offset), ca.skew(ca.DM(axis))
        R = ca.SX.eye(3) + ca.sin(q[i]) * K + (1.0 - ca.cos(q[i])) * K @ K
        turned = R.T @ w
        spin = R.T @ alpha + n * qdd[6 + i] + ca.cross(turned, n * qd[6 + i])
        carried = R.T @ (a + ca.cross(alpha, r) + ca.cross(w, ca.cross(w, r)))
        states.append((R_parent @ R, place + R_parent @ r, turned + n * qd[6 + i], spin, carried))
        turns.append(R)
    F, M = [ca.SX.zeros(3) for _ in bodies], [ca.SX.zeros(3) for _ in bodies]
    tau, feet = [None] * 12, [None] * 4
    for i in reversed(range(13)):
        parent, axis, offset, mass, z, inertia = bodies[i]
        (R, place, w, alpha, a), c, I = states[i], ca.DM([0.0, 0.0, z]), ca.DM(inertia)
        force = mass * (a + ca.cross(alpha, c) + ca.cross(w, ca.cross(w, c)))
        M[i] += I @ alpha + ca.cross(w, I @ w) + ca.cross(c, force)
        F[i] += force
        if i and i % 3 == 0:  # a shank, with its foot
            leg = i // 3 - 1
            push = R.T @ f[3 * leg : 3 * leg + 3]
            F[i], M[i], feet[leg] = F[i] - push, M[i] - ca.cross(ca.DM(down), push), place + R @ ca.DM(down)
        if i:
            tau[i - 1] = ca.dot(ca.DM(axis), M[i])
            F[parent] += turns[i] @ F[i]
            M[parent] += turns[i] @ M[i] + ca.cross(ca.DM(offset), turns[i] @ F[i])
    return ca.vertcat(F[0], M[0]), ca.vertcat(*tau), ca.vertcat(*feet)
