"""A satellite that spins for its stability, for many revolutions of a low orbit."""

from __future__ import annotations

import functools
import math

import numpy as np

from . import low_orbit
from .arrays import about
from .scene import Scene

__all__ = ["INERTIA", "SPINNING_SATELLITE"]

#: Principal moments about the body axes, kg m2: almost symmetric, and the spin is about the largest.
INERTIA = (20.0, 21.0, 25.0)

_INCLINATION, _SPEED = math.radians(51.6), 7546.0

#: As `python -m twistax.scenes.references spinning-satellite` finds it to 1e-13, where 64 bits of mantissa end. These
#: digits come from the same steps in 113 bits.
_END = {
    "R": np.array(
        [
            [0.40210575026332346, 0.9154650772709939, -0.01531854765905709],
            [-0.77110979693762, 0.32958411123478504, -0.5447604929585105],
            [-0.4936604568648295, 0.23086360890965457, 0.8384517561608527],
        ]
    ),
    "w": np.array([0.003977601703480235, 0.022365482382943124, 0.49998304321972]),
    "p": np.array([6991853.572608701, 76200.53144765322, 328657.7664991791]),
    "v": np.array([-329.078224761305, 4689.055881073594, 5903.086272509665]),
}

SPINNING_SATELLITE = Scene(
    name="spinning-satellite",
    title="spinning satellite",
    summary=(
        "A satellite of 20, 21 and 25 kg m2 turns at 0.5 rad/s, with a little nutation, through five orbits of 7000 km "
        "in 29140 s: 1.5e4 rad of spin under a torque of 1e-5 N m."
    ),
    source="Hughes, Spacecraft Attitude Dynamics; gravity as in the scene low-orbit",
    build=functools.partial(low_orbit.system, INERTIA),
    start={
        "R": about((1.0, 0.0, 0.0), 0.6),
        "w": np.array([0.01, 0.02, 0.5]),
        "p": np.array([7e6, 0.0, 0.0]),
        "v": np.array([0.0, _SPEED * math.cos(_INCLINATION), _SPEED * math.sin(_INCLINATION)]),
    },
    duration=29140.0,
    reference=_END,
    invariants=("energy", "axial_momentum"),
)
