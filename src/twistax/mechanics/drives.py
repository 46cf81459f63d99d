"""Drives: rotor inertia, friction, spring, gear and limits of a joint."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..checks import reals
from ..errors import ModelError
from ..expr import Constant, Expr, Tanh, to_expr
from ..expr.fields import ExprLike
from .arguments import constant, dataclass_repr

#: Numbers only, because they become bounds of states and controls.
_LIMITS = ("lower", "upper", "speed")
_AMOUNTS = ("armature", "damping", "friction", "stiffness", "rest", "gear", "friction_speed")
#: Attributes that affect the momentum.
_INERTIAS = ("armature",)
_NOT_NEGATIVE = ("armature", "damping", "friction", "stiffness", "speed")


@dataclasses.dataclass(frozen=True, repr=False)
class Drive:
    """Motor, friction, spring and limits of a joint. All degrees of freedom of the joint have the same values.

    The generalised force on a degree of freedom with position q, velocity v and control u is

        $gear u - damping v - friction tanh(v / speed) - stiffness (q - rest)$.

    Attributes:
        armature: reflected inertia of the rotor, $gear^2$ times the rotor's inertia: kg m2 about an axis, kg along an
            axis. For a planar or free joint, the momentum of the rotor is in the rotating axes of the child.
        damping: viscous friction, N m s/rad or N s/m.
        friction: dry (Coulomb) friction while sliding, N m or N. The force is smooth in the velocity and zero at rest.
        friction_speed: velocity at which dry friction reaches 76 % of `friction`, rad/s or m/s, positive.
        stiffness, rest: the stiffness of a spring, N m/rad or N/m, and the position at which it exerts no force. For a
            ball joint the deflection is Log R. A free joint has no spring.
        gear: joint force per unit of control.
        lower, upper: bounds of the position, or None.
        speed: largest absolute velocity, or None.
        effort: largest absolute control, or a pair (smallest, largest control), or None.

        Limits are numbers. The other values are numbers or expressions; the armature must be constant during the
        motion.
    Raises:
        ModelError: a value that is not a number or a scalar expression; a negative value where it is not allowed;
            contradictory bounds; an armature that depends on time, states or controls.
    Example: `Drive(lower=-2.0, upper=2.0, effort=80.0, damping=0.1)`.
    """

    armature: ExprLike = 0.0
    damping: ExprLike = 0.0
    friction: ExprLike = 0.0
    friction_speed: ExprLike = 0.01
    stiffness: ExprLike = 0.0
    rest: ExprLike = 0.0
    gear: ExprLike = 1.0
    lower: float | None = None
    upper: float | None = None
    speed: float | None = None
    effort: float | tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in _AMOUNTS:
            value = getattr(self, name)
            expr = value if isinstance(value, Expr) else Constant(reals(f"Drive: {name}", value, ModelError))
            self._check(name, expr.value if isinstance(expr, Constant) else None, expr.shape)
            if name in _INERTIAS:
                constant("Drive", name, expr)
        for name in _LIMITS:
            limit = getattr(self, name)
            if limit is not None:
                self._check(name, reals(f"Drive: {name}", limit, ModelError), np.shape(limit))
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise ModelError(f"Drive expects lower to be at most upper, got {self.lower} and {self.upper}")
        least, most = self.efforts
        if least is not None and most is not None and not least <= most:
            raise ModelError(
                f"Drive expects effort to be non-negative, or a pair (smallest, largest), got {self.effort}"
            )
        if isinstance(self.friction_speed, (int, float)) and self.friction_speed <= 0.0:
            raise ModelError(f"Drive expects friction_speed to be positive, got {self.friction_speed}")

    def __repr__(self) -> str:
        return dataclass_repr(self)

    @staticmethod
    def _check(name: str, value: Any, shape: tuple[int, ...]) -> None:
        if shape:
            raise ModelError(f"Drive expects {name} to be a scalar, got the shape {shape}")
        if value is not None and not np.isfinite(value):
            fix = "\n  fix: None where there is no limit" if name in _LIMITS and not np.isnan(value) else ""
            raise ModelError(f"Drive expects {name} to be finite, got {value}{fix}")
        if value is not None and name in _NOT_NEGATIVE and value < 0.0:
            raise ModelError(f"Drive expects {name} not to be negative, got {value}")

    @property
    def efforts(self) -> tuple[float | None, float | None]:
        """The smallest and the largest control, or None."""
        if self.effort is None:
            return None, None
        ends = reals("Drive: effort", self.effort, ModelError)
        if ends.shape not in ((), (2,)) or np.isnan(ends).any():
            raise ModelError(f"Drive expects effort to be a number or a pair, got {self.effort!r}")
        return (float(-ends), float(ends)) if not ends.shape else (float(ends[0]), float(ends[1]))

    @property
    def rotor(self) -> Expr | None:
        """The armature as an expression; None if it is known to be zero."""
        return None if _is_zero(self.armature) else to_expr(self.armature)

    def passive(self, position: Expr | None, velocity: Expr) -> Expr | None:
        """The force () of damping, friction and spring on one degree of freedom; None if there are none."""
        terms: list[Expr] = []
        if not _is_zero(self.damping):
            terms.append(-(to_expr(self.damping) * velocity))
        if not _is_zero(self.friction):
            terms.append(-(to_expr(self.friction) * Tanh(velocity / self.friction_speed)))
        if position is not None and not _is_zero(self.stiffness):
            terms.append(-(to_expr(self.stiffness) * (position - self.rest)))
        return sum(terms[1:], terms[0]) if terms else None

    def stored(self, position: Expr) -> Expr:
        """The energy $k (q - q_0)^2 / 2$ (), J, of the spring of one degree of freedom."""
        return 0.5 * (to_expr(self.stiffness) * (position - self.rest) ** 2)

    @property
    def sprung(self) -> bool:
        return not _is_zero(self.stiffness)


def _is_zero(value: ExprLike) -> bool:
    number = value.value if isinstance(value, Constant) else value
    return not isinstance(number, Expr) and not np.any(number)
