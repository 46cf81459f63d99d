"""Check-cases 1, 2 and 3 of NASA/TM-2015-218675: bodies dropped over the equator, simulated by several programs.

Frames: Earth-centred inertial, z along the Earth's axis, x through longitude 0 at t = 0; body, at the centre of mass.
The state g maps body to inertial coordinates. All cases start 9144 m (30,000 ft) above the WGS 84 ellipsoid at latitude
0 and longitude 0, at rest relative to the Earth, body axes north, east and down. SI units, rad.

The three cases are one system with three sets of parameters.

Source of starts, bodies, forces and published values: Murri, Jackson and Shelton, Check-Cases for Verification of
6-Degree-of-Freedom Flight Vehicle Simulations, NASA/TM-2015-218675, and the trajectories that come with it.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

import twistax as tx
from twistax.mechanics import flight
from twistax.mechanics.environment import earth
from twistax.units import degrees, feet, seconds

from .published import DURATION, EARTH
from .scene import Scene, newton_euler, placed, said, stored_end

Vector = tuple[float, float, float]

SLUG_FOOT2 = 1.3558179483314  # kg m2


@dataclasses.dataclass(frozen=True)
class RateDamping:
    """Aerodynamic moments that damp the angular rates: -1/4 rho U S (b^2 p, c^2 q, b^2 r), with the airspeed U."""

    area: float  # S, m2
    span: float  # b, m
    chord: float  # c, m
    #: Rate about z, rad/s, of the axes relative to which p, q and r count: 0 for inertial ones.
    frame_rate: float = 0.0

    @property
    def coefficients(self) -> Vector:
        """S/4 (b^2, c^2, b^2), m4."""
        quarter, b, c = 0.25 * self.area, self.span**2, self.chord**2
        return (quarter * b, quarter * c, quarter * b)


@dataclasses.dataclass(frozen=True)
class Published:
    """The final values of a published simulation, at 30 s."""

    simulation: str  # its number in the report
    rate: Vector  # of the body with respect to inertial axes, rad/s
    euler: Vector  # (roll, pitch, yaw) of the body relative to north, east, down, rad
    position: Vector | None = None  # Earth-centred inertial, m; None where the simulation does not give it


@dataclasses.dataclass(frozen=True)
class CheckCase:
    """One check-case."""

    number: int  # in the report, as its title
    title: str
    mass: float  # kg
    inertia: Vector  # moments about the body axes, which are principal, kg m2
    rate: Vector  # of the body at the start with respect to inertial axes, rad/s
    published: tuple[Published, ...]
    damping: RateDamping | None = None

    def start(self) -> dict[str, Any]:
        """The state at t = 0: pose g and body twist V, with the velocity of the turning Earth at that place."""
        position = np.array([earth.WGS84.radius + 30_000.0 * feet, 0.0, 0.0])  # `flight.start` would compile
        north_east_down = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
        velocity = np.cross([0.0, 0.0, earth.WGS84.rate], position)
        return {"g": placed(north_east_down, position), "V": np.concatenate([north_east_down.T @ velocity, self.rate])}

    def parameters(self, damped: bool = True) -> dict[str, Any]:
        """The parameters of `system`; of a case without damping its coefficients are zero where the system has them."""
        body = {"mass": self.mass, "inertia": np.array(self.inertia)}
        if not damped:
            return body
        damping = self.damping or RateDamping(area=0.0, span=0.0, chord=0.0)
        return body | {"damping": np.array(damping.coefficients), "frame_rate": damping.frame_rate}


def system(planet: flight.Planet = EARTH, damped: bool = True) -> tx.System:
    """Newton-Euler equations under gravity, optionally with damping moments: the states, and the outputs, of
    `flight.Vehicle`.

    Parameters: mass, kg; inertia, principal moments (3,), kg m2; and if damped, damping, `RateDamping.coefficients`
    (3,), m4, and frame_rate, rad/s.
    """
    body = flight.Vehicle(planet)
    g, V, R = body.pose, body.twist, body.pose[:3, :3]
    m, J = tx.Parameter("mass"), tx.Parameter("inertia", shape=(3,))
    torque: Any = np.zeros(3)
    if damped:
        damping, frame_rate = tx.Parameter("damping", shape=(3,)), tx.Parameter("frame_rate")
        torque = -body.air.density * body.air.airspeed * damping * (body.rate() - frame_rate * R[2])
    F = tx.lie.wrench(force=m * (R.T @ body.gravitation), torque=torque)
    return tx.System(rates={g: V, V: newton_euler(tx.Concat(m, m, m, J), V, F)}, outputs=body.outputs())


def _published(number: int) -> tuple[Published, ...]:
    """The published ends of a case, converted from feet and degrees to m and rad."""
    entries = json.loads(Path(__file__).with_name("check_cases.json").read_text())[str(number)]
    return tuple(
        Published(
            end["simulation"], tuple(end["rate"]), tuple(end["euler"]), end["position"] and tuple(end["position"])
        )
        for end in entries
    )


_SPHERE = CheckCase(
    number=1,
    title="sphere without drag",
    mass=14.5939,
    inertia=(4.880944614, 4.880944614, 4.880944614),
    rate=(0.0, 0.0, 0.0),
    published=_published(1),
)
_BRICK = CheckCase(
    number=2,
    title="tumbling brick without damping",
    mass=2.267961895,
    inertia=(0.001894220 * SLUG_FOOT2, 0.006211019 * SLUG_FOOT2, 0.007194665 * SLUG_FOOT2),
    rate=tuple((10.0, 20.0, 30.0) * (degrees / seconds)),
    published=_published(2),
)
_DAMPED = dataclasses.replace(
    _BRICK,
    number=3,
    title="tumbling brick with damping",
    damping=RateDamping(area=2.0 / 9.0 * feet**2, span=1.0 / 3.0 * feet, chord=2.0 / 3.0 * feet),
    published=_published(3),
)

#: By number.
CASES = {case.number: case for case in (_SPHERE, _BRICK, _DAMPED)}


#: Case 2, without parameters of damping.
TUMBLING_BRICK = Scene(
    **said("tumbling-brick"),
    build=functools.partial(system, damped=False),
    start=CASES[2].start(),
    params=CASES[2].parameters(damped=False),
    duration=DURATION,
    reference=stored_end("tumbling-brick"),
)
