"""Joints as screws: their motion subspace, actuation wrenches and constraint wrenches.

A joint with k degrees of freedom has a motion subspace H (6, k), working wrenches h* (6, k) and constraint wrenches
H-bar* (6, 6 - k) with

    h*^T H = I, H^T H-bar* = 0, and [h* H-bar*] a basis of all wrenches.

A change of frame by T_ab maps motions by Ad_T and wrenches by Ad*_T = Ad_T^-T, so all three statements hold in every
frame. In contrast, orthogonality of h* and H-bar* depends on the frame, because the dot product of two wrenches does.

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 3.
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeAlias

import numpy as np

from ..checks import reals
from ..errors import ModelError, ShapeError
from ..expr import Concat, Constant, Expr, Norm, Parameter, Stack, Where
from ..expr.fields import ExprLike
from ..expr.kinds.kinds import FreeVector, Kind, Pose, Rotation, Twist
from ..expr.kinds.unit import METRE, ONE, SECOND, Unit
from ..expr.lie import SE3Adjoint, SE3AdjointDual, twist
from ..expr.lie.base import unit_vector
from ..groups import SE3, SO3, Group
from .arguments import of_shape, pose

#: The field names of a subspace.
Known: TypeAlias = tuple[Kind | None, Unit | None]
#: The tolerance of h*^T H = I.
_ROUND_OFF = 1e-12


class Subspaces:
    """Projections of wrenches onto the subspaces of a joint, in one frame."""

    motion_subspace: Expr
    actuation_basis: Expr
    constraint_basis: Expr

    def actuation(self, F: ExprLike) -> Expr:
        """$H^T F$ (k,): the generalised force of a wrench F (6,) on the child; N for a translation, N m for a rotation.

        Raises: ShapeError if F is not of shape (6,).
        """
        return self.motion_subspace.T @ of_shape("actuation of a joint", "the wrench F", F, (6,))

    def wrench(self, tau: ExprLike) -> Expr:
        """$h* tau$ (6,): the wrench on the child of an actuator with the generalised force tau (k,).

        Raises: ShapeError if tau is not of shape (k,).
        """
        freedoms = self.motion_subspace.shape[1]
        return self.actuation_basis @ of_shape("wrench of a joint", "the generalised force tau", tau, (freedoms,))

    def reaction(self, F: ExprLike) -> Expr:
        """$F - h* (H^T F)$ (6,): the part of a wrench F (6,) that the bearing carries; in the span of $Hbar*$.

        Raises: ShapeError if F is not of shape (6,).
        """
        wrench = of_shape("reaction of a joint", "the wrench F", F, (6,))
        return wrench - self.actuation_basis @ (self.motion_subspace.T @ wrench)


@dataclasses.dataclass(frozen=True)
class Screws(Subspaces):
    """Motion and force subspaces of a joint in one frame, and projections of wrenches onto them. Six-vectors are [v; w]
    and [f; tau].

    Attributes:
        motion_subspace: H (6, k); the twist of the child relative to the parent is H @ velocity.
        actuation_basis: h* (6, k), the wrench of a unit actuator on the child; $h*^T H = I$.
        constraint_basis: H-bar* (6, 6 - k), a basis of the wrenches that do no work on the joint's motions;
            $H^T Hbar* = 0$.
    """

    motion_subspace: Expr
    actuation_basis: Expr
    constraint_basis: Expr

    def in_frame(self, T: ExprLike) -> Screws:
        """The same joint expressed in frame a: $Ad_T H$, $Ad*_T h*$, $Ad*_T Hbar*$ with T (4, 4) from this frame b to
        a.

        Raises:
            ShapeError: T is not of shape (4, 4).
            ModelError: T is a numeric array and not a pose.
        """
        T_ab = pose("a change of frame of a joint", "the pose T", T)
        moved = SE3AdjointDual(T_ab)
        return Screws(
            SE3Adjoint(T_ab) @ self.motion_subspace, moved @ self.actuation_basis, moved @ self.constraint_basis
        )


def complement(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis (n, n - k) of the orthogonal complement of independent columns (n, k).

    The k coordinate axes closest to the columns are omitted; the others, in order, are made orthogonal to the columns
    and to each other. So the complement of coordinate axes consists of the other coordinate axes.
    """
    n, k = columns.shape
    basis = list(np.linalg.qr(columns)[0].T)
    left, near = sum((np.outer(b, b) for b in basis), start=np.zeros((n, n))), []
    for _ in range(k):
        # Rounded, so that ties are decided for the first axis on every machine.
        i = int(np.argmax(np.round(np.diag(left), 9)))
        near.append(i)
        left = left - np.outer(left[:, i], left[i]) / left[i, i]
    for i in range(n):
        if i not in near:
            vector = np.eye(n)[i]
            for b in basis * 2:  # twice: the second pass removes the round-off of the first
                vector = vector - b * (b @ vector)
            basis.append(vector / np.linalg.norm(vector))
    # Adding 0 turns -0 into 0.
    return np.stack(basis[k:], axis=1) + 0.0 if k < n else np.zeros((n, 0))


# ---- kinds and units of coordinates ----------------------------------------------------------------------------------


def turns_of(motion_subspace: Expr) -> tuple[bool, ...] | None:
    """For each degree of freedom whether it is a rotation, in rad, or a translation, in m; None
    if H is an expression.
    """
    if not isinstance(motion_subspace, Constant):
        return None
    return tuple(bool(np.any(column[3:])) for column in np.asarray(motion_subspace.value).T)


def unit_of(motion_subspace: Expr) -> Unit | None:
    """The common unit of all coordinates of a joint; None if the units differ."""
    turns = set(turns_of(motion_subspace) or ())
    return None if len(turns) != 1 else ONE if turns == {True} else METRE


def kinds_of(motion_subspace: Expr, group: Group | None) -> tuple[Known, Known]:
    """The kind and the unit of position and velocity. Their frames are those that the joint connects."""
    if group is SE3:
        return (Pose(), None), (Twist(), None)
    if group is SO3:
        return (Rotation(), None), (FreeVector(), ONE / SECOND)
    unit = unit_of(motion_subspace) if group is None else None
    return (None, unit), (None, None if unit is None else unit / SECOND)


def element_kind(group: Group | None, to: str, source: str) -> Kind | None:
    """The kind of a position on a group between two frames; None for other groups."""
    return Pose(to, source) if group is SE3 else Rotation(to, source) if group is SO3 else None


def screw(linear: Any, angular: Any) -> Any:
    """H of a joint with one degree of freedom; numbers if both halves are numbers."""
    if isinstance(linear, Expr) or isinstance(angular, Expr):
        return twist(linear=linear, angular=angular)[:, None]
    return np.concatenate([linear, angular])


def across(a: Expr) -> Expr:
    """Two orthonormal vectors (3, 2) perpendicular to a unit vector.

    Source: T. Duff and others, Building an Orthonormal Basis, Revisited (2017).
    """
    x, y, z = a[0], a[1], a[2]
    sign = Where(z >= 0.0, 1.0, -1.0)
    k = -1.0 / (sign + z)
    one = Concat(1.0 + sign * x * x * k, sign * x * y * k, -sign * x)
    return Stack(one, Concat(x * y * k, sign + y * y * k, -y)).T


def checked_motion(owner: str, value: Any) -> np.ndarray:
    """H (6, k) as numbers. Raises ShapeError for another shape, and ModelError for columns that are not finite and
    independent.
    """
    H = _columns(f"{owner}: motion", value)
    if H.ndim != 2 or H.shape[0] != 6 or H.shape[1] > 6:
        raise ShapeError(f"{owner} expects motion with shape (6, k), k from 0 to 6, got {np.shape(value)}")
    if not np.isfinite(H).all() or (H.size and np.linalg.matrix_rank(H) < H.shape[1]):
        raise ModelError(
            f"{owner} expects motion with finite, independent columns, got\n{H}\n"
            "  fix: pass one column for each degree of freedom, linearly independent"
        )
    return H


def checked_actuation(owner: str, basis: Any, H: np.ndarray) -> np.ndarray:
    """h* (6, k) as numbers. Raises ShapeError for another shape, and ModelError if h*^T H is not the identity."""
    h = _columns(f"{owner}: actuation_basis", basis)
    if h.shape != H.shape:
        raise ShapeError(f"{owner} expects actuation_basis with the shape of motion, {H.shape}, got {h.shape}")
    product = h.T @ H
    if not np.allclose(product, np.eye(H.shape[1]), rtol=0.0, atol=_ROUND_OFF):
        raise ModelError(
            f"{owner}: actuation_basis must satisfy actuation_basis.T @ motion = I; the product is\n"
            f"{product}\n  fix: leave actuation_basis out, or divide it by this product"
        )
    return h


def _columns(place: str, value: Any) -> np.ndarray:
    columns = reals(place, value, ModelError).astype(np.float64)
    return columns[:, None] if columns.ndim == 1 else columns


def direction(owner: str, axis: Any) -> Any:
    """A unit vector (3,): numbers, or an expression whose value, if it is known, is checked."""
    if not isinstance(axis, Expr):
        return unit_vector(owner, "axis", axis)
    a = of_shape(owner, "axis", axis, (3,))
    if isinstance(a, Parameter) and a.value is not None:
        unit_vector(owner, "axis", a.value)
    return a / Norm(a)
