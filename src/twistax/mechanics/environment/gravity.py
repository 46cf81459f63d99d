"""Gravity models of a planet at a position relative to its centre, as expressions."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ...checks import number
from ...errors import ModelError
from ...expr import Constant, Cross, Dot, Expr, Sqrt
from ...expr.fields import ExprLike, positive
from ..arguments import of_shape

__all__ = ["EARTH_J2", "EARTH_POINT_MASS", "J2", "PointMass", "gradient_torque"]


@dataclasses.dataclass(frozen=True)
class PointMass:
    """Gravity of a point or a homogeneous ball, $-GM p / r^3$ in m/s2 at a position p (3,) in m.

    Attributes:
        gm: gravitational constant times mass, m3/s2.
    Raises: ModelError if gm is not positive.
    """

    gm: float
    axisymmetric: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive(self, "gm", self.gm)

    def acceleration(self, position: ExprLike) -> Expr:
        """The acceleration $-GM p / |p|^3$ (3,), m/s2, at a position p (3,) from the centre in m. Raises ShapeError for
        a position of another shape.
        """
        p = _position(position)
        square = Dot(p, p)
        return (-self.gm / (square * Sqrt(square))) * p


@dataclasses.dataclass(frozen=True)
class J2:
    """Gravity of an oblate planet: a point mass and the second zonal harmonic.

    The potential is $U = GM/r (1 - J2 (R/r)^2 (3 (z/r)^2 - 1)/2)$, with z along the axis of rotation. It does not
    depend on the longitude, so the position may be in inertial or in planet-fixed axes.

    Attributes:
        gm: gravitational constant times mass, m3/s2.
        radius: the equatorial radius R that belongs to j2, m.
        j2: the second zonal harmonic, not normalised.
    Raises: ModelError if gm or radius is not positive, or j2 is not finite.
    Source: Vallado, Fundamentals of Astrodynamics and Applications, chapter on special perturbations;
    Montenbruck and Gill, Satellite Orbits, section on the geopotential.
    """

    gm: float
    radius: float
    j2: float
    axisymmetric: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive(self, "gm", self.gm)
        positive(self, "radius", self.radius)
        number("J2: j2", self.j2, error=ModelError)

    def acceleration(self, position: ExprLike) -> Expr:
        """The gradient of U (3,), m/s2, at a position p (3,) from the centre in m. Raises ShapeError for a position of
        another shape.

        $-GM/r^3 [1 + k (1 - s); 1 + k (1 - s); 1 + k (3 - s)] p$, entry by entry;
        $k = 3/2 J2 (R/r)^2$, $s = 5 (z/r)^2$.
        """
        p = _position(position)
        inverse = 1.0 / Dot(p, p)
        k = 1.5 * self.j2 * self.radius**2 * inverse
        s = 5.0 * p[2] ** 2 * inverse
        return (-self.gm * inverse * Sqrt(inverse)) * p * (1.0 + k * (Constant([1.0, 1.0, 3.0]) - s))


def gradient_torque(gm: float, position: ExprLike, inertia: ExprLike) -> Expr:
    """The gravity-gradient torque $3 GM / r^5 p x I p$ (3,), N m, of a point mass on a body, about the body's centre of
    mass.

    It is accurate to first order in the ratio of the body's size to its distance.

    Args:
        gm: gravitational constant times mass, m3/s2.
        position: p (3,) of the body's centre of mass from the centre of the planet, in body axes, m.
        inertia: I (3, 3) about the centre of mass in body axes, kg m2.
    Raises: ModelError if gm is not positive; ShapeError for arguments of the wrong shape.
    Source: Hughes, Spacecraft Attitude Dynamics, section 8.1.
    """
    number("gradient_torque: gm", gm, "a positive number of m3/s2", lambda value: 0.0 < value < np.inf, ModelError)
    p = of_shape("gradient_torque", "position", position, (3,))
    tensor = of_shape("gradient_torque", "inertia", inertia, (3, 3))
    square = Dot(p, p)
    return (3.0 * gm / (square * square * Sqrt(square))) * Cross(p, tensor @ p)


def _position(position: ExprLike) -> Expr:
    return of_shape("acceleration", "position", position, (3,), "the position of a pose state g is g[:3, 3]")


#: GM with the atmosphere, and J2 of the ellipsoid's normal gravity field, as it follows from a, f, GM and the rate.
#: Source: NIMA TR8350.2, Department of Defense World Geodetic System 1984, third edition.
EARTH_J2 = J2(gm=3.986004418e14, radius=6378137.0, j2=1.08262982e-3)
EARTH_POINT_MASS = PointMass(gm=EARTH_J2.gm)
