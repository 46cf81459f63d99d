"""The task of a pose of one frame relative to another one."""

from __future__ import annotations

import dataclasses

from ...expr import Expr
from ...expr.fields import ExprLike
from ...expr.lie import AdjointAction, Compose, Inverse, LeftJacobianInverse, SE3Log
from ..algorithms.jacobians import BODY, frame_jacobian
from ..kinematic_tree import KinematicTree
from .task import Task


@dataclasses.dataclass(frozen=True, eq=False)
class RelativeFrameTask(Task):
    """Moves a frame to a pose relative to another frame, which may also move: $e = Log(X^-1 X_d)$ (6,) with $X = T_r^-1
    T$, and $J = J_l(e)^-1 (J_body - Ad_X^-1 J_r)$.

    Attributes:
        frame, relative_to: the names of the two frames.
        target: $X_d$ (4, 4); None: the Control "<frame>_in_<relative_to>".
        weight, gain, damping: as for `Task`.
    Raises: ModelError for an unknown frame; ShapeError for a target of the wrong shape; the errors of `Task`.
    """

    frame: str
    relative_to: str
    target: ExprLike | None = None

    def error(self, mechanism: KinematicTree) -> Expr:
        X_d = self._target(f"{self.frame}_in_{self.relative_to}", self.target, (4, 4))
        return SE3Log(Compose(Inverse(mechanism.pose(self.frame, relative_to=self.relative_to)), X_d))

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        X = mechanism.pose(self.frame, relative_to=self.relative_to)
        J, J_r = (frame_jacobian(mechanism, name, axes=BODY) for name in (self.frame, self.relative_to))
        return LeftJacobianInverse(self.error(mechanism)) @ (J - AdjointAction(X, J_r, inverse=True))
