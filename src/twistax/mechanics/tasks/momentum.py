"""Tasks of the whole mechanism: its centre of mass, and its momentum."""

from __future__ import annotations

import dataclasses

from ...expr import Expr
from ...expr.fields import ExprLike
from ..algorithms.momentum import center_of_mass, centroidal_matrix, total_mass
from ..kinematic_tree import KinematicTree
from .task import Task


@dataclasses.dataclass(frozen=True, eq=False)
class CenterOfMassTask(Task):
    """Moves the centre of mass to a position: $e = c_d - c$ (3,), m, in the base, $J = A_v / m$ with the centroidal
    matrix $A = [A_v; A_w]$.

    Attributes:
        target: $c_d$ (3,) in the base; None: the Control "center_of_mass".
        weight, gain, damping: as for `Task`.
    Raises: ModelError if no mass moves; ShapeError for a target of the wrong shape; the errors of `Task`.
    Example: `CenterOfMassTask([0.0, 0.0, 0.8])`.
    """

    target: ExprLike | None = None

    def error(self, mechanism: KinematicTree) -> Expr:
        return self._target("center_of_mass", self.target, (3,)) - center_of_mass(mechanism)

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        return centroidal_matrix(mechanism)[:3] / total_mass(mechanism)


@dataclasses.dataclass(frozen=True, eq=False)
class MomentumTask(Task):
    """Sets the momentum about the centre of mass to $h_d = [p; L]$ (6,), N s and N m s: $A(q) qd = h_d$.

    The error is $h_d$ itself, and the gain is 1.

    Source: S. Kajita and others, Resolved momentum control, IROS (2003).

    Attributes:
        target: $h_d$ (6,), in axes parallel to the base's; None: the Control "momentum".
        weight, gain, damping: as for `Task`.
    Raises: ModelError if no mass moves; ShapeError for a target of the wrong shape; the errors of `Task`.
    """

    target: ExprLike | None = None
    gain: float | None = dataclasses.field(default=1.0, kw_only=True)

    def error(self, mechanism: KinematicTree) -> Expr:
        return self._target("momentum", self.target, (6,))

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        return centroidal_matrix(mechanism)
