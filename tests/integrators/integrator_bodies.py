"""Bodies for the tests of the integrators, and an independent solution of one of them in NumPy and SciPy."""

import functools

import numpy as np
from scipy.integrate import solve_ivp

import twistax as tx
from oracles import skew

MASS = 2.0
CENTRE = np.array([0.1, -0.2, 0.3])
INERTIA = np.array([[1.0, 0.1, 0.0], [0.1, 2.0, -0.2], [0.0, -0.2, 3.0]])
GRAVITY = np.array([0.3, -0.2, -9.81])


def spatial_inertia(mass: float = MASS, centre: np.ndarray = CENTRE, inertia: np.ndarray = INERTIA) -> np.ndarray:
    """The 6x6 inertia about the body's origin, order [v; w]; `inertia` is about the centre of mass."""
    c = skew(centre)
    return np.block([[mass * np.eye(3), -mass * c], [mass * c, inertia - mass * c @ c]])


def start(rng: int = 3) -> dict[str, np.ndarray]:
    """A pose away from the identity and a twist in which everything moves."""
    rotation, _ = np.linalg.qr(np.random.default_rng(rng).normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = [0.5, -1.0, 2.0]
    return {"g": pose, "V": np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7])}


def starts(number: int) -> list[dict[str, np.ndarray]]:
    """Several starts: the mean error over them has no lucky zeros that bend a fitted order."""
    noise = np.random.default_rng(8).normal(size=(number, 6))
    return [start(i) | {"V": start()["V"] + 0.5 * noise[i]} for i in range(number)]


def free_body(order: tx.Order = tx.LINEAR_FIRST) -> tx.System:
    """A rigid body under no force, with an offset centre of mass."""
    inertia = spatial_inertia()
    if order != tx.LINEAR_FIRST:
        swap = [3, 4, 5, 0, 1, 2]
        inertia = inertia[np.ix_(swap, swap)]
    g, V = tx.State("g", group=tx.SE3, order=order), tx.State("V", shape=(6,))
    M = tx.Parameter("M", shape=(6, 6), value=inertia)
    return tx.System(rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V, order=order))})


@functools.cache
def forced() -> tx.Dynamics:
    """The forced body, compiled once for all tests."""
    return tx.compile(forced_body())


def forced_body() -> tx.System:
    """The same body with gravity at its centre of mass, drag, and a thrust that turns with time.

    Drag grows with the speed itself: with its square the rates would have no second derivative at rest, and methods of
    high order would not show it.
    """
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    M = tx.Parameter("M", shape=(6, 6), value=spatial_inertia())
    t = tx.Time()
    weight = g[:3, :3].T @ (MASS * GRAVITY)
    drag = -0.3 * V[:3]
    thrust = tx.Concat(3.0 * tx.Sin(2.0 * t), 1.0, tx.Cos(t))
    F = tx.lie.wrench(force=weight + drag + thrust, torque=tx.linalg.Cross(CENTRE, weight) - 0.2 * V[3:])
    return tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))})


def forced_body_reference(x0: dict[str, np.ndarray], t1: float) -> dict[str, np.ndarray]:
    """The forced body integrated by SciPy on rotation matrices, Newton and Euler written out about the origin."""
    M = spatial_inertia()

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        R, v, w = y[:9].reshape(3, 3), y[12:15], y[15:]
        momentum = M @ y[12:]
        weight = R.T @ (MASS * GRAVITY)
        force = weight - 0.3 * v + np.array([3.0 * np.sin(2.0 * t), 1.0, np.cos(t)])
        torque = np.cross(CENTRE, weight) - 0.2 * w
        force = force - np.cross(w, momentum[:3])
        torque = torque - np.cross(w, momentum[3:]) - np.cross(v, momentum[:3])
        return np.concatenate([(R @ skew(w)).ravel(), R @ v, np.linalg.solve(M, np.concatenate([force, torque]))])

    y0 = np.concatenate([x0["g"][:3, :3].ravel(), x0["g"][:3, 3], x0["V"]])
    y = solve_ivp(rate, (0.0, t1), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = y[:9].reshape(3, 3), y[9:12]
    return {"g": pose, "V": y[12:]}
