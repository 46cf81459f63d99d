"""Check-cases 1, 2 and 3 of NASA/TM-2015-218675: bodies dropped over the equator, simulated by several programs.

Frames: Earth-centred inertial, z along the Earth's axis, x through longitude 0 at t = 0; body, at the centre of mass.
The state g maps body to inertial coordinates. All cases start 9144 m (30,000 ft) above the WGS 84 ellipsoid at latitude
0 and longitude 0, at rest relative to the Earth, body axes north, east and down. SI units, rad.

The three cases are one system with three sets of numbers.

Source of starts, bodies, forces and published values: Murri, Jackson and Shelton, Check-Cases for Verification of
6-Degree-of-Freedom Flight Vehicle Simulations, NASA/TM-2015-218675, and the trajectories that come with it.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, Protocol, runtime_checkable

import numpy as np

import twistax as tx
from twistax.mechanics.environment import atmosphere, earth, gravity

from .scene import Scene, newton_euler, placed, stored_end

Vector = tuple[float, float, float]

FOOT = 0.3048  # m
SLUG_FOOT2 = 1.3558179483314  # kg m2
DEGREE = np.pi / 180.0  # rad
#: Length of every trajectory, s.
DURATION = 30.0


@dataclasses.dataclass(frozen=True)
class RateDamping:
    """Aerodynamic moments that damp the rates: -1/4 rho U S (b^2 p, c^2 q, b^2 r), U the speed through the air."""

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
    """Where one published simulation ends, at 30 s."""

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
        position = np.array([earth.WGS84.radius + 30_000.0 * FOOT, 0.0, 0.0])
        north_east_down = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
        velocity = np.cross([0.0, 0.0, earth.WGS84.rate], position)
        return {"g": placed(north_east_down, position), "V": np.concatenate([north_east_down.T @ velocity, self.rate])}

    def parameters(self) -> dict[str, Any]:
        """The parameters of `system`."""
        damping = self.damping or RateDamping(area=0.0, span=0.0, chord=0.0)
        return {
            "mass": self.mass,
            "inertia": np.array(self.inertia),
            "damping": np.array(damping.coefficients),
            "frame_rate": damping.frame_rate,
        }


@runtime_checkable
class Air(Protocol):
    """Air at rest relative to the Earth."""

    def density(self, altitude: tx.Expr) -> tx.Expr:
        """Density in kg/m3 at a geometric altitude in m."""


def system(air: Air = atmosphere.US1976) -> tx.System:
    """Newton-Euler under J2 gravity and damping moments: states g (pose, body to inertial) and V (body twist).

    Parameters: mass, kg; inertia, principal moments (3,), kg m2; damping, `RateDamping.coefficients` (3,), m4;
    frame_rate, rad/s.

    Outputs: position, velocity (3,), inertial; rate (3,), body; latitude, longitude, altitude; attitude (3, 3), body
    axes to north, east, down; density, kg/m3; airspeed, m/s.
    """
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    m, J = tx.Parameter("mass"), tx.Parameter("inertia", shape=(3,))
    damping, frame_rate = tx.Parameter("damping", shape=(3,)), tx.Parameter("frame_rate")
    R, p, w = g[:3, :3], g[:3, 3], tx.lie.angular(V)
    velocity = R @ tx.lie.linear(V)

    to_inertial = earth.WGS84.to_inertial(tx.Time())
    latitude, _, altitude = earth.WGS84.geodetic(p)
    longitude = earth.WGS84.geodetic(to_inertial.T @ p).longitude
    density = air.density(altitude)
    airspeed = tx.linalg.Norm(earth.WGS84.air_velocity(p, velocity))

    F = tx.lie.wrench(
        force=m * (R.T @ gravity.EARTH_J2.acceleration(p)),
        torque=-density * airspeed * damping * (w - frame_rate * R[2]),
    )
    M = tx.Concat(m, m, m, J)
    return tx.System(
        rates={g: V, V: newton_euler(M, V, F)},
        outputs={
            "position": p,
            "velocity": velocity,
            "rate": w,
            "latitude": latitude,
            "longitude": longitude,
            "altitude": altitude,
            "attitude": (to_inertial @ earth.north_east_down(latitude, longitude)).T @ R,
            "density": density,
            "airspeed": airspeed,
        },
    )


_BRICK_MASS = 2.267961895
_BRICK_INERTIA = (0.001894220 * SLUG_FOOT2, 0.006211019 * SLUG_FOOT2, 0.007194665 * SLUG_FOOT2)
_BRICK_RATE = (10.0 * DEGREE, 20.0 * DEGREE, 30.0 * DEGREE)
#: The same fall in all cases, as simulations 04 and 06 give it; the other two do not give inertial positions.
_FALL = {"04": (6382876.258616161, 13969.823256741602, 0.0), "06": (6382876.258603542, 13969.823256759775, 0.0)}


def _ends(*ends: tuple[str, Vector, Vector]) -> tuple[Published, ...]:
    return tuple(Published(number, rate, euler, _FALL.get(number)) for number, rate, euler in ends)


# fmt: off
#: By number. Published values in feet and degrees are given here in m and rad.
CASES = {
    1: CheckCase(
        number=1,
        title="sphere without drag",
        mass=14.5939,
        inertia=(4.880944614, 4.880944614, 4.880944614),
        rate=(0.0, 0.0, 0.0),
        published=_ends(
            ("01", (0.0, 0.0, 0.0), (-0.0021886373267568553, 0.0, 0.0)),
            ("02", (0.0, 0.0, 0.0), (-0.002188635778510834, 0.0, 0.0)),
            ("04", (0.0, 0.0, 0.0), (-0.0021886372827926628, 0.0, 0.0)),
            ("06", (0.0, 0.0, 1.6191747942405682e-20), (-0.0021886372827847685, 2.2204513624867946e-16, 0.0)),
        ),
    ),
    2: CheckCase(
        number=2,
        title="tumbling brick without damping",
        mass=_BRICK_MASS,
        inertia=_BRICK_INERTIA,
        rate=_BRICK_RATE,
        published=_ends(
            ("01", (0.22023246533868357, -0.30364321612656375, 0.5431392879422197),
             (-0.9800251968615921, -0.06666555465260421, -0.07486336822299243)),
            ("02", (0.22024688499968356, -0.3036298619995637, 0.5431454519992196),
             (-1.0446953410649202, -0.0611879293168447, -0.07237430113073469)),
            ("04", (0.22023246533924629, -0.3036432161277715, 0.543139287941697),
             (-0.9800251968119047, -0.06666555467698733, -0.07486336827445753)),
            ("06", (0.22027528327493817, -0.3035921728426686, 0.5431593491869584),
             (-0.980007686394294, -0.066705703262406, -0.0748418640229128)),
        ),
    ),
    3: CheckCase(
        number=3,
        title="tumbling brick with damping",
        mass=_BRICK_MASS,
        inertia=_BRICK_INERTIA,
        rate=_BRICK_RATE,
        damping=RateDamping(area=2.0 / 9.0 * FOOT**2, span=1.0 / 3.0 * FOOT, chord=2.0 / 3.0 * FOOT),
        published=_ends(
            ("01", (-4.848695734423033e-25, -9.160986609996838e-30, 3.029162765205648e-07),
             (-0.08933988814527163, -0.6768295465710275, -1.9490035310271994)),
            ("02", (-1.11e-07, -2.79e-08, 3.06e-07), (-0.08871965139839559, -0.6867871805638883, -1.9461256090344343)),
            ("04", (-5.09949977227008e-25, -1.5913275951413096e-29, 3.0647668170201917e-07),
             (-0.08890815656076159, -0.6769941148081133, -1.944015065744376)),
            ("06", (-2.072685031186363e-05, 6.614884803965917e-05, 2.2939510254979567e-05),
             (-0.08985677430752981, -0.6754373552738147, -1.9435700994961824)),
        ),
    ),
}
# fmt: on


class Vacuum:
    """No air, so that a case without damping does not compute any."""

    def density(self, altitude: tx.Expr) -> tx.Expr:
        """0 kg/m3 at every altitude."""
        return tx.Constant(0.0)


#: Case 2, without air.
TUMBLING_BRICK = Scene(
    name="tumbling-brick",
    title="NASA tumbling brick",
    summary=(
        "A brick of 2.3 kg dropped from 9144 m over the equator tumbles for 30 s without air: an Euler top of a few "
        "1e-3 kg m2 at 6.4e6 m from the origin, falling in J2 gravity."
    ),
    source="NASA/TM-2015-218675, atmospheric check-case 2",
    build=functools.partial(system, Vacuum()),
    start=CASES[2].start(),
    params=CASES[2].parameters(),
    duration=DURATION,
    reference=stored_end("tumbling-brick"),
)
