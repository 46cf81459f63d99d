"""The slide."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...expr import Expr
from ...expr.lie import Pose
from ...expr.lie.axis import unit_vector
from .joint import Joint


class Prismatic(Joint):
    """One translation along a fixed axis a: H = [a; 0], T_pc = [I q a; 0 1], q in m.

    Args:
        name: of the joint.
        axis: a (3,), the same in both joint frames; any non-zero length, normalised.
    Raises:
        ShapeError: axis is not of shape (3,).
        ModelError: no name; an axis that is zero or not finite.
    """

    def __init__(self, name: str, axis: Any) -> None:
        self.axis = unit_vector(f"Prismatic {name!r}", "axis", axis)
        super().__init__(name, motion=np.concatenate([self.axis, np.zeros(3)]))

    def placement(self, position: Expr) -> Expr:
        return Pose(np.eye(3), self.axis * position[0])
