"""Linear and angular parts of six-vectors, and the change from one order to the other."""

from __future__ import annotations

import jax

from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order
from ..fields import ExprLike, Operand
from ..leaves import State
from ..node import Example, Expr, Shape
from ..shapes import expect
from .base import TwistNode, body_values, twist_state


class LinearPart(TwistNode):
    """v of [v; w], or f of [f; tau]. Shapes: (6,) -> (3,).

    Attributes:
        vector: a twist, wrench or momentum (6,).
        order: its order.
    Raises:
        ShapeError: vector is not of shape (6,).
    """

    vector: Operand
    order: Order = LINEAR_FIRST
    label = "linear"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "vector", shapes[0], (6,))
        return (3,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.order.split(values[0])[0]

    def simplify(self) -> Expr:
        """The linear part of joined parts is the part."""
        joined = self.vector
        return joined.linear if isinstance(joined, JoinedParts) and joined.order == self.order else self

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(twist_state("a"), order=order), body_values())


class AngularPart(TwistNode):
    """w of [v; w], or tau of [f; tau]. Shapes: (6,) -> (3,).

    Attributes:
        vector: a twist, wrench or momentum (6,).
        order: its order.
    Raises:
        ShapeError: vector is not of shape (6,).
    """

    vector: Operand
    order: Order = LINEAR_FIRST
    label = "angular"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "vector", shapes[0], (6,))
        return (3,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.order.split(values[0])[1]

    def simplify(self) -> Expr:
        """The angular part of joined parts is the part."""
        joined = self.vector
        return joined.angular if isinstance(joined, JoinedParts) and joined.order == self.order else self

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(twist_state("a"), order=order), body_values())


class JoinedParts(TwistNode):
    """The six-vector of a linear and an angular part. Shapes: (3,), (3,) -> (6,). Made by `twist` and `wrench`.

    Attributes:
        linear, angular: (3,) each.
        order: order of the result.
    Raises:
        ShapeError: a part is not of shape (3,).
    """

    linear: Operand
    angular: Operand
    order: Order = LINEAR_FIRST
    label = "join"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "linear", shapes[0], (3,))
        expect(self, "angular", shapes[1], (3,))
        return (6,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.order.join(*values)

    def to_latex(self, *operands: str) -> str:
        parts = operands if self.order == LINEAR_FIRST else operands[::-1]
        return rf"\begin{{bmatrix}} {parts[0]} \\ {parts[1]} \end{{bmatrix}}"

    @classmethod
    def example(cls) -> list[Example]:
        v, w = State("v", shape=(3,)), State("w", shape=(3,))
        return cls.in_both_orders(lambda order: cls(v, w, order=order), body_values())


class Reorder(TwistNode):
    """The same twist, wrench or 6x6 operator in the other order. Shapes: (6,) -> (6,) or (6, 6) -> (6, 6).

    Attributes:
        value: in the other order.
        order: order of the result.
    Raises:
        ShapeError: value is neither (6,) nor (6, 6).
    """

    value: Operand
    order: Order = LINEAR_FIRST
    label = "reorder"

    def infer_shape(self, *shapes: Shape) -> Shape:
        if shapes[0] != (6, 6):
            expect(self, "value", shapes[0], (6,), "a vector (6,) or an operator (6, 6)")
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        # Swapping the halves is its own inverse, whichever way it goes.
        return ANGULAR_FIRST.from_linear_first(values[0])

    def simplify(self) -> Expr:
        """Twice is nothing."""
        return self.value.value if isinstance(self.value, Reorder) else self

    def twist_orders(self) -> tuple[list[Order | None], Order | None]:
        return [_other(self.order)], self.order

    @classmethod
    def example(cls) -> list[Example]:
        return [
            *cls.in_both_orders(lambda order: cls(twist_state("a"), order=order), body_values()),
            Example(cls(State("M", shape=(6, 6))), {"M": body_values()["a"][:, None] * body_values()["b"]}),
        ]


def _other(order: Order) -> Order:
    return Order(linear_leads=not order.linear_leads)


def linear(vector: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The linear part (3,) of a twist, wrench or momentum (6,)."""
    return LinearPart(vector, order=order)


def angular(vector: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The angular part (3,) of a twist, wrench or momentum (6,)."""
    return AngularPart(vector, order=order)


def twist(*, linear: ExprLike, angular: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The twist (6,) of a velocity (3,) in m/s and a rate (3,) in rad/s, both in the body frame."""
    return JoinedParts(linear, angular, order=order)


def wrench(*, force: ExprLike, torque: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The wrench (6,) of a force (3,) in N and a torque (3,) in N m, both in the body frame."""
    return JoinedParts(force, torque, order=order)


__all__ = ["AngularPart", "JoinedParts", "LinearPart", "Reorder", "angular", "linear", "twist", "wrench"]
