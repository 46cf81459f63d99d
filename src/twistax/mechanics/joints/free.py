"""No bearing at all."""

from __future__ import annotations

import numpy as np

from ...expr import Expr
from ...groups import SE3
from .joint import Joint


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
