"""Attitude: quaternions (w, x, y, z) and the matrices of rigid-body kinematics."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ...groups import quaternion_product, rotation_from_quaternion, so3
from ...groups.arrays import matrix, unpack
from ...groups.quaternions import from_rotation
from ..fields import Operand
from ..kinds import lie_rules
from ..node import Expr
from .base import check_element

_HINT = "a quaternion is w, x, y, z"


class QDCM(Expr):
    """Rotation matrix R(q) of a quaternion q = (w, x, y, z), scalar first. Shapes: (4,) -> (3, 3).

    q is normalised, so its length need not be 1. $R(q) v = q v q^-1$, so that for the attitude of a body
    R maps body coordinates to world coordinates. A zero quaternion gives NaN.

    Raises: ShapeError if q is not of shape (4,).
    """

    q: Operand
    kinds = lie_rules.SAME_ROTATION
    takes, gives, takes_hint = ((4,),), (3, 3), _HINT
    function = rotation_from_quaternion
    latex_name = "R"
    cases = ({"q": [0.9, -0.2, 0.4, 0.3]},)

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """The rotation of the quaternion of a rotation is that rotation."""
        inner = self.q
        return inner.rotation if isinstance(inner, Quaternion) and inner.rotation.is_group_element else self


class SSM(Expr):
    """The skew-symmetric matrix $[w]x$ with $[w]x v = w x v$. Shapes: (3,) -> (3, 3). Its unit is that of w.

    $[w]x = [0, -w_z, w_y; w_z, 0, -w_x; -w_y, w_x, 0]$

    Raises: ShapeError if w is not of shape (3,).
    """

    w: Operand
    kinds = lie_rules.SKEW
    takes, gives = ((3,),), (3, 3)
    function = so3.hat
    formula = r"\left[<0>\right]_\times"
    cases = ({"w": [1.0, -2.0, 0.5]},)


class SSMP(Expr):
    """The matrix of quaternion kinematics, $q' = SSMP(w) q / 2$ with q = (w, x, y, z), scalar first.

    Shapes: (3,) -> (4, 4). w is the body angular velocity in rad/s; $SSMP(w) q = q (0, w)$, the Hamilton product.

    $SSMP(w) = [0, -w_x, -w_y, -w_z; w_x, 0, w_z, -w_y; w_y, -w_z, 0, w_x; w_z, w_y, -w_x, 0]$

    Raises: ShapeError if w is not of shape (3,).
    """

    w: Operand
    kinds = lie_rules.OF_QUATERNIONS
    takes, gives = ((3,),), (4, 4)
    latex_name = r"\Omega"
    cases = ({"w": [1.0, -2.0, 0.5]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        x, y, z = unpack(values[0])
        o = jnp.zeros_like(x)
        return matrix([[o, -x, -y, -z], [x, o, z, -y], [y, -z, o, x], [z, y, -x, o]])


class QuaternionProduct(Expr):
    """Hamilton product p q of quaternions (w, x, y, z). Shapes: (4,), (4,) -> (4,). $R(p q) = R(p) R(q)$.

    Raises: ShapeError if an operand is not of shape (4,).
    """

    p: Operand
    q: Operand
    kinds = lie_rules.COMPOSE
    takes, gives, takes_hint = ((4,), (4,)), (4,), _HINT
    function = quaternion_product
    formula = r"<0> \otimes <1>"
    precedence = 20
    cases = ({"p": [0.9, -0.2, 0.4, 0.3], "q": [0.1, 1.0, -0.5, 2.0]},)


class Quaternion(Expr):
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation. Shapes: (3, 3) -> (4,).

    At exactly a half turn its first non-zero component is positive. `QDCM` is the inverse.

    Attributes:
        rotation: R (3, 3).
    Raises:
        ShapeError: rotation is not of shape (3, 3).
        InputError: a constant that is not a rotation.
    Sources: S. Shepperd, Quaternion from rotation matrix (1978); B. Horn, Closed-form solution of absolute orientation
    using unit quaternions (1987).
    """

    rotation: Operand
    kinds = lie_rules.SAME_ROTATION
    takes, gives = ((3, 3),), (4,)
    function = from_rotation
    cases = ((lambda cls, w: cls(QDCM(w)), {"w": [0.9, -0.2, 0.4, 0.3]}),)

    def validate(self) -> None:
        check_element(type(self).__name__, "rotation", self.rotation)
