"""Planets as data: ellipsoid and rotation, gravity, atmosphere; and their axes as poses.

Frames are those of `environment.earth`: inertial, planet-fixed, local. T_ab maps coordinates of frame b to frame a.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol, TypeAlias, runtime_checkable

from ...errors import ModelError
from ...expr import Concat, Constant, Cos, Expr, Sin, Tan, to_expr
from ...expr.fields import ExprLike
from ...expr.lie import Pose, rotation
from ..arguments import of_shape
from ..environment import earth, gravity
from ..environment.upper_atmosphere import US1976_TO_1000_KM

__all__ = [
    "EARTH",
    "ROUND_EARTH",
    "Air",
    "Axes",
    "Gravity",
    "Planet",
    "Reference",
    "fixed_axes",
    "inertial_axes",
    "local_axes",
]

#: The rotation (3, 3) from local to planet-fixed axes, as a function of latitude and longitude.
Axes: TypeAlias = Callable[[ExprLike, ExprLike], Expr]


@runtime_checkable
class Gravity(Protocol):
    """A model of the gravity of a planet, such as one of `environment.gravity`."""

    @property
    def axisymmetric(self) -> bool:
        """Whether the gravity is independent of the longitude."""

    @property
    def gm(self) -> float:
        """Gravitational constant times mass, m3/s2."""

    def acceleration(self, position: ExprLike) -> Expr:
        """The acceleration (3,), m/s2, at a planet-fixed position (3,) in m; if axisymmetric, in any axes with the same
        z.
        """


@runtime_checkable
class Air(Protocol):
    """A model of the atmosphere, such as one of `environment.atmosphere`: functions of geometric altitude in m."""

    def temperature(self, altitude: ExprLike) -> Expr:
        """K."""

    def pressure(self, altitude: ExprLike) -> Expr:
        """Pa."""

    def density(self, altitude: ExprLike) -> Expr:
        """kg/m3."""

    def speed_of_sound(self, altitude: ExprLike) -> Expr:
        """m/s."""


@dataclasses.dataclass(frozen=True)
class Planet:
    """A planet that rotates about its z axis: its ellipsoid, gravity and atmosphere.

    Attributes:
        figure: the ellipsoid to which latitudes and altitudes refer, and its rate of rotation.
        gravity: the gravity model.
        air: the atmosphere, at rest relative to the planet.
    Raises: ModelError for a part of another type.
    """

    figure: earth.Ellipsoid
    gravity: Gravity
    air: Air = US1976_TO_1000_KM

    def __post_init__(self) -> None:
        for name, kind in (("figure", earth.Ellipsoid), ("gravity", Gravity), ("air", Air)):
            if not isinstance(getattr(self, name), kind):
                raise ModelError(
                    f"Planet expects {name} to be an instance of {kind.__name__}, got {getattr(self, name)!r}"
                )

    def still(self) -> Planet:
        """A copy without rotation."""
        return dataclasses.replace(self, figure=dataclasses.replace(self.figure, rate=0.0))

    def fixed_pose(self, t: ExprLike) -> Expr:
        """The pose T_if (4, 4) of planet-fixed axes in inertial axes at time t (), s. Raises ShapeError if t is not a
        scalar.
        """
        return rotation(self.figure.to_inertial(t))

    def local_pose(
        self, latitude: ExprLike, longitude: ExprLike, altitude: ExprLike, axes: Axes = earth.north_east_down
    ) -> Expr:
        """The pose T_fl (4, 4) of local axes at a position, in planet-fixed axes.

        Args:
            latitude, longitude, altitude: coordinates of the position, (), rad and m.
            axes: `earth.north_east_down` or `earth.east_north_up`.
        Raises: ShapeError.
        """
        return Pose(axes(latitude, longitude), self.figure.position(latitude, longitude, altitude))

    def gravitation(self, position: ExprLike, t: ExprLike) -> Expr:
        """Gravitational acceleration (3,) in inertial axes, m/s2, at an inertial position (3,) and a time (), s."""
        p = of_shape("gravitation", "position", position, (3,))
        if self.gravity.axisymmetric:
            return self.gravity.acceleration(p)
        turn = self.figure.to_inertial(t)
        return turn @ self.gravity.acceleration(turn.T @ p)


#: WGS84 with J2, and the US Standard Atmosphere 1976, with its gases in diffusive equilibrium above 1000 km.
EARTH = Planet(earth.WGS84, gravity.EARTH_J2)

#: A spherical Earth with the mean radius and the inverse-square gravity of NASA's check-cases 4 and 5. Source:
#: NASA/TM-2015-218675. The trajectories of these simulations start at a distance of 6371007.1809 m + 30,000 ft from the
#: centre.
ROUND_EARTH = Planet(earth.Ellipsoid(6371007.1809, 0.0, earth.WGS84.rate), gravity.EARTH_POINT_MASS)


# ---- reference axes of angular rates --------------------------------------------------------------------------------

#: The rate (3,) of axes relative to inertial axes, rad/s in north-east-down components, as a function of planet,
#: latitude, altitude and velocity relative to the planet in north-east-down components.
Reference: TypeAlias = Callable[[Planet, ExprLike, ExprLike, ExprLike], Expr]


#: The arguments of a `Reference`.
REFERENCE_TAKES = ("planet", "latitude", "altitude", "ned_velocity")


def inertial_axes(planet: Planet, latitude: ExprLike, altitude: ExprLike, ned_velocity: ExprLike) -> Expr:
    """Inertial axes, for angular rates relative to inertial space: their rate is zero."""
    return Constant([0.0, 0.0, 0.0])


def fixed_axes(planet: Planet, latitude: ExprLike, altitude: ExprLike, ned_velocity: ExprLike) -> Expr:
    """Planet-fixed axes, for angular rates relative to the planet: their rate in north-east-down axes is W
    (cos(latitude), 0, -sin(latitude)).
    """
    return planet.figure.rate * Concat(Cos(latitude), 0.0, -Sin(latitude))


def local_axes(planet: Planet, latitude: ExprLike, altitude: ExprLike, ned_velocity: ExprLike) -> Expr:
    """North-east-down axes, for angular rates relative to the local horizon. They rotate with the planet and with the
    motion over it.

    Their rate is that of the planet plus the transport rate (v_e / (N + h), -v_n / (M + h), -v_e tan(latitude) / (N +
    h)), with M and N the radii of `Ellipsoid.radii`. At the poles, which have no north direction, it is NaN.

    Source: P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems (2013), eq. (5.44).
    """
    velocity, (meridian, normal) = to_expr(ned_velocity), planet.figure.radii(latitude)
    north = velocity[0] / (meridian + altitude)
    east = velocity[1] / (normal + altitude)
    turning = -east * Tan(latitude) + earth.OffPole(latitude)
    return fixed_axes(planet, latitude, altitude, ned_velocity) + Concat(east, -north, turning)
