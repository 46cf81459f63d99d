"""The task of avoiding singular configurations."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np

from ...errors import ModelError
from ...expr import Concat, Constant, Expr, InversePositive, State, Sum, leaves_of
from ...system.lower import lower
from ..algorithms.jacobians import BODY, frame_jacobian, frame_jacobian_rate
from ..kinematic_tree import KinematicTree
from .configuration_space import ConfigurationSpace
from .task import Task

#: Singular values of a Jacobian below this are zero, in m or without unit.
_RANK = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class ManipulabilityTask(Task):
    """Increases the manipulability $m = sqrt(det(J J^T))$ of a frame: the gain is the desired rate of $log m$ per
    second. The error is 1, and the Jacobian is $(log m)_i = tr((J J^T)^-1 J_i J^T)$ with the derivatives $J_i$ of the
    frame's Jacobian.

    Source: T. Yoshikawa, Manipulability of robotic mechanisms, International Journal of Robotics Research 4 (1985).

    Attributes:
        frame: the name of the frame.
        angular: whether J includes the rows of the angular velocity.
        weight, gain, damping: as for `Task`.
    Raises: ModelError for a frame whose Jacobian has fewer degrees of freedom than rows, or is singular everywhere.
    Example: `ManipulabilityTask("tool", weight=1e-2)`.
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
        if _singular_everywhere(mechanism, J):
            raise ModelError(
                f"ManipulabilityTask: the Jacobian ({rows}, {n}) of {self.frame!r} is singular everywhere, "
                "for example because the arm moves in a plane"
            )
        K = InversePositive(J @ J.T) @ J
        slopes = [frame_jacobian_rate(mechanism, self.frame, qd=unit, axes=BODY)[:rows] for unit in np.eye(n)]
        return Concat(*(Sum(K * slope) for slope in slopes))[None]


def _singular_everywhere(mechanism: KinematicTree, J: Expr) -> bool:
    """Whether a Jacobian has dependent rows at random positions; False if it depends on parameters."""
    if not all(isinstance(leaf, (Constant, State)) for leaf in leaves_of(J)):
        return False
    space = ConfigurationSpace("ManipulabilityTask", mechanism)
    names = {leaf.name for leaf in leaves_of(J) if isinstance(leaf, State)}
    x = {name: value[0] for name, value in space.random(np.random.default_rng(0), 1).items() if name in names}
    with jax.enable_x64(True):
        return bool(np.linalg.matrix_rank(np.asarray(lower(J)(0.0, x)), tol=_RANK) < J.shape[0])
