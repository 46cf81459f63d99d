"""Joint forces for control: operational-space control of tasks, and computed torque."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...checks import reals, short
from ...errors import ModelError, ShapeError
from ...expr import Constant, Expr, InversePositive, SolvePositive, to_expr
from ...expr.fields import ExprLike
from ..algorithms.dynamics import checked, inverse_dynamics, mass_matrix
from ..arguments import of_shape
from ..kinematic_tree import KinematicTree, Positions


class OperationalSpace(NamedTuple):
    """The operational-space inertia of a task, its dynamically consistent inverse and its null space.

    Attributes:
        inertia: $Lambda = (J M^-1 J^T)^-1$ (m, m): a force F of the task, by $tau = J^T F$, accelerates it by
            $Lambda^-1 F$.
        inverse: $J^+ = M^-1 J^T Lambda$ (n, m), the inverse of J with minimal kinetic energy.
        null_space: $N = 1 - J^T (J^+)^T$ (n, n): joint forces $N tau$ do not accelerate the task.
    """

    inertia: Expr
    inverse: Expr
    null_space: Expr


def operational_space(mechanism: KinematicTree, J: ExprLike, q: Positions | None = None) -> OperationalSpace:
    """The operational-space inertia, the dynamically consistent inverse and the null space of a task with a Jacobian.

    With the desired acceleration a of the task and other forces $tau_0$, the joint forces are

        $tau = J^T Lambda (a - J' qd) + N tau_0 + h$,

    with the bias forces h from `bias_forces`. J must have full rank: `ManipulabilityTask` avoids singular
    configurations.

    Source: O. Khatib, A unified approach for motion and force control of robot manipulators: the operational space
    formulation, IEEE Journal of Robotics and Automation 3 (1987), equations 30, 37 and 51.

    Args:
        J: (m, n), such as `frame_jacobian(mechanism, "hand")[:3]` or `task.jacobian(mechanism)`.
        q: positions; those of the mechanism by default.
    Raises: ShapeError for J of another shape, or with more rows than degrees of freedom; ModelError if no mass moves.

    Example:
        `space = operational_space(arm, frame_jacobian(arm, "hand")[:3])`
    """
    n = checked("operational_space", mechanism).dofs
    J = to_expr(J)
    if len(J.shape) != 2 or J.shape[1] != n or J.shape[0] > n:
        raise ShapeError(f"operational_space expects J with shape (m, {n}), m at most {n}, got {J.shape}")
    moved = SolvePositive(mass_matrix(mechanism, q), J.T)
    inertia = InversePositive(J @ moved)
    inverse = moved @ inertia
    return OperationalSpace(inertia, inverse, Constant(np.eye(n)) - J.T @ inverse.T)


def computed_torque(
    mechanism: KinematicTree,
    error: ExprLike,
    error_rate: ExprLike,
    *,
    stiffness: ExprLike,
    damping: ExprLike,
    acceleration: ExprLike | None = None,
) -> Expr:
    """Joint forces (n,) with which the joint errors decay as $e'' + k_d e' + k_p e = 0$:

        $tau = M(q) (qdd_d + k_d e' + k_p e) + h(q, qd)$.

    Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), section 1.2; J. Luh, M. Walker, R. Paul, IEEE
    Transactions on Automatic Control 25 (1980).

    Args:
        error: $e = q_d - q$ (n,), such as `PostureTask(q_d).error(arm)`; for joints on groups the logarithm.
        error_rate: $e' = qd_d - qd$ (n,).
        stiffness, damping: $k_p$ in 1/s2 and $k_d$ in 1/s, numbers or (n,).
        acceleration: $qdd_d$ (n,); zero by default.
    Raises:
        ShapeError: an argument of the wrong shape.
        ModelError: a mechanism with loops; a stiffness or damping that is negative or not finite.

    Example:
        `computed_torque(arm, q_d - arm.q, -arm.qd, stiffness=100.0, damping=20.0)`
    """
    owner, n = "computed_torque", checked("computed_torque", mechanism).dofs
    e, rate = (of_shape(owner, name, value, (n,)) for name, value in (("error", error), ("error_rate", error_rate)))
    for name, value in (("stiffness", stiffness), ("damping", damping)):
        numbers = np.zeros(()) if isinstance(value, Expr) else reals(f"{owner}: {name}", value, ModelError)
        if numbers.shape not in ((), (n,)) or not (np.isfinite(numbers) & (numbers >= 0.0)).all():
            raise ModelError(f"{owner} expects {name} to be finite and 0 or more, () or ({n},), got {short(value)}")
    wanted = to_expr(damping) * rate + to_expr(stiffness) * e
    if acceleration is not None:
        wanted = wanted + of_shape(owner, "acceleration", acceleration, (n,))
    return inverse_dynamics(mechanism, qdd=wanted)
