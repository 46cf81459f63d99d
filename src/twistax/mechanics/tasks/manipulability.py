"""The task of avoiding singular configurations."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np

from ...checks import short
from ...errors import ModelError
from ...expr import Concat, Constant, Expr, InverseFactor, InversePositive, Log, State, Sum, leaves_of
from ...expr.fields import ExprLike
from ...system.lower import lower
from ..algorithms.jacobians import BODY, frame_jacobian, frame_jacobian_rate
from ..kinematic_tree import KinematicTree
from .configuration_space import ConfigurationSpace
from .task import Task

#: Singular values of a Jacobian below this are zero, in m or without unit.
_RANK = 1e-9
#: s, the size of singular values, in m or without unit, below which the manipulability does not decrease further.
_SMALLEST = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class ManipulabilityTask(Task):
    """Increases the manipulability $m = sqrt(det G)$ of a frame, with $G = J J^T + s^2 1$ and $s = 10^-3$ (m, and
    no unit in rows of the angular velocity).

    Without a target, the error is 1, and the gain is the desired rate of $log m$ per second. With a target $m_d$, the
    error is $log(m_d / m)$. The Jacobian is $(log m)_i = tr(G^-1 J_i J^T)$ with the derivatives $J_i$ of the frame's
    Jacobian. The term $s^2$ keeps G invertible at singular configurations; it is negligible where the singular
    values of J are much larger than s.

    Source: T. Yoshikawa, Manipulability of robotic mechanisms, International Journal of Robotics Research 4 (1985); Y.
    Nakamura, H. Hanafusa, Inverse kinematic solutions with singularity robustness, Journal of Dynamic Systems,
    Measurement, and Control 108 (1986), for $s^2$.

    Attributes:
        frame: the name of the frame.
        angular: whether J includes the rows of the angular velocity.
        target: $m_d$, a positive number or an expression; None: no target. `reach` needs one.
        weight, gain, damping: as for `Task`.
    Raises: ModelError for a frame whose Jacobian has fewer degrees of freedom than rows, or is singular everywhere; for
        a target that is not positive.
    Example: `ManipulabilityTask("tool", weight=1e-2)`.
    """

    frame: str
    angular: bool = False
    target: ExprLike | None = dataclasses.field(default=None, kw_only=True)
    gain: float | None = dataclasses.field(default=1.0, kw_only=True)

    def error(self, mechanism: KinematicTree) -> Expr:
        if self.target is None:
            return Constant(np.ones(1))
        target = self._target(f"{self.frame}_manipulability", self.target, ())
        number = getattr(self.target, "value", None) if isinstance(self.target, Expr) else self.target
        if number is not None and not np.asarray(number) > 0.0:
            raise ModelError(f"ManipulabilityTask expects target to be positive, got {short(self.target)}")
        factor = InverseFactor(self._gram(self._rows(mechanism)))  # V with G^-1 = V V^T, so m is 1 / det(V)
        k = np.arange(factor.shape[0])
        return (Log(target) + Sum(Log(factor[k, k])))[None]

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        J, n = self._rows(mechanism), mechanism.dofs
        K = InversePositive(self._gram(J)) @ J
        rows = J.shape[0]
        slopes = [frame_jacobian_rate(mechanism, self.frame, qd=unit, axes=BODY)[:rows] for unit in np.eye(n)]
        return Concat(*(Sum(K * slope) for slope in slopes))[None]

    def _rows(self, mechanism: KinematicTree) -> Expr:
        """The Jacobian of the frame."""
        rows, n = 6 if self.angular else 3, mechanism.dofs
        if n < rows:
            raise ModelError(f"ManipulabilityTask: a Jacobian ({rows}, {n}) is singular everywhere")
        J = frame_jacobian(mechanism, self.frame, axes=BODY)[:rows]
        if _singular_everywhere(mechanism, J):
            raise ModelError(
                f"ManipulabilityTask: the Jacobian ({rows}, {n}) of {self.frame!r} is singular everywhere, "
                "for example because the arm moves in a plane"
            )
        return J

    @staticmethod
    def _gram(J: Expr) -> Expr:
        return J @ J.T + Constant(_SMALLEST**2 * np.eye(J.shape[0]))


def _singular_everywhere(mechanism: KinematicTree, J: Expr) -> bool:
    """Whether a Jacobian has dependent rows at random positions; False if it depends on parameters."""
    if not all(isinstance(leaf, (Constant, State)) for leaf in leaves_of(J)):
        return False
    space = ConfigurationSpace("ManipulabilityTask", mechanism)
    names = {leaf.name for leaf in leaves_of(J) if isinstance(leaf, State)}
    x = {name: value[0] for name, value in space.random(np.random.default_rng(0), 1).items() if name in names}
    with jax.enable_x64(True):
        return bool(np.linalg.matrix_rank(np.asarray(lower(J)(0.0, x)), tol=_RANK) < J.shape[0])
