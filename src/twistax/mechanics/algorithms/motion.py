"""The pass of the recursions from the base to the tips: velocities, and the terms that follow from them.

In place of the rate A of a body's twist, in the body's frame, the recursions propagate

    B = A + [w x v; 0],

the acceleration of the frame's origin and the angular acceleration. With W = [0; w], the Newton-Euler equations are F =
M B + ad*_W(M W), without linear velocities. Let T be the pose of a segment in its parent segment, p its origin there, H
qd = [s; r] the twist across its joint, and w_0 the angular velocity of the parent in the axes of this segment:

    w = w_0 + r
    B = Ad_T^-1 (B_before + [w x (w x p); 0]) + [(w_0 + w) x s; w_0 x r] + H qdd

where the first bracket has the w of the parent. Gravity is an upward acceleration of the base.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), section 2.11, for B (the classical acceleration).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from ...expr import Constant, Cross, Expr
from ...expr.lie import Act, AdjointAction, AdjointDual, Inverse, angular, linear, twist
from ...expr.lie.elements import parts_of_pose
from ..kinematic_tree import KinematicTree
from ..tree import Segment

ZERO = Constant(np.zeros(3))
_NO_INERTIA = Constant(np.zeros((6, 6)))
_NO_WRENCH = Constant(np.zeros(6))


@dataclasses.dataclass(frozen=True)
class CarriedBody:
    """How accelerations pass to a segment. Six-vectors are in its frame, except `centripetal`, which is in that of its
    parent.
    """

    T: Expr  # pose of the segment in its parent
    centripetal: Expr  # [w x (w x p); 0] of the parent
    coriolis: Expr  # [(w_0 + w) x s; w_0 x r]

    def carried(self, B_before: Expr) -> Expr:
        """The acceleration (6,) of the segment for zero acceleration of its joint."""
        return AdjointAction(self.T, B_before + self.centripetal, inverse=True) + self.coriolis


@dataclasses.dataclass(frozen=True)
class Moving(CarriedBody):
    """The motion of a segment."""

    segment: Segment
    placement: Expr  # pose of the joint's child frame in its parent frame
    w: Expr  # angular velocity (3,), in the segment's frame

    @property
    def inertia(self) -> Expr:
        """The inertia M (6, 6)."""
        return inertia_of(self.segment)

    @property
    def gyroscopic(self) -> Expr:
        """The wrench ad*_W(M W) (6,) with the corresponding terms of masses that move in the body;
        it vanishes with w.
        """
        if self.segment.body is None:
            return _NO_WRENCH
        W = twist(linear=ZERO, angular=self.w)
        rigid, inner = AdjointDual(W, self.inertia @ W), self.segment.inner_motion
        return rigid if inner is None else rigid + inner.turning @ self.w

    @property
    def needed(self) -> Expr:
        """The wrench (6,) on the body for B = 0."""
        inner = self.segment.inner_motion
        return self.gyroscopic if inner is None else self.gyroscopic + inner.still


def inertia_of(segment: Segment) -> Expr:
    """M (6, 6) of a segment; zero if it has no mass."""
    return _NO_INERTIA if segment.body is None else segment.body.matrix


def acceleration_of_base(gravity: Expr) -> Expr:
    """The acceleration B (6,) of the base."""
    return twist(linear=-gravity, angular=ZERO)


def motion(mechanism: KinematicTree, positions: list[Expr], qd: Expr) -> list[Moving]:
    """The pass from the base to the tips: angular velocities and the terms that follow from them."""
    return list(motion_of(dict(enumerate(mechanism.segments)), dict(enumerate(positions)), qd, ZERO).values())


def motion_of(
    segments: Mapping[int, Segment], positions: Mapping[int, Expr], qd: Expr, w_base: Expr
) -> dict[int, Moving]:
    """The same for segments by index, on a base with an angular velocity (3,)."""
    moving: dict[int, Moving] = {}
    for i, segment in segments.items():
        T = segment.link.transform(positions[i])
        R, p = parts_of_pose(T)
        across = segment.along(qd)
        w_before = w_base if segment.before < 0 else moving[segment.before].w
        before = Act(Inverse(R), w_before)
        w = before + angular(across)
        moving[i] = Moving(
            segment=segment,
            placement=segment.link.joint.placement(positions[i]),
            T=T,
            w=w,
            centripetal=twist(linear=Cross(w_before, Cross(w_before, p)), angular=ZERO),
            coriolis=twist(linear=Cross(before + w, linear(across)), angular=Cross(before, angular(across))),
        )
    return moving


def accelerations(mechanism: KinematicTree, moving: list[Moving], qdd: Expr, base: Expr) -> list[Expr]:
    """The accelerations B (6,) of all segments, for joint accelerations (n,) and an acceleration of the base."""
    B: list[Expr] = []
    for state in moving:
        before = state.segment.before
        B.append(state.carried(base if before < 0 else B[before]) + mechanism.along(state.segment, qdd))
    return B
