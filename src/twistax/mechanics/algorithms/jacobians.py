"""Jacobians of frames: the velocity of a frame due to the velocities of a mechanism, in selectable axes.

Only the columns of joints between the base and the frame are computed; all others are zero.

Source: K. Lynch, F. Park, Modern Robotics (2017), chapter 5, for body and space Jacobians, there [w; v].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ...errors import ModelError
from ...expr import Constant, Cross, Expr, Stack
from ...expr.fields import ExprLike
from ...expr.lie import Adjoint, AdjointAction, Compose, Inverse, angular, linear, translation, twist
from ..kinematic_tree import KinematicTree, Positions
from .dynamics import checked

_ZERO = Constant(np.zeros(6))


@dataclasses.dataclass(frozen=True)
class Axes:
    """The axes and the reference point of a twist: one of `BODY`, `WORLD` and `ALIGNED`.

    Attributes:
        name: the name in messages.
    """

    name: str

    def __repr__(self) -> str:
        return self.name


#: In the frame's own axes, about the frame's origin: the body twist.
BODY = Axes("BODY")
#: In the base's axes, about the base's origin: the spatial twist.
WORLD = Axes("WORLD")
#: In the base's axes, about the frame's origin: the velocity of that point, and the angular velocity.
ALIGNED = Axes("ALIGNED")


def frame_twist(
    mechanism: KinematicTree, frame: str, q: Positions | None = None, qd: ExprLike | None = None, axes: Axes = BODY
) -> Expr:
    """The velocity (6,) of a frame relative to the base, $[v; w] = J qd$ in m/s and rad/s, in the chosen axes.

    Raises:
        ShapeError: positions or velocities of the wrong shape.
        ModelError: an unknown frame.
    Example: `tx.lower(frame_twist(arm, "tool"))(0.0, {"q": q, "qd": qd})`.
    """
    V = checked("frame_twist", mechanism).twist(frame, q, qd)
    return AdjointAction(_to(axes, mechanism.pose(frame, q)), V)


def frame_jacobian(mechanism: KinematicTree, frame: str, q: Positions | None = None, axes: Axes = BODY) -> Expr:
    """The Jacobian J (6, n) of a frame: $J qd = [v; w]$ is its velocity, m/s and rad/s, in the chosen axes.

    Raises the errors of `frame_twist`.
    Example: `tx.lower(frame_jacobian(arm, "tool", axes=ALIGNED))(0.0, {"q": q})`.
    """
    path = _Path("frame_jacobian", mechanism, frame, q)
    _known(axes)
    if axes is BODY:
        return path.gathered(lambda j, H: AdjointAction(path.to_frame(j), H, inverse=True))
    J = path.gathered(lambda j, H: AdjointAction(path.poses[j], H))
    return J if axes is WORLD else AdjointAction(_about(path.pose), J, inverse=True)


def frame_jacobian_rate(
    mechanism: KinematicTree, frame: str, q: Positions | None = None, qd: ExprLike | None = None, axes: Axes = BODY
) -> Expr:
    """The time derivative J' (6, n) of `frame_jacobian`: $J qdd + J' qd$ is the rate of `frame_twist`. Raises the
    errors of `frame_twist`.
    """
    path = _Path("frame_jacobian_rate", mechanism, frame, q)
    _known(axes)
    twists, V = mechanism.twists(q, qd), mechanism.twist(frame, q, qd)
    if axes is BODY:

        def turned(j: int, H: Expr) -> Expr:
            T = path.to_frame(j)
            return Adjoint(AdjointAction(T, twists[j], inverse=True) - V, AdjointAction(T, H, inverse=True))

        return path.gathered(turned)
    rate = path.gathered(lambda j, H: AdjointAction(path.poses[j], Adjoint(twists[j], H)))
    if axes is WORLD:
        return rate
    # The reference point moves as well: this gives the term p' x w in the rate of [v - p x w; w].
    v = linear(AdjointAction(_to(axes, path.pose), V))
    dragged = path.gathered(
        lambda j, H: twist(linear=Cross(v, angular(AdjointAction(path.poses[j], H))), angular=Constant(np.zeros(3)))
    )
    return AdjointAction(_about(path.pose), rate, inverse=True) - dragged


def _about(T: Expr) -> Expr:
    """The pose of a frame with the base's axes and the origin of another frame."""
    return translation(T[:3, 3])


def _to(axes: Axes, T: Expr) -> Expr:
    """The pose whose Adjoint transforms the body twist of a frame with pose T into the axes."""
    if _known(axes) is BODY:
        return Constant(np.eye(4))
    return T if axes is WORLD else Compose(Inverse(_about(T)), T)


def _known(axes: Axes) -> Axes:
    """The axes themselves. Raises ModelError for other objects."""
    if not any(axes is known for known in (BODY, WORLD, ALIGNED)):
        raise ModelError(f"axes must be BODY, WORLD or ALIGNED of twistax.mechanics, got {axes!r}")
    return axes


class _Path:
    """The path from a frame to the base."""

    def __init__(self, owner: str, mechanism: KinematicTree, frame: str, q: Positions | None) -> None:
        checked(owner, mechanism)
        self.mechanism, self.at = mechanism, mechanism.frame(frame)
        self.poses = mechanism.poses(q)
        self.pose = self.at.T if self.at.segment < 0 else Compose(self.poses[self.at.segment], self.at.T)
        self._between: dict[int, Expr] = {}
        steps, T, j = mechanism.transforms(q), self.at.T, self.at.segment
        while j >= 0:
            self._between[j] = T
            T, j = Compose(steps[j], T), mechanism.segments[j].before

    def to_frame(self, j: int) -> Expr:
        """The pose of the frame in segment j."""
        return self._between[j]

    def gathered(self, column: Callable[[int, Expr], Expr]) -> Expr:
        """(6, n): the column of each freedom on the path, from its motion H in segment j."""
        columns: list[list[Expr]] = [[] for _ in range(self.mechanism.dofs)]
        for j in self._between:
            segment = self.mechanism.segments[j]
            ratio = 1.0 if segment.link.mimic is None else segment.link.mimic.ratio
            for k, a in enumerate(segment.freedoms):
                motion = column(j, segment.link.joint.motion_subspace[:, k])
                columns[a].append(motion if segment.link.mimic is None else ratio * motion)
        return Stack(*(sum(terms[1:], terms[0]) if terms else _ZERO for terms in columns)).T
