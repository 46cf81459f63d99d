"""Air data of a body in flight (angles, Mach number, pressures), and aerodynamic forces in body, stability or wind
axes.

Body axes: x forward, y to the right, z down.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import TypeAlias

import numpy as np

from ...checks import callable_with, number
from ...errors import ModelError
from ...expr import Atan2, Block, Concat, Constant, Cos, Cross, Dot, Expr, Max, Norm, Sin, Sqrt, Where
from ...expr.fields import ExprLike
from ...expr.kinds.declare import known_as
from ...expr.kinds.kinds import FreeVector, Wrench
from ...expr.kinds.unit import KILOGRAM, METRE, NEWTON, SECOND
from ...expr.lie import wrench
from ...units import metres
from ..arguments import of_kind, of_shape
from .planets import Air

__all__ = ["Aerodynamics", "AirData", "AirAxes", "body_axes", "drag", "stability_axes", "wind_axes"]


_DENSITY, _PRESSURE = KILOGRAM / METRE**3, NEWTON / METRE**2


@dataclasses.dataclass(frozen=True, eq=False)
class AirData:
    """Air data of a body, as expressions that are built when first read.

    Attributes:
        velocity: velocity of the body relative to the air, (3,) in body axes, m/s.
        altitude: geometric altitude, (), m.
        air: the atmosphere.
        rate: angular rate of the body relative to the air, (3,) in body axes, rad/s.
    """

    velocity: Expr
    altitude: Expr
    air: Air
    rate: Expr

    @cached_property
    def airspeed(self) -> Expr:
        """True airspeed V, (), m/s. At rest its gradient is zero."""
        return Norm(self.velocity)

    @cached_property
    def alpha(self) -> Expr:
        """Angle of attack atan2(w, u), (), rad; 0 at rest."""
        return Atan2(self.velocity[2], self.velocity[0])

    @cached_property
    def beta(self) -> Expr:
        """Angle of sideslip $asin(v / V)$, (), rad, as atan2(v, |(u, w)|); 0 at rest."""
        u, v, w = self.velocity[0], self.velocity[1], self.velocity[2]
        return Atan2(v, Norm(Concat(u, w)))

    @cached_property
    def density(self) -> Expr:
        """Air density rho, (), kg/m3."""
        return known_as(self.air.density(self.altitude), unit=_DENSITY)

    @cached_property
    def pressure(self) -> Expr:
        """Static pressure p, (), Pa."""
        return known_as(self.air.pressure(self.altitude), unit=_PRESSURE)

    @cached_property
    def speed_of_sound(self) -> Expr:
        """Speed of sound a, (), m/s."""
        return known_as(self.air.speed_of_sound(self.altitude), unit=METRE / SECOND)

    @cached_property
    def mach(self) -> Expr:
        """Mach number $V / a$, ()."""
        return self.airspeed / self.speed_of_sound

    @cached_property
    def dynamic_pressure(self) -> Expr:
        """Dynamic pressure $rho V^2 / 2$, (), Pa."""
        return known_as(0.5 * self.density * Dot(self.velocity, self.velocity), unit=_PRESSURE)

    @cached_property
    def equivalent_airspeed(self) -> Expr:
        """Equivalent airspeed $V sqrt(rho / rho_0)$, with rho_0 the density at altitude 0, (), m/s."""
        return self.airspeed * Sqrt(self.density / self.air.density(0.0))

    @cached_property
    def impact_pressure(self) -> Expr:
        """The impact pressure of a pitot tube (), Pa: $p ((1 + M^2 / 5)^(7/2) - 1)$; above Mach 1, Rayleigh's formula
        behind a normal shock.

        Source: NACA Report 1135, Equations, tables and charts for compressible flow (1953), eqs. (44) and (100).
        """
        square = self.mach * self.mach
        ratio_behind_shock = 166.921580 * square**3.5 / (7.0 * Max(square, 1.0) - 1.0) ** 2.5
        return self.pressure * (Where(square < 1.0, (1.0 + 0.2 * square) ** 3.5, ratio_behind_shock) - 1.0)


#: The rotation (3, 3) to body axes from the axes of the coefficients.
AirAxes: TypeAlias = Callable[[AirData], Expr]


def body_axes(air: AirData) -> Expr:
    """Force coefficients along body axes: (C_X, C_Y, C_Z)."""
    return Constant([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def stability_axes(air: AirData) -> Expr:
    """Force coefficients along stability axes, (-C_D, C_Y, -C_L): x along the velocity without sideslip, y as in body
    axes.
    """
    s, c = Sin(air.alpha), Cos(air.alpha)
    return Block([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def wind_axes(air: AirData) -> Expr:
    """Force coefficients along wind axes, (-C_D, C_Y, -C_L): x along the velocity, z in the plane of symmetry."""
    s, c = Sin(air.beta), Cos(air.beta)
    return stability_axes(air) @ Block([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _not_negative(place: str, value: ExprLike) -> None:
    """Raise ModelError for a negative number; the value of an expression is not known."""
    known = value.value if isinstance(value, Constant) else value
    if not isinstance(known, Expr):
        number(place, known, "0 or more", lambda x: 0.0 <= x < np.inf, ModelError)


def drag(air: AirData, area: ExprLike) -> Expr:
    """The drag force $-rho V C_D S u / 2$ (3,) in body axes, N, for an area C_D S (), m2, and the air velocity u;
    smooth at rest.

    Raises: ShapeError for arguments of the wrong shape; ModelError for a negative number.
    """
    of_kind("drag", "air", air, AirData)
    S = of_shape("drag", "area", area, (), unit=metres**2)
    _not_negative("drag: area", S)
    return known_as(-0.5 * S * air.density * air.airspeed * air.velocity, FreeVector(), NEWTON)


@dataclasses.dataclass(frozen=True, eq=False)
class Aerodynamics:
    """Reference area, lengths and axes of aerodynamic coefficients.

    Attributes:
        area: S, m2.
        span: b, m, the length of roll and yaw coefficients.
        chord: c, m, the length of pitch coefficients.
        reference: moment reference point, (3,) from the body's origin, m.
        axes: axes of the force coefficients: `body_axes`, `stability_axes` or `wind_axes`.
    Raises: ShapeError for values of the wrong shape; ModelError for values that are not numbers or expressions, or are
    negative.
    """

    area: ExprLike
    span: ExprLike
    chord: ExprLike
    reference: ExprLike = (0.0, 0.0, 0.0)
    axes: AirAxes = body_axes

    def __post_init__(self) -> None:
        parts = {"area": ((), metres**2), "span": ((), metres), "chord": ((), metres), "reference": ((3,), metres)}
        for name, (shape, unit) in parts.items():
            object.__setattr__(self, name, of_shape("Aerodynamics", name, getattr(self, name), shape, unit=unit))
            if not shape:
                _not_negative(f"Aerodynamics: {name}", getattr(self, name))
        callable_with("Aerodynamics: axes", self.axes, ("air",), ModelError)

    @property
    def lengths(self) -> Expr:
        """The reference lengths (b, c, b) of roll, pitch and yaw."""
        return Concat(self.span, self.chord, self.span)

    def reduced_rates(self, air: AirData) -> Expr:
        """The dimensionless rates (p b, q c, r b) / (2 V) (3,) relative to the air; 0 at zero airspeed."""
        has_airspeed = air.airspeed > 0.0
        return Where(has_airspeed, 0.5 / Where(has_airspeed, air.airspeed, 1.0), 0.0) * air.rate * self.lengths

    def wrench(self, air: AirData, force: ExprLike, moment: ExprLike = (0.0, 0.0, 0.0)) -> Expr:
        """The wrench [f; tau] (6,) at the body's origin, in its axes: $q S R C_f$, and $q S R (b C_l, c C_m, b C_n)$
        transformed to this origin.
        """
        of_kind("Aerodynamics.wrench", "air", air, AirData)
        R, load = self.axes(air), air.dynamic_pressure * self.area
        f = load * (R @ _vector("force", force))
        tau = load * (R @ (self.lengths * _vector("moment", moment)))
        return known_as(wrench(force=f, torque=tau + Cross(self.reference, f)), Wrench())


def _vector(name: str, value: ExprLike) -> Expr:
    """A vector, from a vector or from three expressions and numbers."""
    joined = Concat(*value) if isinstance(value, (list, tuple)) else value
    return of_shape("Aerodynamics.wrench", name, joined, (3,))
