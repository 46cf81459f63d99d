"""Systems and solutions inside diffrax for the tests of the Lie solver, with an independent reference."""

import functools
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import twistax as tx
from oracles import skew

INERTIA = np.array([1.0, 2.0, 3.0])
ARM = np.array([0.3, -0.2, 0.5])
DAMPING = 0.4


def start() -> dict[str, np.ndarray]:
    """A top that tumbles about no axis in particular."""
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return {"R": rotation * np.sign(np.linalg.det(rotation)), "w": np.array([1.0, 2.0, -0.7])}


def _top(turn: bool, damp: bool) -> tx.Dynamics:
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    J = tx.Parameter("J", shape=(3,), value=INERTIA)
    torque = tx.linalg.Cross(J * w, w) + tx.linalg.Cross(ARM, R.T @ np.array([0.0, 0.0, -9.81]))
    spin, damping = torque / J, -DAMPING * w
    rate = (spin if turn else 0.0 * w) + (damping if damp else 0.0 * w)
    return tx.compile(tx.System(rates={R: w if turn else 0.0 * w, w: rate}))


@functools.cache
def top() -> tx.Dynamics:
    """An asymmetric heavy top with damping: states R and w, parameter J."""
    return _top(True, True)


@functools.cache
def halves() -> tuple[tx.Dynamics, tx.Dynamics]:
    """The top without damping, and its damping alone."""
    return _top(True, False), _top(False, True)


def starts(number: int) -> dict[str, np.ndarray]:
    """Several starts, on a leading axis: the mean error over them has no lucky zeros."""
    noise = np.random.default_rng(8).normal(size=(number, 3))
    return {"R": np.stack([start()["R"]] * number), "w": start()["w"] + noise}


@functools.cache
def references(t1: float, number: int) -> dict[str, np.ndarray]:
    """The solutions from `starts`."""
    each = [_reference(t1, start()["R"], w) for w in starts(number)["w"]]
    return {name: np.stack([end[name] for end in each]) for name in each[0]}


@functools.cache
def reference(t1: float) -> dict[str, np.ndarray]:
    """The solution from `start`."""
    return _reference(t1, start()["R"], start()["w"])


def _reference(t1: float, R: np.ndarray, w: np.ndarray) -> dict[str, np.ndarray]:
    """The top integrated by SciPy on rotation matrices."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        R, w = y[:9].reshape(3, 3), y[9:]
        torque = np.cross(INERTIA * w, w) + np.cross(ARM, R.T @ np.array([0.0, 0.0, -9.81]))
        return np.concatenate([(R @ skew(w)).ravel(), torque / INERTIA - DAMPING * w])

    y0 = np.concatenate([R.ravel(), w])
    y = solve_ivp(rate, (0.0, t1), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return {"R": y[:9].reshape(3, 3), "w": y[9:]}


def solve(solver: Any, t1: Any = 1.0, dt0: Any = None, x: Any = None, **rest: Any) -> diffrax.Solution:
    """The top inside diffrax by a Lie solver; chosen steps unless a length is given."""
    dynamics = top()
    rest.setdefault("stepsize_controller", tx.diffrax.controller(1e-8) if dt0 is None else diffrax.ConstantStepSize())
    terms = rest.pop("terms", tx.diffrax.lie_term(dynamics))
    x = start() if x is None else x
    return diffrax.diffeqsolve(terms, tx.diffrax.LieSolver(solver, dynamics), 0.0, t1, dt0, x, **rest)


def apart(xs: Any, wanted: Any) -> float:
    """The largest difference of two states or of the first against the last of saved ones."""
    return max(float(np.abs(np.asarray(xs[name]) - np.asarray(wanted[name])).max()) for name in wanted)


def last(sol: diffrax.Solution) -> dict[str, jax.Array]:
    """The last saved state."""
    return jax.tree.map(lambda a: a[-1], sol.ys)


def defect(R: Any) -> float:
    """How far rotations are from their group."""
    R = jnp.asarray(R)
    return float(jnp.abs(jnp.swapaxes(R, -1, -2) @ R - jnp.eye(3)[None]).max())
