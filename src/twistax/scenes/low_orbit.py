"""Satellites around an oblate Earth: one stabilised by the gravity gradient, and one by its spin."""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np

import twistax as tx
from twistax.mechanics.environment import gravity

from .scene import Scene, about, said, stored_end

#: GM and radius of WGS 84, and the second zonal harmonic of EGM96.
EARTH = dataclasses.replace(gravity.EARTH_J2, j2=1.08262668e-3)
#: Principal moments about the body axes, kg m2.
INERTIA = (10.0, 20.0, 25.0)
#: The same of the other one: almost symmetric, and the spin is about the largest.
SPINNING_INERTIA = (20.0, 21.0, 25.0)


def system(inertia: Sequence[float] = INERTIA) -> tx.System:
    """States R (body to inertial), w (3,) in body axes, rad/s, p and v (3,) inertial, m and m/s.

    R' = R [w]x, J w' = (J w) x w + 3 GM / r^3 n x J n with n = R' p / r, J = diag(inertia), p' = v, v' the
    gravity of `EARTH`. The torque is that of a point mass, and the attitude does not act back on the orbit.

    Outputs, constant in the true motion: energy, of the orbit per mass, J/kg; axial_momentum, about the Earth's axis
    per mass, m2/s.
    """
    J = np.array(inertia)
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    p, v = tx.State("p", shape=(3,)), tx.State("v", shape=(3,))
    r = tx.linalg.Norm(p)
    n = R.T @ p / r
    gradient = 3.0 * EARTH.gm / r**3 * tx.linalg.Cross(n, J * n)
    oblate = 0.5 * EARTH.j2 * (EARTH.radius / r) ** 2 * (3.0 * (p[2] / r) ** 2 - 1.0)
    return tx.System(
        rates={R: w, w: (tx.linalg.Cross(J * w, w) + gradient) / J, p: v, v: EARTH.acceleration(p)},
        outputs={
            "energy": 0.5 * tx.linalg.Dot(v, v) - EARTH.gm / r * (1.0 - oblate),
            "axial_momentum": p[0] * v[1] - p[1] * v[0],
        },
    )


_INCLINATION, _SPEED = math.radians(51.6), 7546.0


def _scene(name: str, duration: float, inertia: Sequence[float], rate: Sequence[float]) -> Scene:
    return Scene(
        **said(name),
        reference=stored_end(name),
        build=functools.partial(system, inertia),
        start={
            "R": about((1.0, 0.0, 0.0), 0.6),
            "w": np.array(rate),
            "p": np.array([7e6, 0.0, 0.0]),
            "v": np.array([0.0, _SPEED * math.cos(_INCLINATION), _SPEED * math.sin(_INCLINATION)]),
        },
        duration=duration,
        invariants=("energy", "axial_momentum"),
    )


LOW_ORBIT = _scene("low-orbit", 5828.0, INERTIA, (0.001, 0.002, 0.01))
#: `tests/scenes/scene_references.py` finds its end to 1e-13, where 64 bits of mantissa end. The stored digits come from
#: the same steps in 113 bits.
SPINNING_SATELLITE = _scene("spinning-satellite", 29140.0, SPINNING_INERTIA, (0.01, 0.02, 0.5))
