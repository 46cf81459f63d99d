"""Adjoint and coadjoint operators: how twists and wrenches act, and how they change frame.

Conventions: twist xi = [v; w], wrench F = [f; tau], momentum mu = [p; L], all in the body frame; T_ab maps coordinates
of frame b to frame a, p_a = T_ab p_b. With order=ANGULAR_FIRST the same operators read and give [w; v].

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2;
R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2, for [w; v].
"""

from __future__ import annotations

from typing import ClassVar

import jax

from ...groups import LINEAR_FIRST, Order, se3, so3
from ..arithmetic import Add, is_constant, zeros_of
from ..fields import Operand
from ..linalg import Cross
from ..node import Expr
from .actions import AdjointAction, CoadjointAction
from .base import OTHER_TWIST, POSE, ROTATION, TWIST, TwistNode, both_orders
from .parts import JoinedParts, halves, has_zero_half
from .transforms import Inverse


class Adjoint(TwistNode):
    """The Lie bracket of two twists, ad_xi1(xi2) = [xi1, xi2] = [w1 x v2 - w2 x v1; w1 x w2].

    As a matrix for [v; w]: ad_xi = [[w] [v]; 0 [w]]. Shapes: (6,), (6,) -> (6,).

    Attributes:
        twist1, twist2: twists (6,), m/s and rad/s.
        order: order of both and of the result.
    Raises:
        ShapeError: an operand is not of shape (6,).
    """

    twist1: Operand
    twist2: Operand
    order: Order = LINEAR_FIRST
    label = "ad"
    takes = ((6,), (6,))
    gives = (6,)
    cases = both_orders(twist1=TWIST, twist2=OTHER_TWIST)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.bracket, *values)

    def simplify(self) -> Expr:
        """[xi, xi] is 0, and so is the bracket with 0; with a half of zeros only the other products are left."""
        one, other = self.twist1, self.twist2
        if is_constant(one, 0.0) or is_constant(other, 0.0) or one.key() == other.key():
            return zeros_of(self)
        if not (has_zero_half(one, self.order) or has_zero_half(other, self.order)):
            return self
        (v1, w1), (v2, w2) = halves(one, self.order), halves(other, self.order)
        return JoinedParts(Add(Cross(w1, v2), Cross(v1, w2)), Cross(w1, w2), order=self.order)

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{ad}}_{{{operands[0]}}}\left({operands[1]}\right)"


class AdjointDual(TwistNode):
    """The coadjoint action on momentum or wrench, ad*_xi(mu) = -ad_xi^T mu = [w x p; v x p + w x L].

    Newton-Euler for a body: M xi' = F - ad*_xi(M xi). Shapes: (6,), (6,) -> (6,).

    Attributes:
        twist: (6,), m/s and rad/s.
        momentum: (6,), N s and N m s (or a wrench, N and N m).
        order: order of both and of the result.
    Raises:
        ShapeError: an operand is not of shape (6,).
    """

    twist: Operand
    momentum: Operand
    order: Order = LINEAR_FIRST
    label = "ad_dual"
    takes = ((6,), (6,))
    gives = (6,)
    cases = both_orders(twist=TWIST, momentum=OTHER_TWIST)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.coad, *values)

    def simplify(self) -> Expr:
        """A body at rest, or without momentum, has no such term; a half of zeros leaves only the other products."""
        if is_constant(self.twist, 0.0) or is_constant(self.momentum, 0.0):
            return zeros_of(self)
        if not (has_zero_half(self.twist, self.order) or has_zero_half(self.momentum, self.order)):
            return self
        (v, w), (p, L) = halves(self.twist, self.order), halves(self.momentum, self.order)
        return JoinedParts(Cross(w, p), Add(Cross(v, p), Cross(w, L)), order=self.order)

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{ad}}^*_{{{operands[0]}}}\left({operands[1]}\right)"


class _FrameMatrix(TwistNode):
    """What Ad_T and Ad*_T share: each is the other's inverse transpose."""

    transform: Operand
    order: Order = LINEAR_FIRST
    abstract = True
    structured = True
    takes = ((4, 4),)
    gives = (6, 6)
    cases = both_orders(transform=POSE)
    symbol: ClassVar[str] = ""

    @staticmethod
    def matrix(T: jax.Array) -> jax.Array:
        """The matrix for linear-first six-vectors."""
        raise NotImplementedError

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(self.matrix, values[0])

    def _of_inverse(self, node: type[Expr]) -> Expr | None:
        known = self.transform.is_group_element
        return node(Inverse(self.transform), order=self.order) if known else None

    def inverted(self) -> Expr | None:
        """The same of the inverse pose."""
        return self._of_inverse(type(self))

    def to_latex(self, *operands: str) -> str:
        return rf"{self.symbol}_{{{operands[0]}}}"


class SE3Adjoint(_FrameMatrix):
    """Ad_T, the 6x6 matrix that maps twists of frame b to frame a: xi_a = Ad_T xi_b, (Ad_T xi)^ = T xi^ T^-1.

    For [v; w]: Ad_T = [R [p]R; 0 R]. Shapes: (4, 4) -> (6, 6). A product with a vector or with columns is computed
    without the matrix.

    Attributes:
        transform: T_ab (4, 4).
        order: order of the twists.
    Raises:
        ShapeError: transform is not of shape (4, 4).
    """

    label = "Ad"
    symbol = r"\mathrm{Ad}"

    @staticmethod
    def matrix(T: jax.Array) -> jax.Array:
        return se3.Ad(T)

    def applied_to(self, vector: Expr) -> Expr | None:
        return AdjointAction(self.transform, vector, order=self.order)

    def transposed(self) -> Expr | None:
        """Ad_T' = Ad*_(T^-1)."""
        return self._of_inverse(SE3AdjointDual)


class SE3AdjointDual(_FrameMatrix):
    """Ad*_T = Ad_T^-T, the 6x6 matrix that maps wrenches and momenta of frame b to frame a: F_a = Ad*_T F_b.

    Power is the same in both frames: F_a . xi_a = F_b . xi_b. For [f; tau]: Ad*_T = [R 0; [p]R R].
    Shapes: (4, 4) -> (6, 6). A product with a vector or with columns is computed without the matrix.

    Attributes:
        transform: T_ab (4, 4).
        order: order of the wrenches.
    Raises:
        ShapeError: transform is not of shape (4, 4).
    """

    label = "Ad_dual"
    symbol = r"\mathrm{Ad}^*"

    @staticmethod
    def matrix(T: jax.Array) -> jax.Array:
        return se3.Ad_dual(T)

    def applied_to(self, vector: Expr) -> Expr | None:
        return CoadjointAction(self.transform, vector, order=self.order)

    def transposed(self) -> Expr | None:
        """(Ad*_T)' = Ad_(T^-1)."""
        return self._of_inverse(SE3Adjoint)


class SO3Adjoint(Expr):
    """Ad_R of SO(3), which is R itself: maps rates of frame b to frame a. Shapes: (3, 3) -> (3, 3).

    Attributes:
        rotation: R_ab (3, 3).
    Raises:
        ShapeError: rotation is not of shape (3, 3).
    """

    rotation: Operand
    label = "Ad"
    takes = ((3, 3),)
    gives = (3, 3)
    cases = ({"rotation": ROTATION},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return so3.Ad(values[0])

    def simplify(self) -> Expr:
        """Ad_R is R."""
        return self.rotation

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{Ad}}_{{{operands[0]}}}"
