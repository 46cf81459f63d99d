"""The task of staying away from singular positions."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import ModelError
from ...expr import Concat, Constant, Expr, InversePositive, Sum
from ..algorithms.jacobians import BODY, frame_jacobian, frame_jacobian_rate
from ..kinematic_tree import KinematicTree
from .task import Task


@dataclasses.dataclass(frozen=True, eq=False)
class ManipulabilityTask(Task):
    """Increases the manipulability $m = sqrt(det(J J^T))$ of a frame: $log m$ by the gain per second. The error is 1,
    the Jacobian $(log m)_i = tr((J J^T)^-1 J_i J^T)$ with the derivatives $J_i$ of the frame's Jacobian.

    Source: T. Yoshikawa, Manipulability of robotic mechanisms, International Journal of Robotics Research 4 (1985).

    Attributes:
        frame: its name.
        angular: whether J has the rows of the angular velocity as well.
        weight, gain, damping: as of `Task`.
    Raises: ModelError for fewer degrees of freedom than rows.
    """

    frame: str
    angular: bool = False
    gain: float | None = dataclasses.field(default=1.0, kw_only=True)

    def error(self, mechanism: KinematicTree) -> Expr:
        return Constant(np.ones(1))

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        rows, n = 6 if self.angular else 3, mechanism.dofs
        if n < rows:
            raise ModelError(f"ManipulabilityTask: a Jacobian ({rows}, {n}) is singular everywhere")
        J = frame_jacobian(mechanism, self.frame, axes=BODY)[:rows]
        K = InversePositive(J @ J.T) @ J
        slopes = [frame_jacobian_rate(mechanism, self.frame, qd=unit, axes=BODY)[:rows] for unit in np.eye(n)]
        return Concat(*(Sum(K * slope) for slope in slopes))[None]
