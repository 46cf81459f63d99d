"""Nodes for rotations and poses, distinguished by their shape: exponential, logarithm, products, inverses, action on
points.

Source: R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 2;
J. Sola, J. Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics (2018), appendices.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order, se3, so3
from ..canonical import fold
from ..fields import Operand
from ..kinds import lie_rules, rules
from ..leaves import Constant
from ..matrices.linalg import Cross
from ..node import Expr, Shape, expect
from ..operations.arithmetic import Mul, Neg, is_constant, is_identity, zeros_of
from ..operations.array import Index
from ..printing.text import number_latex
from .base import (
    ELEMENTS,
    OTHER_TWIST,
    POSE,
    ROTATION,
    TANGENTS,
    TWIST,
    TwistNode,
    both_orders,
    check_element,
    expect_one_of,
    of_group,
    refuse_other_group,
    unit_vector,
)
from .jacobians import LeftJacobian, LeftJacobianInverse, RightJacobian, RightJacobianInverse  # noqa: F401  # pickles


class SO3Exp(Expr):
    """Exp: rotation vector (3,) in rad -> rotation (3, 3), $R = I + sin(t) / t W + (1 - cos(t)) / t^2 W^2$, t = |w|.

    Attributes:
        omega: the rotation vector.
    Raises: ShapeError if omega is not of shape (3,).
    """

    omega: Operand
    kinds = lie_rules.EXPONENTIAL
    takes, gives = ((3,),), (3, 3)
    function = so3.exp
    latex_name = r"\operatorname{Exp}"
    cases = ({"omega": TWIST[3:]}, {"omega": np.zeros(3)})

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """Exp(Log(R)) is R for a rotation."""
        log = self.omega
        return log.rotation if isinstance(log, SO3Log) and log.rotation.is_group_element else self


class SO3Log(Expr):
    """Log: rotation (3, 3) -> rotation vector (3,) in rad, of length at most pi.

    At exactly a half turn, the axis is the one whose first non-zero component is positive; derivatives are finite
    there.

    Attributes:
        rotation: R (3, 3).
    Raises: ShapeError if rotation is not of shape (3, 3).
    """

    rotation: Operand
    kinds = lie_rules.LOGARITHM
    takes, gives = ((3, 3),), (3,)
    function = so3.unchecked_log
    latex_name = r"\operatorname{Log}"
    # Outside of the group the map is an arbitrary extension: the example is computed by Exp.
    cases = ((lambda cls, w: cls(SO3Exp(w)), {"w": [0.4, -1.1, 0.6]}),)

    def validate(self) -> None:
        check_element(type(self).__name__, "rotation", self.rotation)


class SE3Exp(TwistNode):
    """Exp: twist (6,) -> pose (4, 4), [Exp(w) V(w) v; 0 1] with V the left Jacobian of SO(3).

    Attributes:
        twist: (6,), m and rad.
        order: order of the twist.
    Raises: ShapeError if twist is not of shape (6,).
    """

    twist: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.EXPONENTIAL
    takes, gives = ((6,),), (4, 4)
    function = se3.exp
    latex_name = r"\operatorname{Exp}"
    cases = (*both_orders(twist=TWIST), {"twist": np.zeros(6)})

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def simplify(self) -> Expr:
        """Exp(Log(T)) is T for a pose, if both have one order."""
        log = self.twist
        undone = isinstance(log, SE3Log) and log.order == self.order and log.transform.is_group_element
        return log.children()[0] if undone else self


class SE3Log(TwistNode):
    """Log: pose (4, 4) -> twist (6,), rotation angle at most pi; $[V(w)^-1 p; w]$ with $w = Log(R)$.

    At exactly a half turn, the axis is the one whose first non-zero component is positive; derivatives are finite
    there. Log(Exp(xi)) is xi only within a half turn, so no rewrite removes it.

    Attributes:
        transform: T (4, 4).
        order: order of the result.
    Raises: ShapeError if transform is not of shape (4, 4).
    """

    transform: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.LOGARITHM
    takes, gives = ((4, 4),), (6,)
    function = se3.unchecked_log
    latex_name = r"\operatorname{Log}"
    cases = (
        (lambda cls, a: cls(SE3Exp(a)), {"a": TWIST}),
        (lambda cls, a: cls(SE3Exp(a, ANGULAR_FIRST), ANGULAR_FIRST), {"a": TWIST}),
    )


class Compose(Expr):
    """The product of two rotations or two poses, $T_ac = T_ab T_bc$. Shapes: (n, n), (n, n) -> (n, n), n = 3 or 4.

    Attributes:
        left, right: both rotations (3, 3) or both poses (4, 4).
    Raises: ShapeError for an operand of another shape, or for a rotation with a pose.
    """

    left: Operand
    right: Operand
    kinds = lie_rules.COMPOSE
    label = "compose"
    function = of_group("compose")
    formula = r"<0:20> \circ <1:20>"
    precedence = 20
    cases = ({"left": POSE, "right": POSE @ POSE}, {"left": ROTATION, "right": ROTATION})

    def validate(self) -> None:
        for operand in ("left", "right"):
            refuse_other_group("Compose", operand, getattr(self, operand))

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "left", shapes[0], ELEMENTS)
        expect(self, "right", shapes[1], shapes[0])
        return shapes[0]

    def makes_group_element(self, *operands: bool) -> bool:
        return all(operands)

    def simplify(self) -> Expr:
        """An identity vanishes, and so does a group element next to its inverse, also inside a chain of products."""
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


class Inverse(Expr):
    """The inverse of a rotation or a pose, R' or [R' -R'p; 0 1]. Shapes: (n, n) -> (n, n), n = 3 or 4.

    Attributes:
        element: a rotation (3, 3) or a pose (4, 4); for other matrices use `tx.linalg.Inv`.
    Raises: ShapeError for element of another shape.
    """

    element: Operand
    kinds = lie_rules.INVERSE_ELEMENT
    label = "inverse"
    function = of_group("inverse")
    formula = "{<0:60>}^{-1}"
    cases = ({"element": POSE}, {"element": ROTATION})

    def validate(self) -> None:
        refuse_other_group("Inverse", "element", self.element)

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "element", shapes[0], ELEMENTS)
        return shapes[0]

    def makes_group_element(self, *operands: bool) -> bool:
        return operands[0]

    def simplify(self) -> Expr:
        """The inverse of the inverse of a group element is the element; that of a translation, its negative."""
        inner = self.element
        if isinstance(inner, Inverse) and inner.element.is_group_element:
            return inner.element
        if isinstance(inner, Pose) and is_identity(inner.rotation):
            return Pose(inner.rotation, Neg(inner.position))
        if isinstance(inner, Pose) and is_constant(inner.position, 0.0):
            return Pose(Inverse(inner.rotation), inner.position)
        return self


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
    Raises: ShapeError for an operand of another shape.
    """

    element: Operand
    point: Operand
    kinds = lie_rules.ACT
    label = "act"
    function = of_group("act")
    formula = r"<0:20> \cdot <1:21>"
    precedence = 20
    cases = ({"element": POSE, "point": TWIST[:3]}, {"element": ROTATION, "point": TWIST[:3]})

    def validate(self) -> None:
        refuse_other_group("Act", "element", self.element)

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "element", shapes[0], ELEMENTS)
        if len(shapes[1]) != 2 or shapes[1][1] != 3:
            expect(self, "point", shapes[1], (3,), "one point (3,) or k points (k, 3)")
        return shapes[1]

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


class Pose(Expr):
    """The pose [R p; 0 1] of a rotation and a position. Shapes: (3, 3), (3,) -> (4, 4).

    Attributes:
        rotation: R (3, 3).
        position: p (3,), m.
    Raises: ShapeError for an operand of another shape.
    """

    rotation: Operand
    position: Operand
    kinds = lie_rules.POSE
    label = "pose"
    takes, gives = ((3, 3), (3,)), (4, 4)
    function = se3.transform
    cases = (
        {"rotation": ROTATION, "position": TWIST[:3]},
        {"rotation": Constant(np.eye(3)), "position": TWIST[:3]},
        {"rotation": ROTATION, "position": Constant(np.zeros(3))},
    )

    def makes_group_element(self, *operands: bool) -> bool:
        return operands[0]


def parts_of_pose(T: Expr) -> tuple[Expr, Expr]:
    """The rotation and the position of a canonical pose, if they are known."""
    if isinstance(T, Pose):
        return T.rotation, T.position
    return fold(Index(T, np.s_[:3, :3])), fold(Index(T, np.s_[:3, 3]))


class Hat(TwistNode):
    """hat: (3,) -> so(3), hat(w) u = w x u; (6,) -> se(3), hat([v; w]) = [[w]x v; 0 0].

    Attributes:
        vector: (3,) or (6,).
        order: order of a twist (6,).
    Raises: ShapeError for vector of another shape.
    """

    vector: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.ALGEBRA
    label = "hat"
    function = of_group("hat")
    formula = r"{<0>}^\wedge"
    cases = ({"vector": TWIST[3:]}, *both_orders(vector=TWIST))

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "vector", shapes[0], TANGENTS)
        return (3, 3) if shapes[0] == (3,) else (4, 4)

    def applied_to(self, vector: Expr) -> Expr | None:
        return Cross(self.vector, vector) if self.vector.shape == (3,) else None


class Vee(TwistNode):
    """vee, the inverse of hat: so(3) (3, 3) -> (3,), se(3) (4, 4) -> (6,).

    Attributes:
        matrix: an element of the algebra; for other matrices the skew part of the first three rows and columns is used.
        order: order of the resulting twist (6,).
    Raises: ShapeError for matrix of another shape.
    """

    matrix: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.ALGEBRA
    label = "vee"
    function = of_group("vee")
    formula = r"\left(<0>\right)^\vee"
    cases = (
        *both_orders(matrix=np.outer(TWIST[:4], OTHER_TWIST[:4])),
        {"matrix": np.outer(TWIST[:3], OTHER_TWIST[3:])},
        (lambda cls, w: cls(Hat(w)), {"w": TWIST[3:]}),
    )

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect_one_of(self, "matrix", shapes[0], ELEMENTS)
        return (3,) if shapes[0] == (3, 3) else (6,)

    def simplify(self) -> Expr:
        """Vee(Hat(x)) is x, if both have one order."""
        hat = self.matrix
        return hat.vector if isinstance(hat, Hat) and (hat.order == self.order or self.shape == (3,)) else self


class AxisRotation(Expr):
    """$R = a a^T + sin q [a]x + cos q (I - a a^T)$: the rotation by q about a fixed unit axis a. Shapes: () -> (3, 3).

    Equal to SO3Exp(q a), with only one sine and one cosine (Rodrigues' formula).

    Attributes:
        angle: q in rad.
        axis: three numbers, not all zero; it is normalised.
    Raises:
        ShapeError: angle is not a scalar, or axis does not have three entries.
        ModelError: axis is zero, not finite, or does not consist of numbers.
    """

    angle: Operand
    axis: Any
    kinds = rules.NUMBERS
    takes, gives, takes_hint = ((),), (3, 3), "take the entry of a vector: angle[0]"
    cases = ({"angle": 0.7, "axis": (1.0, -2.0, 2.0)}, {"angle": 0.0, "axis": (0.0, 0.0, 1.0)})

    def validate(self) -> None:
        self.axis = tuple(unit_vector("AxisRotation", "axis", self.axis).tolist())

    def evaluate(self, *values: jax.Array) -> jax.Array:
        (q,) = values
        x, y, z = self.axis
        projection = np.outer(self.axis, self.axis)
        turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        constant, sine, cosine = (jnp.asarray(part, q.dtype) for part in (projection, turn, np.eye(3) - projection))
        return constant + jnp.sin(q) * sine + jnp.cos(q) * cosine

    def makes_group_element(self, *operands: bool) -> bool:
        return True

    def to_latex(self, *operands: str) -> str:
        axis = ", ".join(number_latex(entry, 4) for entry in self.axis)
        return rf"\operatorname{{Rot}}_{{({axis})}}\left({operands[0]}\right)"
