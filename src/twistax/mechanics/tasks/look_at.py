"""The task of pointing an axis at a point."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...expr import Constant, Dot, Expr, Outer, Sqrt
from ...expr.fields import ExprLike
from ...expr.lie import Hat
from ...expr.lie.base import unit_vector
from ..algorithms.jacobians import BODY, frame_jacobian
from ..kinematic_tree import KinematicTree
from .task import Task


@dataclasses.dataclass(frozen=True, eq=False)
class LookAtTask(Task):
    """Points an axis a of a frame, such as that of a camera, at a point: $e = a - u$ (3,), in the axes of the frame,
    with the direction $u = R^T (p_d - p) / r$ and the distance r of the point. $J = [u] J_w - (1 - u u^T) J_v / r$.

    The length of e is $2 sin(angle / 2)$. The rotation about the axis is free.

    Attributes:
        frame: the name of the frame.
        axis: a (3,) in the frame, of any nonzero length; its x axis by default.
        target: $p_d$ (3,) in the base; None: the Control "<frame>_look_at".
        weight, gain, damping: as for `Task`.
    Raises: ModelError for an axis that is zero or not finite.
    Example: `LookAtTask("tool", (0.0, 0.0, 1.0), [1.0, 0.0, 0.5])`.
    """

    frame: str
    axis: Any = (1.0, 0.0, 0.0)
    target: ExprLike | None = None

    def _direction(self, mechanism: KinematicTree) -> tuple[Expr, Expr]:
        """The direction u (3,) and the distance r ()."""
        T, p_d = mechanism.pose(self.frame), self._target(f"{self.frame}_look_at", self.target, (3,))
        to_point = T[:3, :3].T @ (p_d - T[:3, 3])
        distance = Sqrt(Dot(to_point, to_point))
        return to_point / distance, distance

    def error(self, mechanism: KinematicTree) -> Expr:
        axis = unit_vector("LookAtTask", "axis", self.axis)
        return Constant(axis) - self._direction(mechanism)[0]

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        u, r = self._direction(mechanism)
        J = frame_jacobian(mechanism, self.frame, axes=BODY)
        return Hat(u) @ J[3:] - ((Constant(np.eye(3)) - Outer(u, u)) / r) @ J[:3]
