"""Twists and wrenches moved from frame to frame without a 6x6 matrix, and at no more cost than what is known allows.

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2;
the products are grouped as in R. Featherstone, Rigid Body Dynamics Algorithms (2008), appendix A.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

import jax

from ...groups import LINEAR_FIRST, Order
from ...groups.arrays import multiply
from ..arithmetic import MatMul, is_constant, is_identity
from ..fields import Operand
from ..linalg import Cross, cross_columns
from ..node import Expr, Shape
from ..printing import wrap_latex
from ..shapes import expect
from .base import COLUMNS, POSE, TWIST, ColumnsNode, both_orders, expect_columns
from .parts import JoinedParts, halves, has_zero_half
from .transforms import Act, Inverse, parts_of_pose

Value = TypeVar("Value", jax.Array, Expr)


class _Action(ColumnsNode):
    """What both actions share. One half of the six-vector is only turned, to the other the moment of it is added."""

    transform: Operand
    order = LINEAR_FIRST
    inverse = False
    abstract = True
    precedence = 20
    #: The operator in formulas.
    symbol: ClassVar[str] = ""

    @staticmethod
    def roles(linear: Any, angular: Any) -> tuple[Any, Any]:
        """(half that gets the moment, half that is only turned); the same exchange leads back."""
        return linear, angular

    def validate(self) -> None:
        super().validate()
        if not isinstance(self.inverse, bool):
            raise TypeError(f"{type(self).__name__} expects inverse=True or inverse=False, got {self.inverse!r}")

    def infer_shape(self, *shapes: Shape) -> Shape:
        transform, vector = self.child_names()
        expect(self, transform, shapes[0], (4, 4))
        expect_columns(self, vector, shapes[1], 6)
        return shapes[1]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        T, vector = values
        R, p = T[:3, :3], T[:3, 3]
        turn = R.T if self.inverse else R
        changed = self._changed(
            *self.roles(*self.order.split(vector)), lambda x: multiply(turn, x), lambda x: cross_columns(p, x)
        )
        return self.order.join(*self.roles(*changed))

    def _changed(
        self, moved: Value, turned: Value, turn: Callable[[Value], Value], moment: Callable[[Value], Value]
    ) -> tuple[Value, Value]:
        """Both halves in the other frame: R m + p x R t and R t; the inverse is R' (m - p x t) and R' t."""
        if self.inverse:
            return turn(moved - moment(turned)), turn(turned)
        turned = turn(turned)
        return turn(moved) + moment(turned), turned

    def simplify(self) -> Expr:
        """What does nothing vanishes; an inverse is not formed; known parts are left out of the formula."""
        T, vector = self.children()
        if is_identity(T) or is_constant(vector, 0.0):
            return vector
        if isinstance(T, Inverse) and T.element.is_group_element:
            return self.replace(transform=T.element, inverse=not self.inverse)
        if isinstance(vector, type(self)) and self._undoes(vector):
            return vector.children()[1]
        R, p = parts_of_pose(T)
        if is_identity(R) or is_constant(p, 0.0) or has_zero_half(vector, self.order):
            return self._unrolled(R, p)
        return self

    def _undoes(self, other: _Action) -> bool:
        opposite = self.order == other.order and self.inverse != other.inverse
        return opposite and self.transform.is_group_element and self.transform.key() == other.transform.key()

    def _unrolled(self, R: Expr, p: Expr) -> Expr:
        turn = Inverse(R) if self.inverse else R
        linear, angular = halves(self.children()[1], self.order)
        changed = self._changed(
            *self.roles(linear, angular),
            lambda x: Act(turn, x) if x.ndim == 1 else MatMul(turn, x),
            lambda x: Cross(p, x),
        )
        return JoinedParts(*self.roles(*changed), order=self.order)

    def applied_to(self, vector: Expr) -> Expr | None:
        """(Ad_T H) q is Ad_T (H q)."""
        transform, columns = self.children()
        return self.with_children([transform, MatMul(columns, vector)]) if vector.ndim == 1 else None

    def to_latex(self, *operands: str) -> str:
        transform = Inverse(self.transform).to_latex(operands[0]) if self.inverse else operands[0]
        return rf"{self.symbol}_{{{transform}}} \, {wrap_latex(self.children()[1], operands[1], 20)}"


def _cases(vector: str) -> list[dict[str, Any]]:
    one, columns = {"transform": POSE, vector: TWIST}, {"transform": POSE, vector: COLUMNS}
    back = {"inverse": True}
    return [*both_orders(**one), *both_orders(**(one | back)), columns, columns | back]


class AdjointAction(_Action):
    """Ad_T xi without the matrix: [R v + p x R w; R w]. Shapes: (4, 4), (6,) -> (6,); (4, 4), (6, k) -> (6, k).

    `canonicalize` makes it of `SE3Adjoint(T) @ xi`. Written with inverse=True it is Ad_(T^-1) xi =
    [R'(v - p x w); R' w], which needs no T^-1.

    Attributes:
        transform: T_ab (4, 4), a pose.
        twist: in frame b (with inverse=True in frame a), (6,), or k of them as columns.
        order: order of the twist and the result.
        inverse: whether T^-1 acts.
    Raises:
        ShapeError: an operand of another shape.
    """

    twist: Operand
    order: Order = LINEAR_FIRST
    inverse: bool = False
    label = "Ad"
    cases = _cases("twist")
    symbol = r"\mathrm{Ad}"


class CoadjointAction(_Action):
    """Ad*_T F without the matrix: [R f; R tau + p x R f]. Shapes: (4, 4), (6,) -> (6,); (4, 4), (6, k) -> (6, k).

    `canonicalize` makes it of `SE3AdjointDual(T) @ F`. Written with inverse=True it is Ad*_(T^-1) F =
    [R' f; R'(tau - p x f)], which needs no T^-1.

    Attributes:
        transform: T_ab (4, 4), a pose.
        wrench: in frame b (with inverse=True in frame a), (6,), or k of them as columns.
        order: order of the wrench and the result.
        inverse: whether T^-1 acts.
    Raises:
        ShapeError: an operand of another shape.
    """

    wrench: Operand
    order: Order = LINEAR_FIRST
    inverse: bool = False
    label = "Ad_dual"
    cases = _cases("wrench")
    symbol = r"\mathrm{Ad}^*"

    @staticmethod
    def roles(linear: Any, angular: Any) -> tuple[Any, Any]:
        return angular, linear
