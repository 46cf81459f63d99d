"""Exponential and logarithm of SO(3) and SE(3).

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2;
J. Sola, J. Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics (2018), appendices.
"""

from __future__ import annotations

import jax
import numpy as np

from ...groups import LINEAR_FIRST, Order, se3, so3
from ..fields import Operand
from ..leaves import State
from ..node import Example, Expr, Shape
from ..shapes import expect
from .base import TwistNode, body_values, twist_state


class SO3Exp(Expr):
    """Exp: rotation vector (3,) in rad -> rotation (3, 3), R = I + sin t / t W + (1 - cos t) / t^2 W^2, t = |w|.

    Attributes:
        omega: the rotation vector.
    Raises:
        ShapeError: omega is not of shape (3,).
    """

    omega: Operand

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "omega", shapes[0], (3,))
        return (3, 3)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return so3.exp(values[0])

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """Exp(Log(R)) is R for a rotation."""
        log = self.omega
        return log.rotation if isinstance(log, SO3Log) and log.rotation.is_group_element else self

    def to_latex(self, *operands: str) -> str:
        return rf"\operatorname{{Exp}}\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        w = State("w", shape=(3,))
        return [Example(cls(w), body_values()), Example(cls(w), {"w": np.zeros(3)})]


class SO3Log(Expr):
    """Log: rotation (3, 3) -> rotation vector (3,) in rad, of length at most pi.

    At exactly a half turn the axis whose first non-zero component is positive is taken; gradients are finite there.

    Attributes:
        rotation: R (3, 3).
    Raises:
        ShapeError: rotation is not of shape (3, 3).
    """

    rotation: Operand

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "rotation", shapes[0], (3, 3))
        return (3,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return so3.log(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\operatorname{{Log}}\left({operands[0]}\right)"

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

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "twist", shapes[0], (6,))
        return (4, 4)

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

    def to_latex(self, *operands: str) -> str:
        return rf"\operatorname{{Exp}}\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(twist_state("a"), order=order), body_values()) + [
            Example(cls(twist_state("a")), {"a": np.zeros(6)})
        ]


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

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "transform", shapes[0], (4, 4))
        return (6,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.log, values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\operatorname{{Log}}\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        values = {"a": np.array([0.3, -0.2, 1.0, 0.4, -1.1, 0.6])}
        return cls.in_both_orders(lambda order: cls(SE3Exp(twist_state("a"), order=order), order=order), values)


__all__ = ["SE3Exp", "SE3Log", "SO3Exp", "SO3Log"]
