"""The ball joint."""

from __future__ import annotations

import numpy as np

from ...expr import Expr
from ...expr.lie import Pose
from ...groups import SO3
from .joint import Joint


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
