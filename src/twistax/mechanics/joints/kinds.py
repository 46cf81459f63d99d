"""The joints: a weld, a hinge, a slide, a ball joint, and no bearing at all."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...expr import Constant, Expr
from ...expr.lie import AxisRotation, Pose
from ...expr.lie.maps import unit_vector
from ...groups import SE3, SO3
from .joint import Joint


class Fixed(Joint):
    """No motion: H has shape (6, 0), T_pc = I, and the bearing carries every wrench. There are no states.

    Args:
        name: of the joint.
    Raises:
        ModelError: no name.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.zeros((6, 0)))

    def placement(self, position: Expr) -> Expr:
        return Constant(np.eye(4))


class Revolute(Joint):
    """One turn about a fixed axis a through the joint's origin: H = [0; a], T_pc = [Rot(a, q) 0; 0 1], q in rad.

    Args:
        name: of the joint.
        axis: a (3,), the same in both joint frames; any non-zero length, normalised.
    Raises:
        ShapeError: axis is not of shape (3,).
        ModelError: no name; an axis that is zero or not finite.
    """

    def __init__(self, name: str, axis: Any) -> None:
        self.axis = unit_vector(f"Revolute {name!r}", "axis", axis)
        super().__init__(name, motion=np.concatenate([np.zeros(3), self.axis]))

    def placement(self, position: Expr) -> Expr:
        return Pose(AxisRotation(position[0], self.axis), np.zeros(3))


class Prismatic(Joint):
    """One translation along a fixed axis a: H = [a; 0], T_pc = [I q a; 0 1], q in m.

    Args:
        name, axis: as for `Revolute`.
    Raises:
        ShapeError, ModelError: as for `Revolute`.
    """

    def __init__(self, name: str, axis: Any) -> None:
        self.axis = unit_vector(f"Prismatic {name!r}", "axis", axis)
        super().__init__(name, motion=np.concatenate([self.axis, np.zeros(3)]))

    def placement(self, position: Expr) -> Expr:
        return Pose(np.eye(3), self.axis * position[0])


class Spherical(Joint):
    """All turns about the joint's origin: H = [0; I], T_pc = [R 0; 0 1].

    The position is R (3, 3) on SO(3), the velocity the body rate w (3,) in rad/s, R' = R [w]x.

    Args:
        name: of the joint.
    Raises:
        ModelError: no name.
    """

    group = SO3

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.eye(6)[:, 3:])

    def placement(self, position: Expr) -> Expr:
        return Pose(position, np.zeros(3))


class Free(Joint):
    """All motions: H = I, T_pc is the position itself, on SE(3); the velocity is the body twist [v; w] (6,).

    There are no constraint wrenches: H-bar* has shape (6, 0).

    Args:
        name: of the joint.
    Raises:
        ModelError: no name.
    """

    group = SE3

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.eye(6))

    def placement(self, position: Expr) -> Expr:
        return position
