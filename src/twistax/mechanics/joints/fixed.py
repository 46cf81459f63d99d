"""The weld."""

from __future__ import annotations

import numpy as np

from ...expr import Constant, Expr
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
