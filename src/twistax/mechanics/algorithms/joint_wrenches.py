"""The wrench that a joint carries, in any frame: its coscrew."""

from __future__ import annotations

from ...expr import Expr
from ...expr.fields import ExprLike
from ...expr.lie import Compose, Inverse, SE3AdjointDual
from ..kinematic_tree import KinematicTree, Positions
from .dynamics import Wrenches, carried_wrenches, checked


def joint_wrench(
    mechanism: KinematicTree,
    joint: str,
    q: Positions | None = None,
    qd: ExprLike | None = None,
    qdd: ExprLike | None = None,
    *,
    frame: str | None = None,
    wrenches: Wrenches | None = None,
) -> Expr:
    """F = [f; tau] (6,) that a joint puts on the link it carries, motor and bearing together.

    It is what `inverse_dynamics` sums up: the segment's own M B + ad*_W(M W), and all that hangs on it. Take
    `joint.actuation(F)` for the motor's part and `joint.reaction(F)` for that of the bearing. In the motion of a system
    it is `mechanism.system(outputs=lambda qdd, tau: {"load": joint_wrench(mechanism, joint, qdd=qdd)})`.

    Args:
        mechanism: a tree or a chain.
        joint: its name. A Fixed joint has to be kept, `keep=`, to be asked.
        q, qd, qdd: positions, velocities and accelerations; qdd zero unless given.
        frame: the frame it is written in, about its origin in its axes; that of the joint's link unless given.
        wrenches: what acts on the mechanism from outside.
    Raises:
        ShapeError: an argument of another shape.
        ModelError: a joint or frame that is not known.
    """
    owner = "joint_wrench"
    i = checked(owner, mechanism).segments.index(mechanism.segment_of(joint))
    rates = mechanism.coordinates(owner, "qdd", [0.0] * mechanism.dofs if qdd is None else qdd)
    F = carried_wrenches(owner, mechanism, q, qd, rates, wrenches)[i]
    if frame is None:
        return F
    return SE3AdjointDual(Compose(Inverse(mechanism.pose(frame, q)), mechanism.poses(q)[i])) @ F
