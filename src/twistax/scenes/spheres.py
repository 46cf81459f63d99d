"""Check-cases 4 to 10 of NASA/TM-2015-218675: a sphere with drag over a round and an oblate Earth, in winds.

The sphere has a mass of 1 slug, an inertia of 3.6 slug ft2 about each axis, a drag coefficient of 0.1 and an area of
0.1963495 ft2. In cases 4 to 8 it is dropped at 30,000 ft over latitude 0 and longitude 0; in 9 and 10 it is fired there
from the ground.

Two radii in the report's spreadsheet differ from those of the trajectories: 20902255.199 ft of the round Earth are
6371007.38 m, where the simulations use 6371007.1809 m; 20925646.995 ft at the equator are 6378137.20 m, where WGS84 has
6378137 m.

Source: Murri, Jackson and Shelton, Check-Cases for Verification of 6-Degree-of-Freedom Flight Vehicle Simulations,
NASA/TM-2015-218675 (2015), and the trajectories that come with it.
"""

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np

import twistax as tx
from twistax.mechanics import SpatialInertia, flight
from twistax.units import degrees, feet, seconds, slugs

from .published import EARTH, ROUND_EARTH

SPHERE = SpatialInertia(mass=1.0 * slugs, inertia=3.6 * slugs * feet**2 * np.eye(3))
DRAG_AREA = 0.1 * 0.1963495 * feet**2  # C_D S

_HIGH = 30_000 * feet
_FPS = feet / seconds


@dataclasses.dataclass(frozen=True)
class SphereCase:
    """One check-case.

    Attributes:
        number, title: in the report.
        planet, wind: what it flies in.
        altitude, ned_velocity, euler, rate, relative_to: its start at latitude 0 and longitude 0, as in `flight.start`.
    """

    number: int
    title: str
    planet: flight.Planet = EARTH
    wind: flight.Wind = flight.CALM
    altitude: float = _HIGH
    ned_velocity: Any = (0.0, 0.0, 0.0)
    euler: Any = (0.0, 0.0, 0.0)
    rate: Any = (0.0, 0.0, 0.0)
    relative_to: flight.Reference = flight.inertial_axes

    @cached_property
    def vehicle(self) -> flight.Vehicle:
        """The sphere's states and what follows from them."""
        return flight.Vehicle(self.planet, self.wind)

    def system(self) -> tx.System:
        """The sphere under gravity and drag."""
        drag = flight.drag(self.vehicle.air, DRAG_AREA)
        return self.vehicle.system(SPHERE, tx.lie.wrench(force=drag, torque=np.zeros(3)))

    def start(self) -> dict[str, Any]:
        """The state at t = 0."""
        motion = {"rate": self.rate, "relative_to": self.relative_to}
        return self.vehicle.start(0.0, 0.0, self.altitude, self.ned_velocity, self.euler, **motion)


_TUMBLING = (10.0, 20.0, 30.0) * (degrees / seconds)
_WEST_20 = flight.Steady((0.0, 20.0, 0.0) * _FPS)
_SHEAR = flight.Profile((0.0 * feet, _HIGH), ((0.0, -20.0, 0.0) * _FPS, (0.0, 70.0, 0.0) * _FPS))
_SHOT: dict[str, Any] = {"altitude": 0.0, "relative_to": flight.fixed_axes}

#: By number.
SPHERES = {
    case.number: case
    for case in (
        SphereCase(4, "sphere over a round Earth that stands still", ROUND_EARTH.still(), rate=_TUMBLING),
        SphereCase(5, "sphere over a round Earth that turns", ROUND_EARTH, rate=_TUMBLING),
        SphereCase(6, "sphere over the oblate Earth"),
        SphereCase(7, "sphere in a steady wind", wind=_WEST_20),
        SphereCase(8, "sphere in a wind shear", wind=_SHEAR),
        SphereCase(
            9,
            "shot eastward",
            ned_velocity=(0.0, 1000.0, -1000.0) * _FPS,
            euler=(0.0, 0.0, 90.0) * degrees,
            **_SHOT,
        ),
        SphereCase(10, "shot northward", ned_velocity=(1000.0, 0.0, -1000.0) * _FPS, **_SHOT),
    )
}
