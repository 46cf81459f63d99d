"""The Earth as a rotating ellipsoid: geodetic coordinates, frames, and the velocity of the air at rest on it.

Frames, all right-handed, lengths in m, angles in rad:

    inertial      origin at the Earth's centre, z along the axis of rotation
    Earth-fixed   the same origin and z; turned about z by the Earth's angle; x at longitude 0
    local         axes north, east, down at a geodetic latitude and longitude

A rotation R_ab maps coordinates of frame b to frame a.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...checks import number
from ...errors import ModelError
from ...expr import Atan2, Block, Concat, Cos, Cross, Expr, Norm, Sin, Sqrt
from ...expr.bases import Entrywise
from ...expr.fields import ExprLike, Operand, positive
from ...expr.kinds.declare import known_as
from ...expr.kinds.rules import OPEN, FixedUnits
from ...expr.kinds.unit import METRE, ONE
from ...expr.lie import AxisRotation
from ..arguments import of_shape

__all__ = ["WGS84", "Ellipsoid", "Geodetic", "Meridian", "OffPole", "east_north_up", "north_east_down"]


class Geodetic(NamedTuple):
    """Geodetic latitude and longitude in rad, altitude above the ellipsoid in m; three scalar expressions."""

    latitude: Expr
    longitude: Expr
    altitude: Expr


@dataclasses.dataclass(frozen=True)
class Ellipsoid:
    """A uniformly rotating ellipsoid of revolution, with the air at rest on it.

    Attributes:
        radius: the equatorial radius a, m.
        flattening: $f = (a - b) / a$, with b the distance of the poles from the centre.
        rate: angular rate of rotation about z, rad/s.
    Raises: ModelError if the radius is not positive, the flattening not in [0, 1), or the rate not finite.
    """

    radius: float
    flattening: float
    rate: float

    def __post_init__(self) -> None:
        positive(self, "radius", self.radius, "m")
        less = "in [0, 1), the f of which some give 1/f"
        number("Ellipsoid: flattening", self.flattening, less, lambda f: 0.0 <= f < 1.0, ModelError)
        number("Ellipsoid: rate", self.rate, "a finite number of rad/s", error=ModelError)

    @property
    def polar_radius(self) -> float:
        """The polar radius b = a (1 - f), m."""
        return self.radius * (1.0 - self.flattening)

    @property
    def eccentricity_squared(self) -> float:
        """The squared eccentricity $e^2 = f (2 - f)$."""
        return self.flattening * (2.0 - self.flattening)

    def geodetic(self, position: ExprLike) -> Geodetic:
        """Geodetic latitude, longitude and altitude of an Earth-fixed position (3,).

        For an inertial position, latitude and altitude are the same; the longitude is then relative to the inertial x
        axis. On the axis the longitude is defined as 0 and its derivative as 0. Raises ShapeError for a position of
        another shape.
        """
        p = of_shape("geodetic", "position", position, (3,))
        meridian = Meridian(Norm(p[:2]), p[2], self)
        return Geodetic(known_as(meridian[0], unit=ONE), Atan2(p[1], p[0]), known_as(meridian[1], unit=METRE))

    def position(self, latitude: ExprLike, longitude: ExprLike, altitude: ExprLike) -> Expr:
        """The Earth-fixed position (3,) of geodetic coordinates, (), rad and m. Raises ShapeError for coordinates that
        are not scalars.
        """
        latitude, longitude = _angle("position", "latitude", latitude), _angle("position", "longitude", longitude)
        altitude = of_shape("position", "altitude", altitude, ())
        sine, e2, normal = Sin(latitude), self.eccentricity_squared, self.radii(latitude)[1]
        distance = (normal + altitude) * Cos(latitude)
        return Concat(distance * Cos(longitude), distance * Sin(longitude), ((1.0 - e2) * normal + altitude) * sine)

    def radii(self, latitude: ExprLike) -> tuple[Expr, Expr]:
        """Radii of curvature at a geodetic latitude (), of the meridian and of the normal section across it, m.

        $M = a (1 - e^2) / (1 - e^2 s^2)^(3/2)$ and $N = a / (1 - e^2 s^2)^(1/2)$, with s the sine of the latitude.
        Raises ShapeError if it is not a scalar.
        """
        e2 = self.eccentricity_squared
        rest = 1.0 - e2 * Sin(_angle("radii", "latitude", latitude)) ** 2
        normal = self.radius / Sqrt(rest)
        return (1.0 - e2) * normal / rest, normal

    def to_inertial(self, t: ExprLike) -> Expr:
        """The rotation (3, 3) from Earth-fixed to inertial axes at a time, s; the axes coincide at t = 0. Raises
        ShapeError if the time is not a scalar.
        """
        return AxisRotation(self.rate * of_shape("to_inertial", "t", t, ()), (0.0, 0.0, 1.0))

    def air_velocity(self, position: ExprLike, velocity: ExprLike) -> Expr:
        """Velocity (3,) relative to air at rest on the rotating Earth, $v - W x p$, from inertial position and
        velocity.

        Raises ShapeError.
        """
        p = of_shape("air_velocity", "position", position, (3,))
        v = of_shape("air_velocity", "velocity", velocity, (3,))
        return v - Cross([0.0, 0.0, self.rate], p)


#: The World Geodetic System 1984: a and f of its ellipsoid, nominal rate of rotation.
#: Source: NIMA TR8350.2, Department of Defense World Geodetic System 1984, third edition.
WGS84 = Ellipsoid(radius=6378137.0, flattening=1.0 / 298.257223563, rate=7.292115e-5)


def north_east_down(latitude: ExprLike, longitude: ExprLike) -> Expr:
    """The rotation (3, 3) from local axes north, east, down to Earth-fixed axes: its columns are these directions.

    Args: a latitude () and a longitude (), rad. At a pole, north is that of the meridian of this longitude. Raises
    ShapeError if they are not scalars.
    """
    where = "north_east_down"
    latitude, longitude = _angle(where, "latitude", latitude), _angle(where, "longitude", longitude)
    s, c, sl, cl = Sin(latitude), Cos(latitude), Sin(longitude), Cos(longitude)
    return Block([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])


def east_north_up(latitude: ExprLike, longitude: ExprLike) -> Expr:
    """The rotation (3, 3) from local axes east, north, up to Earth-fixed axes.

    Args: a latitude () and a longitude (), rad. Raises ShapeError if they are not scalars.
    """
    return north_east_down(latitude, longitude) @ np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


class OffPole(Entrywise):
    """0 at latitudes that have a north direction, NaN at the poles, entry by entry.

    Add it to quantities that are not defined at the poles. A latitude counts as a pole if the cosine of the latitude is
    at most four units of round-off: 1e-15 in double precision (6 nm on the Earth), 5e-7 in single precision (3 m).
    Within this distance the cosine, and every quotient by it, has no significant digits.

    Shapes: s -> s.

    Attributes:
        latitude: rad.
    """

    latitude: Operand
    keeps_order = False
    kinds = OPEN
    cases = ({"latitude": [0.3, -1.2, 1.57]},)

    def evaluate(self, *values: Array) -> Array:
        (latitude,) = values
        noise = 4.0 * jnp.finfo(latitude.dtype).eps
        # A function of the latitude, so that the derivative at a pole is NaN, too.
        return latitude * jnp.where(jnp.abs(jnp.cos(latitude)) > noise, 0.0, jnp.nan).astype(latitude.dtype)


class Meridian(Expr):
    """Geodetic latitude and altitude of a point in its meridian plane: [latitude in rad, altitude in m].

    Shapes: (), () -> (2,). Computed by three steps of Bowring's iteration for the reduced latitude, without
    trigonometry. The altitude is measured from the computed point of the ellipsoid, along its vertical, so an error of
    the latitude has a second-order effect. Derivatives are those of the exact functions: along the vertical for the
    altitude, across it for the latitude. The results are accurate to round-off from 100 km below the ellipsoid outward.
    Within 50 km of the centre the latitude is not defined.

    Attributes:
        rho: distance from the axis, m, not negative.
        z: height above the equatorial plane, m.
        ellipsoid: the reference ellipsoid.
    Raises: ShapeError if rho or z is not a scalar.
    Source: Bowring, Transformation from spatial to geographical coordinates, Survey Review 23 (1976).
    """

    rho: Operand
    z: Operand
    ellipsoid: Ellipsoid = WGS84
    takes, gives = ((), ()), (2,)
    kinds = FixedUnits((METRE, METRE))
    # A planet of unit size: finite differences in tests need values and steps of similar size.
    cases = (
        {"rho": 0.8, "z": 0.9, "ellipsoid": Ellipsoid(radius=1.0, flattening=0.1, rate=0.0)},
        {"rho": 1.1, "z": -0.01, "ellipsoid": Ellipsoid(radius=1.0, flattening=0.1, rate=0.0)},
    )
    kinks = ({"rho": 0.0, "z": 6.4e6, "ellipsoid": WGS84},)

    def evaluate(self, *values: Array) -> Array:
        return jnp.stack(latitude_and_altitude(self.ellipsoid, *values))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def latitude_and_altitude(ellipsoid: Ellipsoid, rho: Array, z: Array) -> tuple[Array, Array]:
    """Geodetic latitude and altitude of a point at distance rho from the axis and height z; see `Meridian`."""
    a, b, e2 = ellipsoid.radius, ellipsoid.polar_radius, ellipsoid.eccentricity_squared
    sine, cosine = _direction(a * z, b * rho)  # of the reduced latitude
    for _ in range(3):
        up, out = z + (e2 * a * a / b) * sine**3, rho - e2 * a * cosine**3
        sine, cosine = _direction(b * up, a * out)
    north, outward = _direction(up, out)  # the vertical
    return jnp.arctan2(up, out), (rho - a * cosine) * outward + (z - b * sine) * north


@latitude_and_altitude.defjvp
def _latitude_and_altitude_jvp(
    ellipsoid: Ellipsoid, primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    latitude, altitude = latitude_and_altitude(ellipsoid, *primals)
    sine, cosine = jnp.sin(latitude), jnp.cos(latitude)
    e2 = ellipsoid.eccentricity_squared
    curvature = ellipsoid.radius * (1.0 - e2) / (1.0 - e2 * sine * sine) ** 1.5  # radius of curvature of the meridian
    d_rho, d_z = tangents
    turned = (cosine * d_z - sine * d_rho) / (curvature + altitude)
    return (latitude, altitude), (turned, cosine * d_rho + sine * d_z)


def _direction(y: Array, x: Array) -> tuple[Array, Array]:
    """Sine and cosine of the angle of the point (x, y); zero at the origin."""
    square = x * x + y * y
    scale = 1.0 / jnp.sqrt(jnp.where(square == 0.0, 1.0, square))
    return y * scale, x * scale


def _angle(function: str, name: str, value: ExprLike) -> Expr:
    return of_shape(function, name, value, (), "one place at a time: latitude, longitude and angles are scalars")
