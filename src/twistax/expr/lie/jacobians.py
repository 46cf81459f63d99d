"""Jacobians of the exponential map.

Source: G. Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2 (2012), chapter 10.
"""

from __future__ import annotations

import numpy as np

from ...groups import LINEAR_FIRST, Order
from ..fields import Operand
from ..kinds import lie_rules
from ..node import Shape
from .base import TANGENTS, TWIST, TwistNode, both_orders, expect_one_of, of_group


class _Jacobian(TwistNode):
    tangent: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.EXPONENTIAL
    abstract = True
    cases = (*both_orders(tangent=TWIST), {"tangent": TWIST[3:]}, {"tangent": np.zeros(6)})

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "tangent", shapes[0], TANGENTS)
        return shapes[0] * 2


class LeftJacobian(_Jacobian):
    """J_l with $Exp(xi + d) = Exp(J_l(xi) d) Exp(xi)$ to first order. Shapes: (n,) -> (n, n), n = 3 or 6.

    Attributes:
        tangent: xi, rad and m.
        order: order of a twist.
    Raises: ShapeError for tangent of another shape.
    """

    function = of_group("left_jacobian")


class RightJacobian(_Jacobian):
    """J_r with $Exp(xi + d) = Exp(xi) Exp(J_r(xi) d)$ to first order. Shapes: (n,) -> (n, n), n = 3 or 6.

    Attributes, Raises: as for `LeftJacobian`; ShapeError for a tangent of another shape.
    """

    function = of_group("right_jacobian")


class LeftJacobianInverse(_Jacobian):
    """The inverse of J_l, for angles below a full turn. Shapes: (n,) -> (n, n), n = 3 or 6.

    Attributes, Raises: as for `LeftJacobian`; ShapeError for a tangent of another shape.
    """

    function = of_group("left_jacobian_inv")


class RightJacobianInverse(_Jacobian):
    """The inverse of J_r, for angles below a full turn. Shapes: (n,) -> (n, n), n = 3 or 6.

    With $g = g_n Exp(eta)$ and a body twist Omega: $eta' = J_r(eta)^-1 Omega$.

    Attributes, Raises: as for `LeftJacobian`; ShapeError for a tangent of another shape.
    """

    function = of_group("right_jacobian_inv")
