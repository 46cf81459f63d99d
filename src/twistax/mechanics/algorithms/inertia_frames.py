"""Symmetric 6x6 inertias [M H; H' J] in other frames; equal entries are computed only once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...expr import Block, Constant, Cos, Expr, Sin, Where
from ...expr.lie import AxisRotation, CoadjointAction, translation
from ...expr.lie.elements import parts_of_pose
from ..screws import complement

#: Indices of the factors in the entries of 3x3 matrices.
_REFLECTED = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
_ACROSS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
_ALONG = np.diag([1.0, -1.0, 0.0])
_LAST_COLUMN = np.outer([1.0, 1.0, 0.0], [0.0, 0.0, 1.0])
_LAST_ROW = _LAST_COLUMN.T


def mirrored(I: Expr) -> Expr:
    """A symmetric matrix (n, n) from the entries of I on and above the diagonal."""
    return Where(Constant(np.triu(np.ones(I.shape, dtype=bool))), I, I.T)


def in_frame(T: Expr, I: Expr) -> Expr:
    """Ad*_T I Ad_T^-1 (6, 6) of a symmetric I."""
    R, p = parts_of_pose(T)
    if isinstance(R, AxisRotation):
        I, T = _turned_about_axis(R, I), translation(p)
    return mirrored(CoadjointAction(T, CoadjointAction(T, I).T))


def _turned_about_axis(R: AxisRotation, I: Expr) -> Expr:
    """The blocks R M R', R H R', R J R' for a rotation about a fixed axis."""
    C = Constant(rotation_to(R.axis))

    def turned(X: Expr) -> Expr:
        return C @ _turned_about_z(C.T @ X @ C, R.angle) @ C.T

    H = turned(I[:3, 3:])
    return Block([[turned(I[:3, :3]), H], [H.T, turned(I[3:, 3:])]])


def _turned_about_z(X: Expr, angle: Expr) -> Expr:
    """R X R' (3, 3) for a rotation R about z: entries with one index z transform like vectors, the others with the
    double angle.

    With y = s (x00 - x11) + c (x01 + x10), the latter are [x00 - s y, c y - x10; c y - x01, x11 + s y], which takes
    eleven operations in place of 24.
    """
    R, s, c = AxisRotation(angle, (0.0, 0.0, 1.0)), Sin(angle), Cos(angle)
    y = s * (X[0, 0] - X[1, 1]) + c * (X[0, 1] + X[1, 0])
    plane = _REFLECTED * X.T + (c * y) * _ACROSS - (s * y) * _ALONG
    return plane + R @ (_LAST_COLUMN * X) + (_LAST_ROW * X) @ R.T


def rotation_to(axis: tuple[float, ...]) -> NDArray[np.float64]:
    """A rotation C (3, 3) with C z = axis; a permutation up to signs if the axis is a coordinate axis."""
    C = np.column_stack([complement(np.array(axis)[:, None]), axis])
    return C if np.linalg.det(C) > 0.0 else C[:, [1, 0, 2]]
