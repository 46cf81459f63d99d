"""Tasks of a frame: its pose, its position, its orientation."""

from __future__ import annotations

import dataclasses

from ...expr import Expr
from ...expr.fields import ExprLike
from ...expr.lie import Compose, Inverse, LeftJacobianInverse, SE3Log, SO3Log
from ..algorithms.jacobians import ALIGNED, BODY, frame_jacobian
from ..kinematic_tree import KinematicTree
from .task import Task


@dataclasses.dataclass(frozen=True, eq=False)
class FrameTask(Task):
    """Moves a frame to a pose: $e = Log(T^-1 T_d)$ (6,), a twist [v; w] in its axes, $J = J_l(e)^-1 J_body$.

    Source: S. Caron, Jacobian of a kinematic task and derivatives on manifolds (2023), as in pink's `FrameTask`.

    Attributes:
        frame: the name of the frame.
        target: $T_d$ (4, 4) in the base; None: the Control "<frame>_pose".
        weight, gain, damping: as for `Task`.
    Raises: ModelError for an unknown frame; ShapeError for a target of the wrong shape; the errors of `Task`.
    Example: `FrameTask("tool", tx.pose(position=[0.5, 0.0, 0.4]))`.
    """

    frame: str
    target: ExprLike | None = None

    def error(self, mechanism: KinematicTree) -> Expr:
        T_d = self._target(f"{self.frame}_pose", self.target, (4, 4))
        return SE3Log(Compose(Inverse(mechanism.pose(self.frame)), T_d))

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        return LeftJacobianInverse(self.error(mechanism)) @ frame_jacobian(mechanism, self.frame, axes=BODY)


@dataclasses.dataclass(frozen=True, eq=False)
class PositionTask(Task):
    """Moves the origin of a frame to a position: $e = p_d - p$ (3,), m, in the axes of the base.

    Attributes:
        frame: the name of the frame.
        target: $p_d$ (3,) in the base; None: the Control "<frame>_position".
        weight, gain, damping: as for `Task`.
    Raises: ModelError for an unknown frame; ShapeError for a target of the wrong shape; the errors of `Task`.
    Example: `PositionTask("tool", [0.5, 0.0, 0.4], gain=5.0)`.
    """

    frame: str
    target: ExprLike | None = None

    def error(self, mechanism: KinematicTree) -> Expr:
        p_d = self._target(f"{self.frame}_position", self.target, (3,))
        return p_d - mechanism.pose(self.frame)[:3, 3]

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        return frame_jacobian(mechanism, self.frame, axes=ALIGNED)[:3]


@dataclasses.dataclass(frozen=True, eq=False)
class OrientationTask(Task):
    """Rotates a frame to an attitude: $e = Log(R^T R_d)$ (3,), rad, in its axes, $J = J_l(e)^-1 J_w$.

    Attributes:
        frame: the name of the frame.
        target: $R_d$ (3, 3) in the base; None: the Control "<frame>_orientation".
        weight, gain, damping: as for `Task`.
    Raises: ModelError for an unknown frame; ShapeError for a target of the wrong shape; the errors of `Task`.
    Example: `OrientationTask("tool", np.eye(3))`.
    """

    frame: str
    target: ExprLike | None = None

    def error(self, mechanism: KinematicTree) -> Expr:
        R_d = self._target(f"{self.frame}_orientation", self.target, (3, 3))
        return SO3Log(mechanism.pose(self.frame)[:3, :3].T @ R_d)

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        return LeftJacobianInverse(self.error(mechanism)) @ frame_jacobian(mechanism, self.frame, axes=BODY)[3:]
