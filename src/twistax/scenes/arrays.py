"""Rotations and poses as NumPy arrays, in the precision of what they are made of: starts and known answers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "about", "cross_matrix", "placed"]

Array = NDArray[Any]


def cross_matrix(a: Array) -> Array:
    """The matrix (3, 3) of the cross product with a (3,)."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=a.dtype)


def about(axis: Any, angle: Any) -> Array:
    """The rotation (3, 3) about a unit axis (3,) by an angle in rad, by Rodrigues' formula."""
    hat = cross_matrix(np.asarray(axis, np.result_type(np.asarray(axis).dtype, float)))
    return np.eye(3, dtype=hat.dtype) + np.sin(angle) * hat + (1 - np.cos(angle)) * (hat @ hat)


def placed(rotation: Array, position: Any) -> Array:
    """The pose [R p; 0 1] (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose
