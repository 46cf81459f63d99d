"""Adjoint and coadjoint operators: their action on twists and wrenches, and changes of frame, as matrices or
matrix-free.

Conventions: twist xi = [v; w], wrench F = [f; tau], momentum mu = [p; L], all in the body frame; T_ab maps coordinates
of frame b to frame a, p_a = T_ab p_b. With order=ANGULAR_FIRST the operands and results of the same operators are [w;
v].

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2;
R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2, for [w; v], and appendix A for the products.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

import jax

from ...errors import OperationError
from ...groups import LINEAR_FIRST, Order, se3, so3
from ...groups.arrays import multiply
from ..fields import Operand
from ..kinds import lie_rules
from ..matrices.linalg import Cross, cross_columns
from ..node import Expr, Shape, expect
from ..operations.arithmetic import Add, MatMul, is_constant, is_identity, zeros_of
from ..printing.text import wrap_latex
from .base import (
    COLUMNS,
    OTHER_TWIST,
    POSE,
    ROTATION,
    TWIST,
    ColumnsNode,
    JoinedParts,
    TwistNode,
    both_orders,
    check_element,
    expect_columns,
    halves,
    has_zero_half,
)
from .elements import Act, Inverse, parts_of_pose

Value = TypeVar("Value", jax.Array, Expr)


class Adjoint(TwistNode):
    """The Lie bracket of two twists, $ad_xi1(xi2) = [xi1, xi2] = [w1 x v2 - w2 x v1; w1 x w2]$.

    As a matrix for [v; w]: $ad_xi = [[w], [v]; 0, [w]]$. Shapes: (6,), (6,) -> (6,).

    Attributes:
        twist1, twist2: twists (6,), m/s and rad/s.
        order: order of both and of the result.
    Raises: ShapeError if an operand is not of shape (6,).
    """

    twist1: Operand
    twist2: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.BRACKET
    label = "ad"
    takes, gives = ((6,), (6,)), (6,)
    function = se3.bracket
    formula = r"\mathrm{ad}_{<0>}\left(<1>\right)"
    cases = both_orders(twist1=TWIST, twist2=OTHER_TWIST)

    def simplify(self) -> Expr:
        """[xi, xi] is 0, and so is the bracket with 0; for an operand with a zero half, only the other products
        remain.
        """
        one, other = self.twist1, self.twist2
        if is_constant(one, 0.0) or is_constant(other, 0.0) or one.key() == other.key():
            return zeros_of(self)
        if not (has_zero_half(one, self.order) or has_zero_half(other, self.order)):
            return self
        (v1, w1), (v2, w2) = halves(one, self.order), halves(other, self.order)
        return JoinedParts(Add(Cross(w1, v2), Cross(v1, w2)), Cross(w1, w2), order=self.order)


class AdjointDual(TwistNode):
    """The coadjoint action on momentum or wrench, $ad*_xi(mu) = -ad_xi^T mu = [w x p; v x p + w x L]$.

    Newton-Euler for a body: $M xi' = F - ad*_xi(M xi)$. Shapes: (6,), (6,) -> (6,).

    Attributes:
        twist: (6,), m/s and rad/s.
        momentum: (6,), N s and N m s (or a wrench, N and N m).
        order: order of both and of the result.
    Raises: ShapeError if an operand is not of shape (6,).
    """

    twist: Operand
    momentum: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.DUAL_BRACKET
    label = "ad_dual"
    takes, gives = ((6,), (6,)), (6,)
    function = se3.coad
    formula = r"\mathrm{ad}^*_{<0>}\left(<1>\right)"
    cases = both_orders(twist=TWIST, momentum=OTHER_TWIST)

    def simplify(self) -> Expr:
        """The term of a body at rest, or without momentum, is zero; for an operand with a zero half, only the other
        products remain.
        """
        if is_constant(self.twist, 0.0) or is_constant(self.momentum, 0.0):
            return zeros_of(self)
        if not (has_zero_half(self.twist, self.order) or has_zero_half(self.momentum, self.order)):
            return self
        (v, w), (p, L) = halves(self.twist, self.order), halves(self.momentum, self.order)
        return JoinedParts(Cross(w, p), Add(Cross(v, p), Cross(w, L)), order=self.order)


class _FrameMatrix(TwistNode):
    """Base of Ad_T and Ad*_T: each is the other's inverse transpose."""

    transform: Operand
    order: Order = LINEAR_FIRST
    abstract = True
    structured = True
    takes, gives = ((4, 4),), (6, 6)
    cases = both_orders(transform=POSE)

    def _of_inverse(self, node: type[Expr]) -> Expr | None:
        known = self.transform.is_group_element
        return node(Inverse(self.transform), order=self.order) if known else None

    def inverted(self) -> Expr | None:
        """The same of the inverse pose."""
        return self._of_inverse(type(self))


class SE3Adjoint(_FrameMatrix):
    """Ad_T, the 6x6 matrix that maps twists of frame b to frame a: $xi_a = Ad_T xi_b$, $hat(Ad_T xi) = T hat(xi) T^-1$.

    For [v; w]: $Ad_T = [R, [p]R; 0, R]$. Shapes: (4, 4) -> (6, 6). A product with a vector or with columns is computed
    without the matrix.

    Attributes:
        transform: T_ab (4, 4).
        order: order of the twists.
    Raises: ShapeError if transform is not of shape (4, 4).
    """

    kinds = lie_rules.TWISTS_CHANGE_FRAME
    label = "Ad"
    function = se3.Ad
    formula = r"\mathrm{Ad}_{<0>}"

    def applied_to(self, vector: Expr) -> Expr | None:
        return AdjointAction(self.transform, vector, order=self.order)

    def transposed(self) -> Expr | None:
        """Ad_T' = Ad*_(T^-1)."""
        return self._of_inverse(SE3AdjointDual)


class SE3AdjointDual(_FrameMatrix):
    """$Ad*_T = Ad_T^(-T)$, the 6x6 matrix that maps wrenches and momenta of frame b to frame a: $F_a = Ad*_T F_b$.

    Power is the same in both frames: $F_a . xi_a = F_b . xi_b$. For [f; tau]: $Ad*_T = [R, 0; [p]R, R]$.
    Shapes: (4, 4) -> (6, 6). A product with a vector or with columns is computed without the matrix.

    Attributes:
        transform: T_ab (4, 4).
        order: order of the wrenches.
    Raises: ShapeError if transform is not of shape (4, 4).
    """

    kinds = lie_rules.WRENCHES_CHANGE_FRAME
    label = "Ad_dual"
    function = se3.Ad_dual
    formula = r"\mathrm{Ad}^*_{<0>}"

    def applied_to(self, vector: Expr) -> Expr | None:
        return CoadjointAction(self.transform, vector, order=self.order)

    def transposed(self) -> Expr | None:
        """(Ad*_T)' = Ad_(T^-1)."""
        return self._of_inverse(SE3Adjoint)


class SO3Adjoint(Expr):
    """Ad_R of SO(3), which is R itself: maps rates of frame b to frame a. Shapes: (3, 3) -> (3, 3).

    Attributes:
        rotation: R_ab (3, 3).
    Raises: ShapeError if rotation is not of shape (3, 3).
    """

    rotation: Operand
    kinds = lie_rules.SAME_ROTATION
    label = "Ad"
    takes, gives = ((3, 3),), (3, 3)
    function = so3.Ad
    formula = r"\mathrm{Ad}_{<0>}"
    cases = ({"rotation": ROTATION},)

    def validate(self) -> None:
        check_element(type(self).__name__, "rotation", self.rotation)

    def simplify(self) -> Expr:
        """Ad_R is R."""
        return self.rotation


class _Action(ColumnsNode):
    """Base class of both actions. One half of the six-vector is rotated; the other half is rotated and gets the
    moment.
    """

    transform: Operand
    order = LINEAR_FIRST
    inverse = False
    abstract = True
    precedence = 20
    #: The operator in formulas.
    symbol: ClassVar[str] = ""

    @staticmethod
    def roles(linear: Any, angular: Any) -> tuple[Any, Any]:
        """(the half that gets a moment, the half that is only rotated)."""
        return linear, angular

    def validate(self) -> None:
        super().validate()
        if not isinstance(self.inverse, bool):
            raise OperationError(f"{type(self).__name__} expects inverse=True or inverse=False, got {self.inverse!r}")

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
        """An identity vanishes; an inverse is not formed; known zero parts are left out of the formula."""
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
    """$Ad_T xi$ without the matrix: $[R v + p x R w; R w]$. Shapes: (4, 4), (6,) -> (6,); (4, 4), (6, k) -> (6, k).

    `canonicalize` builds it from `SE3Adjoint(T) @ xi`. With inverse=True it is $Ad_(T^-1) xi = [R^T (v - p x w); R^T
    w]$, computed without $T^-1$.

    Attributes:
        transform: T_ab (4, 4), a pose.
        twist: (6,) in frame b (with inverse=True in frame a), or k of them as columns.
        order: order of the twist and the result.
        inverse: whether to apply $T^-1$ in place of T.
    Raises: ShapeError for an operand of another shape.
    """

    twist: Operand
    order: Order = LINEAR_FIRST
    inverse: bool = False
    kinds = lie_rules.TWISTS_CARRIED
    label = "Ad"
    cases = _cases("twist")
    symbol = r"\mathrm{Ad}"


class CoadjointAction(_Action):
    """$Ad*_T F$ without the matrix: $[R f; R tau + p x R f]$. Shapes: (4, 4), (6,) -> (6,); (4, 4), (6, k) -> (6, k).

    `canonicalize` builds it from `SE3AdjointDual(T) @ F`. With inverse=True it is $Ad*_(T^-1) F = [R^T f; R^T (tau - p
    x f)]$, computed without $T^-1$.

    Attributes:
        transform: T_ab (4, 4), a pose.
        wrench: (6,) in frame b (with inverse=True in frame a), or k of them as columns.
        order: order of the wrench and the result.
        inverse: whether to apply $T^-1$ in place of T.
    Raises: ShapeError for an operand of another shape.
    """

    wrench: Operand
    order: Order = LINEAR_FIRST
    inverse: bool = False
    kinds = lie_rules.WRENCHES_CARRIED
    label = "Ad_dual"
    cases = _cases("wrench")
    symbol = r"\mathrm{Ad}^*"

    @staticmethod
    def roles(linear: Any, angular: Any) -> tuple[Any, Any]:
        return angular, linear
