"""Exponential and logarithm of SO(3) and SE(3), their Jacobians, and the rotation about a fixed axis.

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2;
J. Sola, J. Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics (2018), appendices;
G. Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2 (2012), chapter 10, for the Jacobians.
"""

from __future__ import annotations

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError, ShapeError
from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order, se3, so3
from ..fields import Operand
from ..leaves import State
from ..node import Example, Expr, Shape
from ..printing import number_latex
from ..shapes import expect
from .base import OF_TANGENT, TWIST, TwistNode, both_orders, expect_one_of


class SO3Exp(Expr):
    """Exp: rotation vector (3,) in rad -> rotation (3, 3), R = I + sin t / t W + (1 - cos t) / t^2 W^2, t = |w|.

    Attributes:
        omega: the rotation vector.
    Raises:
        ShapeError: omega is not of shape (3,).
    """

    omega: Operand
    takes = ((3,),)
    gives = (3, 3)
    latex_name = r"\operatorname{Exp}"
    cases = ({"omega": TWIST[3:]}, {"omega": np.zeros(3)})

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return so3.exp(values[0])

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """Exp(Log(R)) is R for a rotation."""
        log = self.omega
        return log.rotation if isinstance(log, SO3Log) and log.rotation.is_group_element else self


class SO3Log(Expr):
    """Log: rotation (3, 3) -> rotation vector (3,) in rad, of length at most pi.

    At exactly a half turn the axis whose first non-zero component is positive is taken; gradients are finite there.

    Attributes:
        rotation: R (3, 3).
    Raises:
        ShapeError: rotation is not of shape (3, 3).
    """

    rotation: Operand
    takes = ((3, 3),)
    gives = (3,)
    latex_name = r"\operatorname{Log}"

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return so3.log(values[0])

    @classmethod
    def example(cls) -> list[Example]:
        # Off the group the map is an extension nobody differentiates: the case goes through Exp.
        return [Example(cls(SO3Exp(State("w", shape=(3,)))), {"w": np.array([0.4, -1.1, 0.6])})]


class SE3Exp(TwistNode):
    """Exp: twist (6,) -> pose (4, 4), [Exp(w) V(w) v; 0 1] with V the left Jacobian of SO(3).

    Attributes:
        twist: (6,), m and rad.
        order: its order.
    Raises:
        ShapeError: twist is not of shape (6,).
    """

    twist: Operand
    order: Order = LINEAR_FIRST
    takes = ((6,),)
    gives = (4, 4)
    latex_name = r"\operatorname{Exp}"
    cases = (*both_orders(twist=TWIST), {"twist": np.zeros(6)})

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.exp, values[0])

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """Exp(Log(T)) is T for a pose, if both have one order."""
        log = self.twist
        if isinstance(log, SE3Log) and log.order == self.order and log.transform.is_group_element:
            return log.transform
        return self


class SE3Log(TwistNode):
    """Log: pose (4, 4) -> twist (6,), rotation angle at most pi; [V(w)^-1 p; w] with w = Log(R).

    At exactly a half turn the axis whose first non-zero component is positive is taken; gradients are finite there.
    Log(Exp(xi)) is xi only within a half turn, so no rewrite removes it.

    Attributes:
        transform: T (4, 4).
        order: order of the result.
    Raises:
        ShapeError: transform is not of shape (4, 4).
    """

    transform: Operand
    order: Order = LINEAR_FIRST
    takes = ((4, 4),)
    gives = (6,)
    latex_name = r"\operatorname{Log}"

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.log, values[0])

    @classmethod
    def example(cls) -> list[Example]:
        a, values = State("a", shape=(6,)), {"a": np.array([0.3, -0.2, 1.0, 0.4, -1.1, 0.6])}
        return [Example(cls(SE3Exp(a, order), order), values) for order in (LINEAR_FIRST, ANGULAR_FIRST)]


class _Jacobian(TwistNode):
    """What the four Jacobians share."""

    tangent: Operand
    order: Order = LINEAR_FIRST
    abstract = True
    cases = (*both_orders(tangent=TWIST), {"tangent": TWIST[3:]}, {"tangent": np.zeros(6)})
    function: ClassVar[str] = ""

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "tangent", shapes[0], OF_TANGENT)
        return shapes[0] * 2

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(getattr(OF_TANGENT[values[0].shape], self.function), values[0])


class LeftJacobian(_Jacobian):
    """J_l with Exp(xi + d) = Exp(J_l(xi) d) Exp(xi) to first order. Shapes: (n,) -> (n, n), n = 3 or 6.

    Attributes:
        tangent: xi, rad and m.
        order: order of a twist.
    Raises:
        ShapeError: tangent of another shape.
    """

    function = "left_jacobian"


class RightJacobian(_Jacobian):
    """J_r with Exp(xi + d) = Exp(xi) Exp(J_r(xi) d) to first order. Shapes: (n,) -> (n, n), n = 3 or 6.

    Attributes:
        tangent: xi, rad and m.
        order: order of a twist.
    Raises:
        ShapeError: tangent of another shape.
    """

    function = "right_jacobian"


class LeftJacobianInverse(_Jacobian):
    """The inverse of J_l, for angles below a full turn. Shapes: (n,) -> (n, n), n = 3 or 6.

    Attributes:
        tangent: xi, rad and m.
        order: order of a twist.
    Raises:
        ShapeError: tangent of another shape.
    """

    function = "left_jacobian_inv"


class RightJacobianInverse(_Jacobian):
    """The inverse of J_r, for angles below a full turn. Shapes: (n,) -> (n, n), n = 3 or 6.

    With g = g_n Exp(eta) and a body twist Omega: eta' = J_r(eta)^-1 Omega.

    Attributes:
        tangent: xi, rad and m.
        order: order of a twist.
    Raises:
        ShapeError: tangent of another shape.
    """

    function = "right_jacobian_inv"


class AxisRotation(Expr):
    """R = a a^T + sin q [a]x + cos q (I - a a^T): the turn by q about a fixed unit axis a. Shapes: () -> (3, 3).

    The same as SO3Exp(q a) for one sine and one cosine (Rodrigues).

    Attributes:
        angle: q in rad.
        axis: three numbers, not all zero; it is normalised.
    Raises:
        ShapeError: angle is no scalar, or axis has not three entries.
        ModelError: axis is zero, not finite or no numbers.
    """

    angle: Operand
    axis: Any
    cases = ({"angle": 0.7, "axis": (1.0, -2.0, 2.0)}, {"angle": 0.0, "axis": (0.0, 0.0, 1.0)})

    def validate(self) -> None:
        self.axis = tuple(unit_vector("AxisRotation", "axis", self.axis).tolist())

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "angle", shapes[0], (), "take the entry of a vector: angle[0]" if shapes[0] == (1,) else None)
        return (3, 3)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        (q,) = values
        x, y, z = self.axis
        along = np.outer(self.axis, self.axis)
        turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        constant, sine, cosine = (jnp.asarray(part, q.dtype) for part in (along, turn, np.eye(3) - along))
        return constant + jnp.sin(q) * sine + jnp.cos(q) * cosine

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def to_latex(self, *operands: str) -> str:
        axis = ", ".join(number_latex(entry, 4) for entry in self.axis)
        return rf"\operatorname{{Rot}}_{{({axis})}}\left({operands[0]}\right)"


def unit_vector(owner: str, name: str, value: Any) -> np.ndarray:
    """A direction (3,) as a unit vector.

    Raises:
        ShapeError: it has not three entries.
        ModelError: it is zero, not finite or no numbers.
    """
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"{owner} expects {name} to be three numbers, got {value!r}") from None
    if vector.shape != (3,):
        raise ShapeError(f"{owner} expects {name} with shape (3,), got {vector.shape}")
    largest = np.max(np.abs(vector))
    if not np.isfinite(largest) or largest == 0.0:
        raise ModelError(
            f"{owner} expects {name} to be a direction, got {vector.tolist()}.\n"
            "  fix: give three finite numbers, not all zero; the length does not matter"
        )
    # Scaled first: the squares of very large or very small entries leave the range. Adding 0 turns -0 into 0.
    vector = vector / largest
    return vector / np.linalg.norm(vector) + 0.0
