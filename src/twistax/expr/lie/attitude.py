"""Attitudes as Euler angles, quaternions and rotation vectors, converted to and from rotations and poses.

`pose`, `euler` and `quaternion` return arrays for numbers, and expressions for expressions.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from ...groups import euler as euler_of_numbers
from ...groups import euler_angles
from ...groups import pose as pose_of_numbers
from ...groups import quaternion as quaternion_of_numbers
from ...groups.euler_angles import ROLL_PITCH_YAW
from ...groups.pose import one_attitude
from ..fields import ExprLike, Operand
from ..kinds import rules
from ..node import Expr, to_expr
from ..operations.array import Stack
from .base import check_element
from .elements import Pose, SO3Exp, parts_of_pose
from .spatial import QDCM, Quaternion


class EulerRotation(Expr):
    """The rotation of three Euler angles in rad, in the order of the sequence. Shapes: (3,) -> (3, 3).

    "xyz" rotates by angles[0] about the fixed x axis, then about the fixed y axis, then z: R = Rz Ry Rx, and the angles
    are roll, pitch, yaw. Capital letters are rotations about body axes: "ZYX" takes yaw, pitch, roll for the same R.

    Attributes:
        angles: (3,), rad.
        sequence: three axes in one case, without an immediate repetition: lower case for fixed axes, upper case for
            body axes; twelve sequences each.
    Raises:
        ShapeError: angles is not of shape (3,).
        InputError: an invalid sequence.
    """

    angles: Operand
    sequence: str = ROLL_PITCH_YAW
    kinds = rules.NUMBERS
    takes, gives = ((3,),), (3, 3)
    cases = ({"angles": [0.4, -1.1, 2.0]}, {"angles": [0.4, 1.1, -2.0], "sequence": "ZXZ"})

    def validate(self) -> None:
        euler_angles.turns(self.sequence)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return euler_angles.rotation(values[0], self.sequence)

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """The rotation of the angles of a rotation is that rotation."""
        inner = self.angles
        if isinstance(inner, EulerAngles) and inner.sequence == self.sequence and inner.rotation.is_group_element:
            return inner.rotation
        return self


class EulerAngles(Expr):
    """The Euler angles in rad, in the order of the sequence, of a rotation. Shapes: (3, 3) -> (3,).

    The middle angle is in [-pi/2, pi/2], or in [0, pi] where the first axis is the last; the others are in [-pi, pi].
    At the limits of the middle angle only the sum or difference of the others is determined: the first about fixed
        axes,
    or the last about body axes, is set to 0 there, and its derivative and that of the middle one are 0.

    Attributes:
        rotation: R (3, 3).
        sequence: as for `EulerRotation`.
    Raises:
        ShapeError: rotation is not of shape (3, 3).
        InputError: an invalid sequence, or a constant that is not a rotation.
    """

    rotation: Operand
    sequence: str = ROLL_PITCH_YAW
    kinds = rules.NUMBERS
    takes, gives = ((3, 3),), (3,)
    # Outside of the group the map is an arbitrary extension, so the examples are group elements, computed by Exp.
    cases = (
        (lambda cls, w: cls(SO3Exp(w)), {"w": [0.4, -1.1, 0.6]}),
        (lambda cls, w: cls(SO3Exp(w), "XYX"), {"w": [0.4, -1.1, 0.6]}),
    )
    kinks = ((lambda cls, a: cls(EulerRotation(a, "zxz"), "zxz"), {"a": [0.4, 0.0, 0.6]}),)

    def validate(self) -> None:
        euler_angles.turns(self.sequence)
        check_element(type(self).__name__, "rotation", self.rotation)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return euler_angles.angles(values[0], self.sequence)


def pose(
    position: ExprLike | None = None,
    rotation: ExprLike | None = None,
    quaternion: ExprLike | None = None,
    euler: ExprLike | None = None,
    rotation_vector: ExprLike | None = None,
    sequence: str = ROLL_PITCH_YAW,
) -> Any:
    """The pose [R p; 0 1] from a position and at most one attitude; the defaults are zero and the identity.

    For numbers, the result is an array of their precision; for an expression, or a list with an expression, it is an
    expression.

    Args:
        position: (3,), m.
        rotation: (3, 3), orthonormal, determinant +1.
        quaternion: (w, x, y, z), not zero; it is normalised.
        euler: three angles in rad, in the order of the sequence: roll, pitch, yaw by default.
        rotation_vector: (3,) in rad, $R = Exp(it)$.
        sequence: axes of `euler`: lower-case letters for fixed axes, "xyz", R = Rz Ry Rx; capital letters for body
            axes, "ZYX" with yaw, pitch, roll.
    Raises:
        ShapeError: an argument of the wrong shape.
        InputError: more than one attitude; an invalid sequence; a value with a wrong unit; numbers that are not finite,
            a zero quaternion, or a matrix that is not a rotation. For traced or computed values of this kind the pose
            is NaN.
    """
    attitudes = {"rotation": rotation, "quaternion": quaternion, "euler": euler, "rotation_vector": rotation_vector}
    of_numbers: Any = pose_of_numbers
    everything = {"position": position} | attitudes
    numbers = {name: v for name, v in everything.items() if v is not None and not _symbolic(v)}
    if not any(map(_symbolic, everything.values())):
        return of_numbers(**numbers, sequence=sequence)
    of_numbers(**numbers, sequence=sequence)  # for its checks
    attitude = {name: _joined(value) for name, value in attitudes.items() if value is not None}
    one_attitude(attitude)
    nodes: dict[str, Any] = {"rotation": to_expr, "quaternion": QDCM, "rotation_vector": SO3Exp}
    nodes["euler"] = lambda angles: EulerRotation(angles, sequence)
    R = next((nodes[name](expr) for name, expr in attitude.items()), np.eye(3))
    return Pose(R, np.zeros(3) if position is None else _joined(position))


def euler(R: ExprLike, sequence: str = ROLL_PITCH_YAW) -> Any:
    """The Euler angles (3,) in rad of a rotation (3, 3) or a pose (4, 4), from numbers or an expression; see
    `EulerAngles`.

    The default sequence is (roll, pitch, yaw): R = Rz(yaw) Ry(pitch) Rx(roll), with roll = 0 at gimbal lock.

    Raises:
        ShapeError: an argument of another shape.
        InputError: an invalid sequence, or numbers that are not a rotation.
    """
    return EulerAngles(_rotation_of(R), sequence) if isinstance(R, Expr) else euler_of_numbers(R, sequence)


def quaternion(R: ExprLike) -> Any:
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation (3, 3) or a pose (4, 4), from numbers or an expression.

    At exactly a half turn its first non-zero component is positive.

    Raises:
        ShapeError: an argument of another shape.
        InputError: numbers that are not a rotation.
    """
    return Quaternion(_rotation_of(R)) if isinstance(R, Expr) else quaternion_of_numbers(R)


def _rotation_of(R: Expr) -> Expr:
    return parts_of_pose(R)[0] if R.check_shape() == (4, 4) else R


def _symbolic(value: Any) -> bool:
    return isinstance(value, Expr) or (isinstance(value, (list, tuple)) and any(map(_symbolic, value)))


def _joined(value: Any) -> Expr:
    """An expression from an expression, from numbers, or from a list of both."""
    if not isinstance(value, Expr) and _symbolic(value):
        return Stack(*map(_joined, value))
    return to_expr(value)


def translation(position: ExprLike) -> Expr:
    """The pose [I p; 0 1] of a frame at position p (3,), in m, without rotation; from an expression or numbers.

    Products with its Ad and Ad*, and with those of its inverse, take the six multiplications of one cross product.
    Raises ShapeError if p is not of shape (3,).
    """
    return Pose(np.eye(3), position)


def rotation(rotation: ExprLike) -> Expr:
    """The pose [R 0; 0 1] of a frame that is rotated about the common origin, by a `rotation` R (3, 3) that is an
    expression or numbers.

    Its Ad and Ad*, and those of its inverse, rotate both halves of a six-vector. Raises ShapeError if R is not of shape
    (3, 3).
    """
    return Pose(rotation, np.zeros(3))
