"""The wrench that a joint transmits, in any frame."""

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
    """The wrench F = [f; tau] (6,), N and N m, that a joint exerts on the link it carries: motor and bearing together.

    It is F in the equations of `inverse_dynamics`: the inertial wrench of the segment, $M B + ad*_W(M W)$, plus the
    wrenches on all segments that it carries, minus external wrenches. `joint.actuation(F)` is the generalised force of
    the motor, `joint.reaction(F)` the wrench of the bearing. For the wrench during a motion use
    `mechanism.system(outputs=lambda qdd, tau: {"load": joint_wrench(mechanism, joint, qdd=qdd)})`.

    Args:
        mechanism: a tree or a chain.
        joint: name of the joint. A Fixed joint must be named in the mechanism's `keep=`.
        q, qd, qdd: positions, velocities and accelerations; qdd zero by default.
        frame: the frame in whose axes and about whose origin F is expressed; by default that of the joint's link.
        wrenches: external wrenches (6,) by name of frame, about its origin and in its axes.
    Raises:
        ShapeError: an argument of the wrong shape.
        ModelError: an unknown joint or frame.
    """
    owner = "joint_wrench"
    i = checked(owner, mechanism).segments.index(mechanism.segment_of(joint))
    rates = mechanism.coordinates(owner, "qdd", [0.0] * mechanism.dofs if qdd is None else qdd)
    F = carried_wrenches(owner, mechanism, q, qd, rates, wrenches)[i]
    if frame is None:
        return F
    return SE3AdjointDual(Compose(Inverse(mechanism.pose(frame, q)), mechanism.poses(q)[i])) @ F
