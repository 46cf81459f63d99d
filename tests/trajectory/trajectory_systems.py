"""Systems with known answers, or with every kind of state, that the trajectory tests share."""

import functools
from typing import Any

import jax
import numpy as np

import twistax as tx

#: jit for code that runs once: compiled in less time, to slower code.
quick_jit = functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


#: Transcriptions that are quick to compile: exact where rates are held controls, and where their rates are.
EULER: dict[str, Any] = {"method": tx.RKMK(tx.tableaus.EULER), "substeps": 1}
HEUN: dict[str, Any] = {"method": tx.RKMK(tx.tableaus.HEUN), "substeps": 1}


def double_integrator() -> tx.System:
    """p'' = u."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
    return tx.System(rates={p: v, v: u})


def spinning_ball() -> tx.System:
    """A ball with unit inertia under torque: R' = R hat(w), w' = u."""
    R = tx.State("R", group=tx.SO3)
    w = tx.State("w", shape=(3,))
    return tx.System(rates={R: w, w: tx.Control("u", shape=(3,))})


def free_flyer() -> tx.System:
    """A pose driven by its body twist."""
    g = tx.State("g", group=tx.SE3)
    return tx.System(rates={g: tx.Control("V", shape=(6,))})


def everything(order: tx.Order = tx.LINEAR_FIRST) -> tx.System:
    """A body with an attitude-dependent force, a rotor, a matrix state and time in its rates."""
    g = tx.State("g", group=tx.SE3, order=order)
    V = tx.State("V", shape=(6,))
    R = tx.State("R", group=tx.SO3)
    P = tx.State("P", shape=(2, 2))
    F = tx.Control("F", shape=(3,))
    q = tx.Control("q")
    J = tx.Parameter("J", value=np.array([1.0, 2.0, 3.0]))
    t = tx.Time()
    weight = g[:3, :3].T @ np.array([0.3, -0.2, -9.81])
    v, w = tx.lie.linear(V, order=order), tx.lie.angular(V, order=order)
    drag = -0.3 * tx.linalg.Norm(v) * v
    force = F + weight + drag + tx.Sin(3.0 * t) * g[:3, 3]
    torque = tx.linalg.Cross(np.array([0.1, 0.4, -0.7]), F) - tx.linalg.Cross(w, J * w)
    acceleration = tx.lie.twist(linear=force / 2.0 - tx.linalg.Cross(w, v), angular=torque / J, order=order)
    spin = R.T @ w + q * np.array([0.2, -1.0, 0.5])
    drift = P @ np.array([[0.0, 1.0], [-2.0, -0.3]]) + q * np.eye(2) + v[0] * np.ones((2, 2))
    return tx.System(rates={g: V, V: acceleration, R: spin, P: drift})


def sample(seed: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """A state and controls of `everything`."""
    rng = np.random.default_rng(seed)
    x = {
        "g": np.asarray(tx.SE3.exp(rng.normal(size=6))),
        "V": rng.normal(size=6),
        "R": np.asarray(tx.SO3.exp(rng.normal(size=3))),
        "P": rng.normal(size=(2, 2)),
    }
    return x, {"F": rng.normal(size=3), "q": np.asarray(rng.normal())}


@functools.cache
def fastest_turn() -> tx.trajectory.Problem:
    """The fastest turn of an asymmetric body, with a rate limit."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    M = tx.Control("M", shape=(3,), min=-1.0, max=1.0)
    J = np.diag([1.0, 1.2, 0.7])
    rate = tx.linalg.Solve(J, M - tx.linalg.Cross(w, J @ w))
    system = tx.System(rates={R: w, w: rate}, constraints={"slow": tx.linalg.Norm(w) <= 1.8})
    return tx.trajectory.Problem(
        tx.compile(system),
        tx.Minimize(tx.Time(), running=0.01 * M @ M),
        nodes=9,
        final_time=(0.5, 10.0),
        initial={R: np.eye(3), w: np.zeros(3)},
        final={R: np.asarray(tx.SO3.exp(np.array([0.6, 2.2, -1.0]))), w: np.zeros(3)},
        **{**HEUN, "substeps": 4},
    )


def regulator_error(nodes: int, controls: Any, tolerance: float, **options: Any) -> float:
    """By how much the cost of x' = u from 1 in 2 s is above the least, tanh(2), with x^2 + u^2 as running cost."""
    x, u = tx.State("x"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: u}))
    given: dict[str, Any] = {"nodes": nodes, "final_time": 2.0, "initial": {x: 1.0}, "controls": controls} | options
    result = tx.trajectory.Problem(dynamics, tx.Minimize(running=x**2 + u**2), **given).solve(tolerance=tolerance)
    assert result.solved
    return result.cost - float(np.tanh(2.0))
