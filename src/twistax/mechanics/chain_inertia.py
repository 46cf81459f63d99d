"""Symmetric 6x6 inertias in other frames, with what is equal by symmetry computed once.

For [v; w] an inertia has the blocks [M H; H' J], M and J symmetric; a frame b, T = T_ab, sees it from a as
Ad*_T I Ad_T^-1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..expr import Block, Constant, Cos, Expr, Sin, Where
from ..expr.lie import AxisRotation, CoadjointAction, rotation, translation
from ..expr.lie.transforms import parts_of_pose
from .joints.screws import complement

__all__ = ["in_frame", "mirrored"]

#: The entries on and above the diagonal of a 6x6 matrix.
_UPPER = np.triu(np.ones((6, 6), dtype=bool))


def mirrored(I: Expr) -> Expr:
    """A symmetric matrix (6, 6) of the entries on and above the diagonal of I."""
    return Where(Constant(_UPPER), I, I.T)


def in_frame(T: Expr, I: Expr) -> Expr:
    """Ad*_T I Ad_T^-1 (6, 6) of a symmetric I: turned first, then moved."""
    R, p = parts_of_pose(T)
    turned = _turned_about_axis(R, I) if isinstance(R, AxisRotation) else _changed(rotation(R), I)
    return _changed(translation(p), turned)


def _changed(T: Expr, I: Expr) -> Expr:
    return mirrored(CoadjointAction(T, CoadjointAction(T, I).T))


def _turned_about_axis(R: AxisRotation, I: Expr) -> Expr:
    """The blocks R M R', R H R', R J R' of a turn about a fixed axis, together."""
    C, sine, cosine = Constant(_axes(R.axis)), Sin(R.angle), Cos(R.angle)

    def turned(X: Expr) -> Expr:
        return C @ _turned_about_z(C.T @ X @ C, sine, cosine) @ C.T

    H = turned(I[:3, 3:])
    return Block([[turned(I[:3, :3]), H], [H.T, turned(I[3:, 3:])]])


def _turned_about_z(X: Expr, s: Expr, c: Expr) -> Expr:
    """R X R' (3, 3) of the turn about z with sine s and cosine c.

    In the plane a tensor turns by the double angle: with y = s (x00 - x11) + c (x01 + x10), s y and c y do all of it,
    eleven operations in place of 24.
    """
    y = s * (X[0, 0] - X[1, 1]) + c * (X[0, 1] + X[1, 0])
    return Block(
        [
            [X[0, 0] - s * y, c * y - X[1, 0], c * X[0, 2] - s * X[1, 2]],
            [c * y - X[0, 1], X[1, 1] + s * y, s * X[0, 2] + c * X[1, 2]],
            [c * X[2, 0] - s * X[2, 1], s * X[2, 0] + c * X[2, 1], X[2, 2]],
        ]
    )


def _axes(axis: tuple[float, ...]) -> NDArray[np.float64]:
    """A rotation C (3, 3) with C z = axis: a permutation, signs apart, where the axis is one of the coordinates."""
    C = np.column_stack([complement(np.array(axis)[:, None]), axis])
    return C if np.linalg.det(C) > 0.0 else C[:, [1, 0, 2]]
