"""Left and right Jacobians of SO(3) and SE(3), and their inverses. The shape of the tangent says which group.

Source: G. Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2 (2012), chapter 10.
"""

from __future__ import annotations

from typing import ClassVar

import jax
import numpy as np

from ...groups import LINEAR_FIRST, Order
from ..fields import Operand
from ..leaves import State
from ..node import Example, Shape
from .base import OF_TANGENT, TwistNode, body_values, expect_one_of, twist_state


class _Jacobian(TwistNode):
    """What the four Jacobians share."""

    tangent: Operand
    order: Order = LINEAR_FIRST
    abstract = True
    function: ClassVar[str] = ""

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "tangent", shapes[0], OF_TANGENT)
        return shapes[0] * 2

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(getattr(OF_TANGENT[values[0].shape], self.function), values[0])

    @classmethod
    def example(cls) -> list[Example]:
        w, zero = State("w", shape=(3,)), {"a": np.zeros(6)}
        both = cls.in_both_orders(lambda order: cls(twist_state("a"), order=order), body_values())
        return [*both, Example(cls(w), body_values()), Example(cls(twist_state("a")), zero)]


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


__all__ = ["LeftJacobian", "LeftJacobianInverse", "RightJacobian", "RightJacobianInverse"]
