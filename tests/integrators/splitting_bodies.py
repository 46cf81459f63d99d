"""Bodies in a potential for the tests of splitting methods, and independent solutions of them in NumPy and SciPy."""

import functools

import numpy as np
from integrator_bodies import CENTRE, INERTIA, MASS, spatial_inertia
from scipy.integrate import solve_ivp

import twistax as tx
from oracles import skew

#: An asymmetric heavy top: its tensor about the fixed point, weight and centre of mass; a magnet that swings.
TENSOR = np.array([[1.0, 0.1, 0.0], [0.1, 1.4, -0.2], [0.0, -0.2, 0.6]])
LEVER = np.array([0.3, -0.2, 1.5])
WEIGHT = np.array([0.2, 0.0, -1.3])
POLE = np.array([0.4, 0.7, -0.2])

#: A body on a spring: where it is fixed to the body and to the world, and how stiff it is.
HOOK = np.array([0.4, 0.3, -0.5])
POST = np.array([0.2, -0.1, 1.0])
STIFFNESS = 6.0
GRAVITY = np.array([0.3, -0.2, -2.0])

SWAP = [3, 4, 5, 0, 1, 2]


def top(tensor: np.ndarray = TENSOR, momentum: bool = False) -> tx.System:
    """R' = R [w]x, J w' = (J w) x w + c x R' W + time * (pole x R' field); or the same with L = J w."""
    J = tensor if tensor.ndim == 2 else np.diag(tensor)
    R, s, t = tx.State("R", group=tx.SO3), tx.State("L" if momentum else "w", shape=(3,)), tx.Time()
    w, L = (tx.linalg.Solve(J, s), s) if momentum else (s, J @ s)
    field = tx.Concat(tx.Sin(2.0 * t), 0.5, tx.Cos(t))
    torque = tx.linalg.Cross(LEVER, R.T @ WEIGHT) + tx.linalg.Cross(POLE, R.T @ field)
    change = tx.linalg.Cross(L, w) + torque
    return tx.System(rates={R: w, s: change if momentum else tx.linalg.Solve(J, change)})


TOP_START = {
    "R": np.asarray(tx.lie.so3.exp(np.array([0.6, -0.3, 0.2]))),
    "w": np.array([0.4, -0.3, 2.0]),
}


def top_reference(x0: dict[str, np.ndarray], t1: float) -> dict[str, np.ndarray]:
    """The heavy top by SciPy on rotation matrices."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        R, w = y[:9].reshape(3, 3), y[9:]
        field = np.array([np.sin(2.0 * t), 0.5, np.cos(t)])
        torque = np.cross(LEVER, R.T @ WEIGHT) + np.cross(POLE, R.T @ field)
        return np.concatenate([(R @ skew(w)).ravel(), np.linalg.solve(TENSOR, np.cross(TENSOR @ w, w) + torque)])

    y = solve_ivp(rate, (0.0, t1), np.append(x0["R"].ravel(), x0["w"]), method="DOP853", rtol=1e-13, atol=1e-14).y[
        :, -1
    ]
    return {"R": y[:9].reshape(3, 3), "w": y[9:]}


def hung(order: tx.Order = tx.LINEAR_FIRST, momentum: bool = False, matrix: object = None) -> tx.System:
    """A body with an offset centre of mass, under gravity, on a spring that is fixed away from both."""
    M = spatial_inertia() if matrix is None else matrix
    if matrix is None and order != tx.LINEAR_FIRST:
        M = M[np.ix_(SWAP, SWAP)]
    g = tx.State("g", group=tx.SE3, order=order)
    s = tx.State("mu" if momentum else "V", shape=(6,))
    V, mu = (tx.linalg.Solve(M, s), s) if momentum else (s, M @ s)
    R = g[:3, :3]
    pull = R.T @ (STIFFNESS * (POST - R @ HOOK - g[:3, 3]))
    weight = R.T @ (MASS * GRAVITY)
    F = tx.lie.wrench(
        force=pull + weight, torque=tx.linalg.Cross(HOOK, pull) + tx.linalg.Cross(CENTRE, weight), order=order
    )
    change = F - tx.lie.AdjointDual(V, mu, order=order)
    return tx.System(rates={g: V, s: change if momentum else tx.linalg.Solve(M, change)})


def hung_reference(x0: dict[str, np.ndarray], t1: float) -> dict[str, np.ndarray]:
    """The same body by SciPy: Newton for the centre of mass and Euler about it, in world axes."""

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        R, x, v, w = y[:9].reshape(3, 3), y[9:12], y[12:15], y[15:]
        pull = STIFFNESS * (POST - R @ (HOOK - CENTRE) - x)
        torque = np.cross(HOOK - CENTRE, R.T @ pull)
        turn = np.linalg.solve(INERTIA, torque - np.cross(w, INERTIA @ w))
        return np.concatenate([(R @ skew(w)).ravel(), v, pull / MASS + GRAVITY, turn])

    R, p, v, w = x0["g"][:3, :3], x0["g"][:3, 3], x0["V"][:3], x0["V"][3:]
    y0 = np.concatenate([R.ravel(), p + R @ CENTRE, R @ (v + np.cross(w, CENTRE)), w])
    y = solve_ivp(rate, (0.0, t1), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    R, w, g = y[:9].reshape(3, 3), y[15:], np.eye(4)
    g[:3, :3], g[:3, 3] = R, y[9:12] - R @ CENTRE
    return {"g": g, "V": np.concatenate([R.T @ y[12:15] - np.cross(w, CENTRE), w])}


@functools.cache
def compiled_top() -> tx.Dynamics:
    return tx.compile(top())


@functools.cache
def compiled_hung() -> tx.Dynamics:
    return tx.compile(hung())


TOP_BODY = tx.FreeBody("R", "w", inertia=TENSOR)
HUNG_BODY = tx.FreeBody("g", "V", inertia=spatial_inertia())
