"""An asymmetric body that turns under drag, its weight and a torque, and costs of where it ends."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from integrator_bodies import start

import twistax as tx

Cost = Callable[[jax.Array], jax.Array]


def top() -> tx.System:
    """An asymmetric body that turns under drag, its weight and a torque that changes with time."""
    R, w, t = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Time()
    J = tx.Parameter("J", shape=(3,), value=np.array([1.0, 2.0, 3.5]))
    torque = tx.Concat(tx.Sin(2.0 * t), 0.3, 0.0) - 0.1 * w + tx.linalg.Cross(np.array([0.0, 0.2, 0.5]), R[2, :])
    return tx.System(rates={R: w, w: (torque - tx.linalg.Cross(w, J * w)) / J})


def integrated(dynamics: tx.Dynamics, **options: Any) -> Cost:
    """A cost of the end as a function of what is added to the rate at the start."""
    rotation, rate = start()["g"][:3, :3], np.array([0.4, 2.0, -0.7])

    def cost(z: jax.Array) -> jax.Array:
        end = tx.integrate(dynamics, {"R": rotation, "w": rate + z}, t1=0.5, **options).xs
        return (end["w"][-1] ** 2).sum() + end["R"][-1][:, 1:].sum()

    return cost
