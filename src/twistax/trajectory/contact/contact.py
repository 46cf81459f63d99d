"""Contact as complementarity constraints: the optimiser determines when a point touches, sticks and slips."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from ...checks import number, short
from ...errors import ModelError, ShapeError
from ...expr import Abs, Constant, Control, Expr, Norm, Parameter, State, to_expr
from ...expr.operations.comparisons import Complementarity, ConstraintSet
from ...mechanics.arguments import scalar

#: Directions of slip in the contact plane; the largest component of the velocity along these approximates the speed.
_DIRECTIONS = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Friction:
    r"""Coulomb friction of a `Contact` with the normal force N: $|f| \le \mu N$, and f dissipates as much power as it
    can, $\mu N |v| + f \cdot v \le \epsilon$.

    So in a plane f is $-\mu N v / |v|$ while the point slips, and any force within the cone while it sticks. In space,
    $|v|$ is approximated by the largest $d_i \cdot v$ over eight directions $d_i$, which is at least $0.92\,|v|$. So f
    may deviate from $-v$ by 23 degrees, and dissipates at least 0.92 of the greatest power.

    Source: D. E. Stewart, J. C. Trinkle, An implicit time-stepping scheme for rigid body dynamics with inelastic
    collisions and Coulomb friction, International Journal for Numerical Methods in Engineering 39 (1996), the principle
    of maximal dissipation.

    Args:
        coefficient: mu, a number or a scalar expression such as a `Parameter`.
        force: the tangential force f on the body, N: () in a plane, (2,) in space.
        velocity: the tangential velocity v of its point relative to the other body, m/s, of the shape of the force.

    Raises:
        ModelError: a coefficient that is negative.
        ShapeError: a coefficient that is not (), or a force and a velocity that are not both () or both (2,).

    Example: `tx.trajectory.Friction(0.5, force=f, velocity=v)`.
    """

    coefficient: Expr
    force: Expr
    velocity: Expr

    def __init__(self, coefficient: Any, *, force: Any, velocity: Any) -> None:
        mu = scalar("Friction", "coefficient", coefficient, "a number not below zero", lambda m: 0.0 <= m < math.inf)
        object.__setattr__(self, "coefficient", mu)
        for name, value in (("force", force), ("velocity", velocity)):
            object.__setattr__(self, name, to_expr(value))
        shape = self.force.check_shape()
        if shape not in ((), (2,)) or self.velocity.check_shape() != shape:
            raise ShapeError(
                "Friction expects a force and a velocity that are both () in a plane or (2,) in space, got "
                f"{shape} and {self.velocity.shape}"
            )

    def named(self, normal: Expr, relaxation: Parameter) -> dict[str, Any]:
        """The constraints for a normal force, by name."""
        f, v, most = self.force, self.velocity, self.coefficient * normal
        if f.shape == ():
            speeds, power, cone = Constant(np.array([1.0, -1.0])) * v, f * v, Abs(f) <= most
        else:
            angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
            speeds = Constant(np.stack([np.cos(angles), np.sin(angles)], axis=1)) @ v
            power, cone = f @ v, Norm(f) <= most
        return {"cone": cone, "slip": Complementarity(most * speeds + power, relaxation)}


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Contact(ConstraintSet):
    r"""A complementarity constraint for a point and a surface that may touch: $\phi \ge 0$, $N \ge 0$ and $\phi N \le
    \epsilon$.

    Use it like a constraint, in the `constraints` of a `System`. The optimiser determines when there is contact. The
    product relates the force along an interval to the gap at its end, as a step of the backward Euler method does. With
    the transcription `tx.trajectory.Collocation(tx.tableaus.RADAU_IIA1)`, which is that method, impacts are inelastic
    and take one interval. With other collocation methods the optimiser chooses the restitution of impacts, which may be
    elastic. With multiple shooting the force of an interval begins before the contact at its end.

    `problem.solve()` starts with a relaxation $\epsilon$ of a hundredth of a typical product. Each further relaxation
    is 0.3 times the previous one and is solved with a warm start, down to the value of the relaxation's parameter,
    without recompilation. `result.complementarity` has the remaining products. A solve with a warm start, `solve_many`,
    `solution` and controllers use only the last value.

    Sources: M. Posa, C. Cantu, R. Tedrake, A direct method for trajectory optimization of rigid bodies through contact,
    International Journal of Robotics Research 33 (2014), equations (10) to (14); S. Scholtes, Convergence properties
    of a regularization scheme for mathematical programs with complementarity constraints, SIAM Journal on Optimization
    11 (2001), equation (1), for the relaxation.

    Args:
        gap: phi, the signed distance (), m, an expression of states.
        force: N, the normal force (), N; a control, or an expression.
        friction: None, or a `Friction`.
        relaxation: the last relaxation epsilon, in N m for the gap and in W for friction; a number, or a scalar
            `Parameter` with a value. Contacts with equal numbers share one parameter, "contact relaxation".

    Raises:
        ModelError: a friction or a relaxation of the wrong type, or a relaxation that is not positive.
        ShapeError: a gap or a force that is not a scalar.

    Example: `tx.System(rates=..., constraints={"toe": tx.trajectory.Contact(height, N)})`.
    """

    gap: Expr
    force: Expr
    friction: Friction | None
    relaxation: Parameter

    def __init__(self, gap: Any, force: Any, friction: Any = None, *, relaxation: Any = 1e-6) -> None:
        for name, value in (("gap", gap), ("force", force)):
            object.__setattr__(self, name, scalar("Contact", name, value))
        if friction is not None and not isinstance(friction, Friction):
            raise ModelError(f"Contact expects a tx.trajectory.Friction as friction, got {short(friction)}")
        if not isinstance(relaxation, Parameter):
            number("Contact: relaxation", relaxation, "a positive number", lambda e: 0.0 < e < math.inf, ModelError)
            relaxation = Parameter("contact relaxation", value=float(relaxation))
        if relaxation.shape != ():
            raise ShapeError(f"Contact expects a scalar relaxation, got shape {relaxation.shape}")
        object.__setattr__(self, "friction", friction)
        object.__setattr__(self, "relaxation", relaxation)

    def __repr__(self) -> str:
        return f"Contact({self.gap!r}, {self.force!r})"

    def named(self) -> dict[str, Any]:
        rows: dict[str, Any] = {"gap": self.gap >= 0.0, "force": self.force >= 0.0}
        # A row that duplicates a limit would make the multipliers of both indeterminate.
        rows = {name: row for name, row in rows.items() if not _has_limit_at_zero(getattr(self, name))}
        rows["complementarity"] = Complementarity(self.gap * self.force, self.relaxation)
        return rows if self.friction is None else rows | self.friction.named(self.force, self.relaxation)


def _has_limit_at_zero(leaf: Expr) -> bool:
    return isinstance(leaf, (State, Control)) and leaf.min is not None and float(leaf.min) >= 0.0
