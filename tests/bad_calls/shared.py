"""Systems that the rows share, compiled once."""

import functools

import jax.numpy as jnp
import numpy as np

import twistax as tx


@functools.cache
def cart() -> tx.Dynamics:
    """A cart with drag: position and velocity, a force, and a stop that is a constraint."""
    position, velocity = tx.State("position"), tx.State("velocity")
    force, mass = tx.Control("force"), tx.Parameter("mass", value=2.0)
    system = tx.System(
        rates={position: velocity, velocity: force / mass - velocity},
        outputs={"power": force * velocity},
        constraints=[position <= 10.0],
    )
    return tx.compile(system)


@functools.cache
def body() -> tx.Dynamics:
    """A rigid body with a torque and an inertia that has no value."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    tau, J = tx.Control("tau", shape=(3,)), tx.Parameter("J", shape=(3, 3))
    turn = tx.linalg.Solve(J, tau)
    return tx.compile(tx.System(rates={g: V, V: tx.Concat(np.zeros(3), turn)}))


@functools.cache
def decay() -> tx.Dynamics:
    """x' = -x, v' = -v, without controls."""
    x, v = tx.State("x"), tx.State("v", shape=(3,))
    return tx.compile(tx.System(rates={x: -x, v: -v}))


X = {"position": 0.0, "velocity": 1.0}
U = {"force": 1.0}
AT_REST = {"g": np.eye(4), "V": np.zeros(6)}
TORQUE = {"tau": jnp.zeros(3)}
INERTIA = {"J": np.eye(3)}
DECAY = {"x": 1.0, "v": np.ones(3)}
