"""An aeroplane for the tests of trim."""

from __future__ import annotations

import functools

import numpy as np

import twistax as tx
from twistax.mechanics import SpatialInertia

MASS, INERTIA, GRAVITY, WING, CHORD, SPAN, DENSITY = 10.0, np.diag([1.0, 2.0, 2.8]), 9.81, 1.0, 0.4, 2.5, 1.2


def lift(alpha: float, el: float) -> float:
    return 0.3 + 4.5 * alpha + 0.4 * el


def pitching(alpha: float, el: float) -> float:
    return 0.05 - 0.9 * alpha - 1.1 * el


@functools.cache
def aircraft() -> tx.Dynamics:
    """An aeroplane with linear aerodynamics over a flat Earth; z points down."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    el, ail, rud = (tx.Control(name, min=-0.4, max=0.4) for name in ("el", "ail", "rud"))
    thrust = tx.Control("thrust", min=0.0, max=60.0)
    v, w = tx.lie.linear(V), tx.lie.angular(V)
    speed = tx.linalg.Norm(v)
    alpha, beta = tx.Atan2(v[2], v[0]), tx.Asin(v[1] / speed)
    roll, pitch, yaw = w[0] * SPAN / (2 * speed), w[1] * CHORD / (2 * speed), w[2] * SPAN / (2 * speed)
    cl = lift(alpha, el)
    cd = 0.03 + 0.06 * cl**2
    q = 0.5 * DENSITY * speed**2 * WING
    down = g[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    force = tx.Concat(
        q * (cl * tx.Sin(alpha) - cd * tx.Cos(alpha)) + thrust,
        q * (-0.5 * beta),
        q * (-cl * tx.Cos(alpha) - cd * tx.Sin(alpha)),
    )
    torque = q * tx.Concat(
        SPAN * (-0.08 * beta - 0.5 * roll + 0.15 * ail),
        CHORD * (pitching(alpha, el) - 8.0 * pitch),
        SPAN * (0.1 * beta - 0.12 * yaw + 0.08 * rud),
    )
    body = SpatialInertia(mass=MASS, center_of_mass=np.zeros(3), inertia=INERTIA)
    wrench = tx.lie.wrench(force=force + MASS * GRAVITY * down, torque=torque)
    outputs = {"speed": speed, "alpha": alpha, "beta": beta, "down": down, "climb": -tx.linalg.Dot(down, v),
               "turn": tx.linalg.Dot(down, w)}  # fmt: skip
    return tx.compile(tx.System({g: V, V: body.acceleration(V, wrench)}, outputs))


START = {"g": tx.pose(position=[0.0, 0.0, -100.0]), "V": np.array([20.0, 0.0, 1.0, 0.0, 0.0, 0.0])}
NEUTRAL = {"el": 0.0, "ail": 0.0, "rud": 0.0, "thrust": 10.0}
