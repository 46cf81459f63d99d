"""Rotations and poses as elements: products, inverses, action on points; hat and vee.

Each node serves SO(3) and SE(3); the shape of the operand says which.
"""

from __future__ import annotations

import jax
import numpy as np

from ...groups import LINEAR_FIRST, Order, se3
from ..arithmetic import Mul, Neg, is_constant, is_identity, zeros_of
from ..canonical import fold
from ..fields import ExprLike, Operand
from ..indexing import Index
from ..leaves import Constant, State
from ..linalg import Cross
from ..node import Example, Expr, Shape
from ..printing import wrap_latex
from ..shapes import expect
from .base import (
    OF_MATRIX,
    OF_TANGENT,
    OTHER_TWIST,
    POSE,
    ROTATION,
    TWIST,
    TwistNode,
    both_orders,
    expect_one_of,
)


class Compose(Expr):
    """The product of two rotations or two poses, T_ac = T_ab T_bc. Shapes: (n, n), (n, n) -> (n, n), n = 3 or 4.

    Attributes:
        left, right: both rotations (3, 3) or both poses (4, 4).
    Raises:
        ShapeError: an operand of another shape, or a rotation meets a pose.
    """

    left: Operand
    right: Operand
    label = "compose"
    precedence = 20
    cases = ({"left": POSE, "right": POSE @ POSE}, {"left": ROTATION, "right": ROTATION})

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "left", shapes[0], OF_MATRIX)
        expect(self, "right", shapes[1], shapes[0])
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return OF_MATRIX[values[0].shape].compose(*values)

    def makes_group_element(self, *operands: bool) -> bool:
        return all(operands)

    def simplify(self) -> Expr:
        """The identity vanishes, and so does a group element beside its inverse, also inside of a chain."""
        left, right = self.left, self.right
        if is_identity(left):
            return right
        if is_identity(right):
            return left
        if undoes(left, right):
            return Constant(np.eye(self.shape[0]))
        if isinstance(right, Compose) and undoes(left, right.left):
            return right.right
        if isinstance(left, Compose) and undoes(left.right, right):
            return left.left
        return self

    def to_latex(self, *operands: str) -> str:
        return r" \circ ".join(wrap_latex(*pair, 20) for pair in zip(self.children(), operands))


class Inverse(Expr):
    """The inverse of a rotation or a pose, R' or [R' -R'p; 0 1]. Shapes: (n, n) -> (n, n), n = 3 or 4.

    Attributes:
        element: a rotation (3, 3) or a pose (4, 4); for other matrices use `tx.linalg.Inv`.
    Raises:
        ShapeError: element of another shape.
    """

    element: Operand
    label = "inverse"
    cases = ({"element": POSE}, {"element": ROTATION})

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "element", shapes[0], OF_MATRIX)
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return OF_MATRIX[values[0].shape].inverse(values[0])

    def makes_group_element(self, *operands: bool) -> bool:
        return operands[0]

    def simplify(self) -> Expr:
        """The inverse of the inverse of a group element is the element; that of a translation, its negative."""
        inner = self.element
        if isinstance(inner, Inverse) and inner.element.is_group_element:
            return inner.element
        if isinstance(inner, Pose) and inner.is_translation:
            return Pose(inner.rotation, Neg(inner.position))
        if isinstance(inner, Pose) and inner.is_rotation:
            return Pose(Inverse(inner.rotation), inner.position)
        return self

    def to_latex(self, *operands: str) -> str:
        return rf"{{{wrap_latex(self.element, operands[0], 60)}}}^{{-1}}"


def undoes(one: Expr, other: Expr) -> bool:
    """Whether two group elements are inverse to each other by construction."""
    pairs = ((one, other), (other, one))
    inverse = any(isinstance(a, Inverse) and a.element.key() == b.key() for a, b in pairs)
    return inverse and one.is_group_element


class Act(Expr):
    """A rotation or a pose applied to points: R p, or R p + t. Shapes: (3, 3) or (4, 4), and (3,) or (k, 3) points.

    Attributes:
        element: R_ab or T_ab.
        point: coordinates in frame b, m; the result is in frame a.
    Raises:
        ShapeError: an operand of another shape.
    """

    element: Operand
    point: Operand
    label = "act"
    precedence = 20
    cases = ({"element": POSE, "point": TWIST[:3]}, {"element": ROTATION, "point": TWIST[:3]})

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "element", shapes[0], OF_MATRIX)
        if len(shapes[1]) != 2 or shapes[1][1] != 3:
            expect(self, "point", shapes[1], (3,), "one point (3,) or k points (k, 3)")
        return shapes[1]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return OF_MATRIX[values[0].shape].act(*values)

    def simplify(self) -> Expr:
        """The identity vanishes; T^-1 undoes T; R 0 is 0; R times a unit vector is a column of R."""
        element, point = self.element, self.point
        if is_identity(element):
            return point
        if isinstance(point, Act) and undoes(element, point.element):
            return point.point
        if element.shape == (3, 3) and isinstance(point, Constant):
            if is_constant(point, 0.0):
                return zeros_of(self)
            if point.shape == (3,) and np.count_nonzero(point.value) == 1:
                axis = int(np.flatnonzero(point.value)[0])
                return Mul(Constant(point.value[axis]), Index(element, np.s_[:, axis]))
        return self

    def to_latex(self, *operands: str) -> str:
        element, point = operands
        return rf"{wrap_latex(self.element, element, 20)} \cdot {wrap_latex(self.point, point, 21)}"


class Pose(Expr):
    """The pose [R p; 0 1] of a rotation and a position. Shapes: (3, 3), (3,) -> (4, 4).

    Attributes:
        rotation: R (3, 3).
        position: p (3,), m.
    Raises:
        ShapeError: an operand of another shape.
    """

    rotation: Operand
    position: Operand
    label = "pose"
    takes = ((3, 3), (3,))
    gives = (4, 4)
    cases = (
        {"rotation": ROTATION, "position": TWIST[:3]},
        {"rotation": Constant(np.eye(3)), "position": TWIST[:3]},
        {"rotation": ROTATION, "position": Constant(np.zeros(3))},
    )

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return se3.transform(*values)

    def makes_group_element(self, *operands: bool) -> bool:
        return operands[0]

    @property
    def is_translation(self) -> bool:
        """Whether the rotation is known to be the identity."""
        return is_identity(self.rotation)

    @property
    def is_rotation(self) -> bool:
        """Whether the position is known to be zero."""
        return is_constant(self.position, 0.0)


def translation(position: ExprLike) -> Expr:
    """The pose [I p; 0 1] of a frame at p (3,), in m, with the axes of the other; an expression, numbers or an array.

    Ad and Ad* of it, and of its inverse, cost the six multiplications of one vector product.
    """
    return Pose(np.eye(3), position)


def rotation(rotation: ExprLike) -> Expr:
    """The pose [R 0; 0 1] of a frame turned by R (3, 3) about the origin of the other; an expression or an array.

    Ad and Ad* of it, and of its inverse, turn both halves of a six-vector and do nothing else.
    """
    return Pose(rotation, np.zeros(3))


def parts_of_pose(T: Expr) -> tuple[Expr, Expr]:
    """The rotation and the position of a canonical pose, as far as they are known."""
    if isinstance(T, Pose):
        return T.rotation, T.position
    return fold(Index(T, np.s_[:3, :3])), fold(Index(T, np.s_[:3, 3]))


class Hat(TwistNode):
    """hat: (3,) -> so(3), hat(w) u = w x u; (6,) -> se(3), hat([v; w]) = [[w]x v; 0 0].

    Attributes:
        vector: (3,) or (6,).
        order: order of a twist (6,).
    Raises:
        ShapeError: vector of another shape.
    """

    vector: Operand
    order: Order = LINEAR_FIRST
    label = "hat"
    cases = ({"vector": TWIST[3:]}, *both_orders(vector=TWIST))

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "vector", shapes[0], OF_TANGENT)
        return (3, 3) if shapes[0] == (3,) else (4, 4)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(OF_TANGENT[values[0].shape].hat, values[0])

    def applied_to(self, vector: Expr) -> Expr | None:
        return Cross(self.vector, vector) if self.vector.shape == (3,) else None

    def to_latex(self, *operands: str) -> str:
        return rf"{{{operands[0]}}}^\wedge"


class Vee(TwistNode):
    """vee, the inverse of hat: so(3) (3, 3) -> (3,), se(3) (4, 4) -> (6,).

    Attributes:
        matrix: an element of the algebra; of another matrix the skew part of its first three rows and columns is read.
        order: order of the resulting twist (6,).
    Raises:
        ShapeError: matrix of another shape.
    """

    matrix: Operand
    order: Order = LINEAR_FIRST
    label = "vee"
    cases = (
        *both_orders(matrix=np.outer(TWIST[:4], OTHER_TWIST[:4])),
        {"matrix": np.outer(TWIST[:3], OTHER_TWIST[3:])},
    )

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "matrix", shapes[0], OF_MATRIX)
        return (3,) if shapes[0] == (3, 3) else (6,)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.in_linear_first(OF_MATRIX[values[0].shape].vee, values[0])

    def simplify(self) -> Expr:
        """Vee(Hat(x)) is x, if both have one order."""
        hat = self.matrix
        if isinstance(hat, Hat) and (hat.order == self.order or self.shape == (3,)):
            return hat.vector
        return self

    def to_latex(self, *operands: str) -> str:
        return rf"\left({operands[0]}\right)^\vee"

    @classmethod
    def example(cls) -> list[Example]:
        return [*super().example(), Example(cls(Hat(State("w", shape=(3,)))), {"w": TWIST[3:]})]
