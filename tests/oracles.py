"""Matrices of the Lie algebras written out, for numbers of any kind."""

from typing import Any

import numpy as np


def skew(w: Any) -> np.ndarray:
    """The matrix (3, 3) of the cross product with w (3,)."""
    x, y, z = w
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def hat(xi: Any) -> np.ndarray:
    """The matrix (4, 4) of a twist (6,), linear part first."""
    return np.block([[skew(xi[3:]), xi[:3, None]], [np.zeros((1, 4))]])
