"""Engines, and the effects of burning propellant in addition to thrust.

Six-vectors are [f; tau] at the body's origin in its axes.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ...checks import number, short
from ...errors import ModelError
from ...expr import Constant, Cross, Expr
from ...expr.fields import ExprLike
from ...expr.kinds.declare import known_as
from ...expr.kinds.kinds import Wrench
from ...expr.lie import angular, wrench
from ...units import kilograms, metres, newtons, same_unit, seconds
from ..arguments import of_kind, of_shape
from ..bodies import SpatialInertia

__all__ = ["Engine", "burning", "rocket"]

#: Standard gravity, m/s2, which relates a specific impulse in s to an exhaust velocity.
STANDARD_GRAVITY = 9.80665


@dataclasses.dataclass(frozen=True, eq=False)
class Engine:
    """An engine at a point of a body. Thrust and mass flow are expressions of throttle, Mach number and altitude, often
    tables.

    Attributes:
        thrust: (), N.
        mass_flow: the flow out of the body, (), kg/s, positive.
        position: the point of the thrust and of the exhaust, (3,), m.
        direction: direction of the thrust, (3,), of length 1; an expression if the engine is gimballed.
    Raises: ShapeError for values of the wrong shape; ModelError for values that are not numbers or expressions, or a
    direction of another length.
    """

    thrust: ExprLike
    mass_flow: ExprLike = 0.0
    position: ExprLike = (0.0, 0.0, 0.0)
    direction: ExprLike = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        flow = kilograms / seconds
        parts = {
            "thrust": ((), newtons),
            "mass_flow": ((), flow),
            "position": ((3,), metres),
            "direction": ((3,), None),
        }
        for name, (shape, unit) in parts.items():
            object.__setattr__(self, name, of_shape("Engine", name, getattr(self, name), shape, unit=unit))
        if isinstance(self.direction, Constant):
            length = float(np.linalg.norm(self.direction.value))
            if not abs(length - 1.0) <= 1e-6:
                raise ModelError(f"Engine expects a direction of length 1, got {short(self.direction)} of {length:g}")

    @property
    def wrench(self) -> Expr:
        """The wrench $[f; p x f]$ (6,) of the thrust f."""
        force = self.thrust * of_shape("Engine", "direction", self.direction, (3,))
        return known_as(wrench(force=force, torque=Cross(self.position, force)), Wrench())


def rocket(
    throttle: ExprLike,
    pressure: ExprLike,
    *,
    vacuum_thrust: float,
    specific_impulse: float,
    exit_area: float = 0.0,
    position: ExprLike = (0.0, 0.0, 0.0),
    direction: ExprLike = (1.0, 0.0, 0.0),
) -> Engine:
    """A rocket engine with throttle s: its thrust is $s T - p A$, its mass flow $s T / (g_0 I)$.

    Args:
        throttle: (), 0 to 1; at 0 the pressure term remains, so switch off an engine by `tx.Where`.
        pressure: pressure p of the ambient air, (), Pa.
        vacuum_thrust: T, N.
        specific_impulse: I in vacuum, s.
        exit_area: A, m2.
        position, direction: as for `Engine`.
    Raises: ShapeError, ModelError for invalid values.
    """
    same_unit("rocket: exit_area", exit_area, metres**2)
    for name, value, unit in (
        ("vacuum_thrust", vacuum_thrust, newtons),
        ("specific_impulse", specific_impulse, seconds),
    ):
        same_unit(f"rocket: {name}", value, unit)
        number(f"rocket: {name}", value, "a positive number", lambda x: 0.0 < x < np.inf, ModelError)
    number("rocket: exit_area", exit_area, "0 m2 or more", lambda x: 0.0 <= x < np.inf, ModelError)
    power = of_shape("rocket", "throttle", throttle, ()) * vacuum_thrust
    against = of_shape("rocket", "pressure", pressure, ()) * exit_area
    return Engine(power - against, power / (STANDARD_GRAVITY * specific_impulse), position, direction)


def burning(V: ExprLike, flow: ExprLike, kilogram: SpatialInertia, outlet: ExprLike) -> Expr:
    """The wrench (6,) of mass that leaves a body, in addition to the thrust: Coriolis force and jet damping.

    Let w be the body's rate, f the mass flow, c and J the centre and the inertia about the origin of one kilogram of
    the leaving mass, and r the outlet. Then

        $force = -2 f w x (r - c), moment = f (J w - r x (w x r) - w x (c x r))$

    With this wrench $M V' = F - ad*_V(M V)$, where F is the sum of all wrenches and M the instantaneous inertia, is the
    momentum balance of a body with a steady flow along a line from c to r. The effect of an unsteady flow, f' (r - c)
    and $f' (c x r)$, is omitted. About the centre of mass and along an axis of symmetry, the moment is $-(I' + f l^2)
    w$, which is known as jet damping.

    Args:
        V: the twist of the body (6,).
        flow: mass flow f out of the body, kg/s, positive.
        kilogram: the derivative of the body's inertia with respect to its mass. For a tank that empties uniformly: a
            body of 1 kg at its centre with its inertia per mass. For a tank with a falling level: the layer at the
            surface.
        outlet: r (3,), m, such as the engine's position.
    Raises: ShapeError.
    Source: the momentum balance over the body's volume; the terms are in Cornelisse, Schoyer and Wakker, Rocket
    Propulsion and Spaceflight Dynamics (1979), chapter 4.
    """
    w = angular(of_shape("burning", "V", V, (6,)))
    f, r = of_shape("burning", "flow", flow, ()), of_shape("burning", "outlet", outlet, (3,))
    of_kind("burning", "kilogram", kilogram, SpatialInertia)
    c = kilogram.center_of_mass
    turned = kilogram.matrix[3:, 3:] @ w - Cross(r, Cross(w, r)) - Cross(w, Cross(c, r))
    return wrench(force=-2.0 * f * Cross(w, r - c), torque=f * turned)
