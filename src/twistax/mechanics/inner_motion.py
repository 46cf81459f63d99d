"""Masses that move within a body in a known way, such as a deploying boom, and their effect on the body's motion.

A body of constant mass m has a centre c and an inertia I about the centre, both varying, in a frame whose axes rotate
with w. It is assumed that its parts have no angular momentum about the centre of mass relative to these axes, as if
they moved radially. If this does not hold, describe the body as several bodies that are merged. Then

    p = m (v + w x c + c')                        L = I w + c x p,
    F = M V' + ad*_V(M V) + X,                    X = [f; I' w + c x f],    f = m (2 w x c' + c''),

where ' is the rate in the frame. X is $X_0 + X_1 w$, and both terms add up over merged bodies.

Mass that leaves a body carries its momentum away, without such terms; see `SpatialInertia`.

Source: P. Hughes, Spacecraft Attitude Dynamics (1986), chapter 3; L. Meirovitch, Methods of Analytical Dynamics (1970),
section 12.2, for mass that leaves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..errors import ModelError
from ..expr import Constant, Control, Cross, Dot, Expr, Rate, State, Vstack
from ..expr.lie import Hat, wrench
from ..expr.transformations.rate import changing


class MovingMass(NamedTuple):
    """A body whose centre or inertia changes, in a frame, with the rates of the states that it depends on."""

    mass: Expr
    center_of_mass: Expr
    inertia: Expr
    rates: Mapping[str, Expr]

    def knowing(self, rates: Mapping[str, Expr]) -> MovingMass:
        """A copy with additional rates; existing rates are unchanged."""
        return self._replace(rates={**rates, **self.rates})

    @property
    def mass_stays(self) -> bool:
        """Whether the rate of the mass is known to be zero."""
        return not self._unknown(self.mass) and self.rate(self.mass) is None

    def _unknown(self, expr: Expr) -> list[State | Control]:
        """The states and controls in an expression whose rates are not known."""
        leaves = changing(expr)
        return [leaf for leaf in leaves if isinstance(leaf, (State, Control)) and leaf.name not in self.rates]

    def rate(self, expr: Expr) -> Expr | None:
        """The rate of an expression; None if it is constant. Raises ModelError if the rate is not known."""
        unknown = self._unknown(expr)
        if unknown:
            kind, name = type(unknown[0]).__name__.lower(), unknown[0].name
            raise ModelError(
                f"the centre of mass or the inertia of a body depends on the {kind} {name!r}, whose rate "
                "is not known, but the momentum of masses that move in a body depends on it.\n"
                f"  fix: SpatialInertia(..., rates={{{name!r}: its rate}}), zero if it is constant, or "
                "mass_leaves=True if the change is due to mass that leaves the body"
            )
        rate = Rate(expr, self.rates)
        return rate if rate.placeholders else None


class InnerMotion(NamedTuple):
    """The effect of moving parts of a body on its motion: six-vectors at its origin, in its axes."""

    momentum: Expr  # [m c'; c x m c'] (6,)
    energy: Expr  # m |c'|^2 / 2 ()
    still: Expr  # X_0 (6,)
    turning: Expr  # X_1 (6, 3)

    def wrench(self, w: Expr) -> Expr:
        """X (6,): the wrench that is added to that of a rigid body."""
        return self.still + self.turning @ w


def momentum_of(parts: tuple[MovingMass, ...]) -> tuple[Expr, Expr] | None:
    """The momentum (6,) of the parts of a body relative to it, and their kinetic energy (); None if no part moves."""
    momenta_and_energies: list[tuple[Expr, Expr]] = []
    for part in parts:
        velocity = part.rate(part.center_of_mass)
        if velocity is not None:
            p = part.mass * velocity
            momenta_and_energies.append((wrench(force=p, torque=Cross(part.center_of_mass, p)), 0.5 * Dot(p, velocity)))
    if not momenta_and_energies:
        return None
    momenta, energies = zip(*momenta_and_energies, strict=True)
    return sum(momenta[1:], momenta[0]), sum(energies[1:], energies[0])


def motion_of(parts: tuple[MovingMass, ...]) -> InnerMotion | None:
    """The effect of moving parts of a body on its motion; None if no part moves."""
    terms: list[tuple[Expr, Expr]] = []
    for part in parts:
        velocity, tensor_rate = part.rate(part.center_of_mass), part.rate(part.inertia)
        still, turning = list[Expr](), list[Expr]()
        if velocity is not None:
            m, c = part.mass, part.center_of_mass
            acceleration = part.rate(velocity)
            across = -2.0 * m * Hat(velocity)
            turning.append(Vstack(across, Hat(c) @ across))
            if acceleration is not None:
                still.append(wrench(force=m * acceleration, torque=Cross(c, m * acceleration)))
        if tensor_rate is not None:
            turning.append(Vstack(Constant(np.zeros((3, 3))), tensor_rate))
        if turning:
            zero = Constant(np.zeros(6))
            terms.append((sum(still[1:], still[0]) if still else zero, sum(turning[1:], turning[0])))
    if not terms:
        return None
    momentum, energy = momentum_of(parts) or (Constant(np.zeros(6)), Constant(0.0))
    stills, turnings = zip(*terms, strict=True)
    return InnerMotion(momentum, energy, sum(stills[1:], stills[0]), sum(turnings[1:], turnings[0]))
