"""Linear and angular parts of six-vectors, and the change from one order to the other."""

from __future__ import annotations

from typing import ClassVar

import jax
import numpy as np

from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order
from ..arithmetic import is_constant
from ..canonical import fold
from ..fields import ExprLike, Operand
from ..node import Expr, Shape
from ..shapes import expect
from .base import COLUMNS, OTHER_TWIST, TWIST, ColumnsNode, TwistNode, both_orders, expect_columns


class _Part(ColumnsNode):
    """What both parts share."""

    vector: Operand
    order: Order = LINEAR_FIRST
    abstract = True
    cases = (*both_orders(vector=TWIST), {"vector": COLUMNS})
    #: Which operand of JoinedParts it is.
    place: ClassVar[int] = 0

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_columns(self, "vector", shapes[0], 6)
        return (3, *shapes[0][1:])

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.order.split(values[0])[self.place]

    def simplify(self) -> Expr:
        """A part of joined parts is the part."""
        joined = self.vector
        if isinstance(joined, JoinedParts) and joined.order == self.order:
            return joined.children()[self.place]
        return self


class LinearPart(_Part):
    """v of [v; w], or f of [f; tau]. Shapes: (6,) -> (3,); (6, k) -> (3, k).

    Attributes:
        vector: a twist, wrench or momentum (6,), or k of them as columns.
        order: its order.
    Raises:
        ShapeError: vector has no six rows.
    """

    label = "linear"


class AngularPart(_Part):
    """w of [v; w], or tau of [f; tau]. Shapes: (6,) -> (3,); (6, k) -> (3, k).

    Attributes:
        vector: a twist, wrench or momentum (6,), or k of them as columns.
        order: its order.
    Raises:
        ShapeError: vector has no six rows.
    """

    label = "angular"
    place = 1


class JoinedParts(ColumnsNode):
    """The six-vector of a linear and an angular part. Shapes: (3,), (3,) -> (6,); (3, k), (3, k) -> (6, k).

    Made by `twist` and `wrench`.

    Attributes:
        linear, angular: (3,) each, or k columns each.
        order: order of the result.
    Raises:
        ShapeError: a part has no three rows, or the parts differ in shape.
    """

    linear: Operand
    angular: Operand
    order: Order = LINEAR_FIRST
    label = "join"
    cases = (*both_orders(linear=TWIST[:3], angular=TWIST[3:]), {"linear": COLUMNS[:3], "angular": COLUMNS[3:]})

    def infer_shape(self, *shapes: Shape) -> Shape:
        linear, angular = shapes
        expect_columns(self, "linear", linear, 3)
        expect(self, "angular", angular, linear)
        return (6, *linear[1:])

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.order.join(*values)

    def to_latex(self, *operands: str) -> str:
        parts = operands if self.order == LINEAR_FIRST else operands[::-1]
        return rf"\begin{{bmatrix}} {parts[0]} \\ {parts[1]} \end{{bmatrix}}"


def halves(vector: Expr, order: Order) -> tuple[Expr, Expr]:
    """The linear and the angular part of a canonical six-vector or of columns, as far as they are known."""
    linear, angular = (fold(part(vector, order=order).simplify()) for part in (LinearPart, AngularPart))
    return linear, angular


def has_zero_half(vector: Expr, order: Order) -> bool:
    """Whether one part is known to be zero."""
    return any(is_constant(half, 0.0) for half in halves(vector, order))


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
    cases = (*both_orders(value=TWIST), {"value": np.outer(TWIST, OTHER_TWIST)})

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
        return [Order(linear_leads=not self.order.linear_leads)], self.order


def linear(vector: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The linear part (3,) of a twist, wrench or momentum (6,); of k columns (6, k), (3, k)."""
    return LinearPart(vector, order=order)


def angular(vector: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The angular part (3,) of a twist, wrench or momentum (6,); of k columns (6, k), (3, k)."""
    return AngularPart(vector, order=order)


def twist(*, linear: ExprLike, angular: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The twist (6,) of a velocity (3,) in m/s and a rate (3,) in rad/s, both in the body frame."""
    return JoinedParts(linear, angular, order=order)


def wrench(*, force: ExprLike, torque: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The wrench (6,) of a force (3,) in N and a torque (3,) in N m, both in the body frame."""
    return JoinedParts(force, torque, order=order)
