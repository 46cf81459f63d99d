"""The hinge."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...expr import Expr
from ...expr.lie import AxisRotation, Pose
from ...expr.lie.axis import unit_vector
from .joint import Joint


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
