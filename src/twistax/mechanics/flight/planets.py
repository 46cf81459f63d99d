"""Planets as data: figure and rotation, gravity, air; and their axes as poses.

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

#: Local axes: the rotation (3, 3) to planet-fixed axes, of latitude and longitude.
Axes: TypeAlias = Callable[[ExprLike, ExprLike], Expr]


@runtime_checkable
class Gravity(Protocol):
    """A model of the gravity of a planet, such as one of `environment.gravity`."""

    @property
    def axisymmetric(self) -> bool:
        """Whether it is independent of the longitude."""

    @property
    def gm(self) -> float:
        """Gravitational constant times mass, m3/s2."""

    def acceleration(self, position: ExprLike) -> Expr:
        """(3,) in m/s2 at a planet-fixed position (3,) in m; in any axes about the same z, if axisymmetric."""


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
    """A planet that rotates about its z axis: its figure, gravity and atmosphere.

    Attributes:
        figure: the ellipsoid to which latitudes and altitudes refer, and its rate of rotation.
        gravity: its gravity.
        air: its atmosphere, at rest relative to the planet.
    Raises: ModelError for a part of another type.
    """

    figure: earth.Ellipsoid
    gravity: Gravity
    air: Air = US1976_TO_1000_KM

    def __post_init__(self) -> None:
        for name, kind in (("figure", earth.Ellipsoid), ("gravity", Gravity), ("air", Air)):
            if not isinstance(getattr(self, name), kind):
                raise ModelError(f"Planet expects {name} to be of {kind.__name__}, got {getattr(self, name)!r}")

    def still(self) -> Planet:
        """The same planet without rotation."""
        return dataclasses.replace(self, figure=dataclasses.replace(self.figure, rate=0.0))

    def fixed_pose(self, t: ExprLike) -> Expr:
        """T_if (4, 4): planet-fixed axes in inertial ones at time t (), s. Raises ShapeError."""
        return rotation(self.figure.to_inertial(t))

    def local_pose(
        self, latitude: ExprLike, longitude: ExprLike, altitude: ExprLike, axes: Axes = earth.north_east_down
    ) -> Expr:
        """T_fl (4, 4): local axes at a position in planet-fixed ones.

        Args:
            latitude, longitude, altitude: of the position, (), rad and m.
            axes: `earth.north_east_down` or `earth.east_north_up`.
        Raises: ShapeError.
        """
        return Pose(axes(latitude, longitude), self.figure.position(latitude, longitude, altitude))

    def gravitation(self, position: ExprLike, t: ExprLike) -> Expr:
        """Acceleration (3,) by gravity in inertial axes, m/s2, at an inertial position (3,) and a time (), s."""
        p = of_shape("gravitation", "position", position, (3,))
        if self.gravity.axisymmetric:
            return self.gravity.acceleration(p)
        turn = self.figure.to_inertial(t)
        return turn @ self.gravity.acceleration(turn.T @ p)


#: WGS84 with J2, and the US Standard Atmosphere 1976, above 1000 km with its gases in balance.
EARTH = Planet(earth.WGS84, gravity.EARTH_J2)

#: A round Earth of the mean radius that NASA's check-cases 4 and 5 are flown with, with an inverse-square pull.
#: Source: NASA/TM-2015-218675. The simulations' trajectories start 6371007.1809 m + 30,000 ft from the centre.
ROUND_EARTH = Planet(earth.Ellipsoid(6371007.1809, 0.0, earth.WGS84.rate), gravity.EARTH_POINT_MASS)


# ---- what a rate of rotation is relative to ------------------------------------------------------------------------

#: The rate (3,) of axes relative to inertial ones, rad/s in north-east-down, of a planet, latitude, altitude and
#: velocity north-east-down relative to the planet.
Reference: TypeAlias = Callable[[Planet, ExprLike, ExprLike, ExprLike], Expr]


#: What a `Reference` is a function of.
REFERENCE_TAKES = ("planet", "latitude", "altitude", "ned_velocity")


def inertial_axes(planet: Planet, latitude: ExprLike, altitude: ExprLike, ned_velocity: ExprLike) -> Expr:
    """Inertial axes, for rates relative to inertial space: their rate is zero."""
    return Constant([0.0, 0.0, 0.0])


def fixed_axes(planet: Planet, latitude: ExprLike, altitude: ExprLike, ned_velocity: ExprLike) -> Expr:
    """Planet-fixed axes, for rates relative to the planet: their rate in north-east-down axes is W (cos(latitude), 0,
    -sin(latitude)).
    """
    return planet.figure.rate * Concat(Cos(latitude), 0.0, -Sin(latitude))


def local_axes(planet: Planet, latitude: ExprLike, altitude: ExprLike, ned_velocity: ExprLike) -> Expr:
    """North-east-down axes, for rates relative to the local horizon. They rotate with the planet and with the motion
    over it.

    Their rate is that of the planet plus the transport rate (v_e / (N + h), -v_n / (M + h), -v_e tan(latitude) / (N +
    h)), with M and N the radii of `Ellipsoid.radii`. At the poles, which have no north direction, it is NaN.

    Source: P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems (2013), eq. (5.44).
    """
    velocity, (meridian, normal) = to_expr(ned_velocity), planet.figure.radii(latitude)
    north = velocity[0] / (meridian + altitude)
    east = velocity[1] / (normal + altitude)
    turning = -east * Tan(latitude) + earth.OffPole(latitude)
    return fixed_axes(planet, latitude, altitude, ned_velocity) + Concat(east, -north, turning)
