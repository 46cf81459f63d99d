"""A satellite in a low orbit about an oblate Earth, turned by the gravity gradient."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

import twistax as tx
from twistax.mechanics.environment import gravity

from .arrays import about
from .scene import Scene

__all__ = ["EARTH", "INERTIA", "LOW_ORBIT", "system"]

#: GM and radius of WGS 84, and the second zonal harmonic of EGM96.
EARTH = dataclasses.replace(gravity.EARTH_J2, j2=1.08262668e-3)
#: Principal moments about the body axes, kg m2.
INERTIA = (10.0, 20.0, 25.0)


def system(inertia: Sequence[float] = INERTIA) -> tx.System:
    """States R (body to inertial), w (3,) in body axes, rad/s, p and v (3,) inertial, m and m/s.

    R' = R [w]x, J w' = (J w) x w + 3 GM / r^3 n x J n with n = R' p / r, J = diag(inertia), p' = v, v' the
    gravity of `EARTH`. The torque
    is that of a point mass, and the attitude does not act back on the orbit.

    Outputs, constant in a true flight: energy, of the orbit per mass, J/kg; axial_momentum, about the Earth's axis per
    mass, m2/s.
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

#: As `python -m twistax.scenes.references low-orbit` finds it.
_END = {
    "R": np.array(
        [
            [-0.8046439363013775, -0.5737974166182376, 0.15265864029153872],
            [0.4014301453901323, -0.7151612224970814, -0.5721872632351558],
            [0.4374951132818309, -0.3991252316237559, 0.8057897215376982],
        ]
    ),
    "w": np.array([0.0014175956788023884, -0.0016081676814102513, 0.010009396962999979]),
    "p": np.array([6999674.012506838, 15219.686284037341, 65769.50781922937]),
    "v": np.array([-65.85285116391765, 4687.256253863041, 5913.324121475965]),
}

LOW_ORBIT = Scene(
    name="low-orbit",
    title="low orbit with J2",
    summary=(
        "A satellite 622 km above the equator flies once around an oblate Earth in 5828 s and turns under the gravity "
        "gradient: numbers from 1e-3 to 1e7 in one state."
    ),
    source="Montenbruck and Gill, Satellite Orbits, section on the geopotential; Hughes, Spacecraft Attitude Dynamics",
    build=system,
    start={
        "R": about((1.0, 0.0, 0.0), 0.6),
        "w": np.array([0.001, 0.002, 0.01]),
        "p": np.array([7e6, 0.0, 0.0]),
        "v": np.array([0.0, _SPEED * math.cos(_INCLINATION), _SPEED * math.sin(_INCLINATION)]),
    },
    duration=5828.0,
    reference=_END,
    invariants=("energy", "axial_momentum"),
)
