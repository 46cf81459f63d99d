"""Adjoint and coadjoint operators: how twists and wrenches act, and how they change frame.

Conventions: twist xi = [v; w], wrench F = [f; tau], momentum mu = [p; L], all in the body frame; T_ab maps coordinates
of frame b to frame a, p_a = T_ab p_b. With order=ANGULAR_FIRST the same operators read and give [w; v].

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2;
R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2, for [w; v].
"""

from __future__ import annotations

import jax

from ...groups import LINEAR_FIRST, Order, se3, so3
from ..arithmetic import is_constant, zeros_of
from ..fields import Operand
from ..node import Example, Expr, Shape
from ..shapes import expect
from .base import TwistNode, body_values, is_identity_element, pose_value, twist_state
from .transforms import undoes


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

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "twist1", shapes[0], (6,))
        expect(self, "twist2", shapes[1], (6,))
        return (6,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.bracket, *values)

    def simplify(self) -> Expr:
        """[xi, xi] is 0, and so is the bracket with 0."""
        zero = is_constant(self.twist1, 0.0) or is_constant(self.twist2, 0.0)
        return zeros_of(self) if zero or self.twist1.key() == self.twist2.key() else self

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{ad}}_{{{operands[0]}}}\left({operands[1]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(twist_state("a"), twist_state("b"), order=order), body_values())


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

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "twist", shapes[0], (6,))
        expect(self, "momentum", shapes[1], (6,))
        return (6,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.coad, *values)

    def simplify(self) -> Expr:
        """A body at rest, or without momentum, has no such term."""
        return zeros_of(self) if is_constant(self.twist, 0.0) or is_constant(self.momentum, 0.0) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{ad}}^*_{{{operands[0]}}}\left({operands[1]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(twist_state("a"), twist_state("b"), order=order), body_values())


class SE3Adjoint(TwistNode):
    """Ad_T, the 6x6 matrix that maps twists of frame b to frame a: xi_a = Ad_T xi_b, (Ad_T xi)^ = T xi^ T^-1.

    For [v; w]: Ad_T = [R [p]R; 0 R]. Shapes: (4, 4) -> (6, 6). A product with a vector is computed without the matrix.

    Attributes:
        transform: T_ab (4, 4).
        order: order of the twists.
    Raises:
        ShapeError: transform is not of shape (4, 4).
    """

    transform: Operand
    order: Order = LINEAR_FIRST
    label = "Ad"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "transform", shapes[0], (4, 4))
        return (6, 6)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.Ad, values[0])

    def applied_to(self, vector: Expr) -> Expr | None:
        return AdjointAction(self.transform, vector, order=self.order)

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{Ad}}_{{{operands[0]}}}"

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(pose_value("T"), order=order), body_values())


class SE3AdjointDual(TwistNode):
    """Ad*_T = Ad_T^-T, the 6x6 matrix that maps wrenches and momenta of frame b to frame a: F_a = Ad*_T F_b.

    Power is the same in both frames: F_a . xi_a = F_b . xi_b. For [f; tau]: Ad*_T = [R 0; [p]R R].
    Shapes: (4, 4) -> (6, 6). A product with a vector is computed without the matrix.

    Attributes:
        transform: T_ab (4, 4).
        order: order of the wrenches.
    Raises:
        ShapeError: transform is not of shape (4, 4).
    """

    transform: Operand
    order: Order = LINEAR_FIRST
    label = "Ad_dual"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "transform", shapes[0], (4, 4))
        return (6, 6)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(se3.Ad_dual, values[0])

    def applied_to(self, vector: Expr) -> Expr | None:
        return CoadjointAction(self.transform, vector, order=self.order)

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{Ad}}^*_{{{operands[0]}}}"

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(pose_value("T"), order=order), body_values())


class AdjointAction(TwistNode):
    """Ad_T xi without the matrix: [R v + p x R w; R w]. Shapes: (4, 4), (6,) -> (6,).

    `canonicalize` makes it of `SE3Adjoint(T) @ xi`.

    Attributes:
        transform: T_ab (4, 4).
        twist: in frame b, (6,).
        order: order of the twist and the result.
    Raises:
        ShapeError: an operand of another shape.
    """

    transform: Operand
    twist: Operand
    order: Order = LINEAR_FIRST
    label = "Ad"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "transform", shapes[0], (4, 4))
        expect(self, "twist", shapes[1], (6,))
        return (6,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        T, xi = values
        v, w = self.order.split(xi)
        rotated = so3.act(T[:3, :3], w)
        return self.order.join(so3.act(T[:3, :3], v) + so3.bracket(T[:3, 3], rotated), rotated)

    def simplify(self) -> Expr:
        """The identity leaves a twist as it is, and so does every pose a zero; the inverse pose undoes the pose."""
        T, twist = self.transform, self.twist
        if is_identity_element(T) or is_constant(twist, 0.0):
            return twist
        if isinstance(twist, AdjointAction) and twist.order == self.order and undoes(T, twist.transform):
            return twist.twist
        return self

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{Ad}}_{{{operands[0]}}} \, {operands[1]}"

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(pose_value("T"), twist_state("a"), order=order), body_values())


class CoadjointAction(TwistNode):
    """Ad*_T F without the matrix: [R f; R tau + p x R f]. Shapes: (4, 4), (6,) -> (6,).

    `canonicalize` makes it of `SE3AdjointDual(T) @ F`.

    Attributes:
        transform: T_ab (4, 4).
        wrench: in frame b, (6,).
        order: order of the wrench and the result.
    Raises:
        ShapeError: an operand of another shape.
    """

    transform: Operand
    wrench: Operand
    order: Order = LINEAR_FIRST
    label = "Ad_dual"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "transform", shapes[0], (4, 4))
        expect(self, "wrench", shapes[1], (6,))
        return (6,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        T, wrench = values
        force, torque = self.order.split(wrench)
        rotated = so3.act(T[:3, :3], force)
        return self.order.join(rotated, so3.act(T[:3, :3], torque) + so3.bracket(T[:3, 3], rotated))

    def simplify(self) -> Expr:
        """The identity leaves a wrench as it is, and so does every pose a zero; the inverse pose undoes the pose."""
        T, wrench = self.transform, self.wrench
        if is_identity_element(T) or is_constant(wrench, 0.0):
            return wrench
        if isinstance(wrench, CoadjointAction) and wrench.order == self.order and undoes(T, wrench.transform):
            return wrench.wrench
        return self

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{Ad}}^*_{{{operands[0]}}} \, {operands[1]}"

    @classmethod
    def example(cls) -> list[Example]:
        return cls.in_both_orders(lambda order: cls(pose_value("T"), twist_state("a"), order=order), body_values())


class SO3Adjoint(Expr):
    """Ad_R of SO(3), which is R itself: maps rates of frame b to frame a. Shapes: (3, 3) -> (3, 3).

    Attributes:
        rotation: R_ab (3, 3).
    Raises:
        ShapeError: rotation is not of shape (3, 3).
    """

    rotation: Operand
    label = "Ad"

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "rotation", shapes[0], (3, 3))
        return (3, 3)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return so3.Ad(values[0])

    def simplify(self) -> Expr:
        """Ad_R is R."""
        return self.rotation

    def to_latex(self, *operands: str) -> str:
        return rf"\mathrm{{Ad}}_{{{operands[0]}}}"

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(cls(pose_value("R", rotation=True)), body_values())]


__all__ = [
    "Adjoint",
    "AdjointAction",
    "AdjointDual",
    "CoadjointAction",
    "SE3Adjoint",
    "SE3AdjointDual",
    "SO3Adjoint",
]
