"""Rotations and poses as elements: products, inverses, action on points; hat and vee.

Each node serves SO(3) and SE(3); the shape of the operand says which.
"""

from __future__ import annotations

from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ShapeError
from ...groups import se3, so3
from ..fields import Operand
from ..leaves import Constant, State
from ..node import Example, Expr, Shape
from ..shapes import expect
from .base import body_values, is_group_element, is_identity_element, pose_value, twist_state

_OF_ELEMENT: dict[Shape, ModuleType] = {(3, 3): so3, (4, 4): se3}
_OF_TANGENT: dict[Shape, ModuleType] = {(3,): so3, (6,): se3}


def _one_of(node: Expr, operand: str, got: Shape, known: dict[Shape, ModuleType]) -> None:
    if got not in known:
        first, second = known
        raise ShapeError(f"{type(node).__name__} expects {operand} with shape {first} or {second}, got {got}")


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

    def infer_shape(self, *shapes: Shape) -> Shape:
        _one_of(self, "left", shapes[0], _OF_ELEMENT)
        expect(self, "right", shapes[1], shapes[0])
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        result: jax.Array = _OF_ELEMENT[self.shape].compose(*values)
        return result

    def makes_group_element(self) -> bool:
        return is_group_element(self.left) and is_group_element(self.right)

    def simplify(self) -> Expr:
        """The identity vanishes; T^-1 T and T T^-1 are the identity for a group element."""
        if is_identity_element(self.left):
            return self.right
        if is_identity_element(self.right):
            return self.left
        for inverse, element in ((self.left, self.right), (self.right, self.left)):
            if isinstance(inverse, Inverse) and inverse.element.key() == element.key() and is_group_element(element):
                return Constant(np.eye(self.shape[0]))
        return self

    def to_latex(self, *operands: str) -> str:
        return r" \circ ".join(operands)

    @classmethod
    def example(cls) -> list[Example]:
        R = pose_value("R", rotation=True)
        return [Example(cls(pose_value("T"), pose_value("S")), body_values()), Example(cls(R, R), body_values())]


class Inverse(Expr):
    """The inverse of a rotation or a pose, R' or [R' -R'p; 0 1]. Shapes: (n, n) -> (n, n), n = 3 or 4.

    Attributes:
        element: a rotation (3, 3) or a pose (4, 4); for other matrices use `tx.linalg.Inv`.
    Raises:
        ShapeError: element of another shape.
    """

    element: Operand
    label = "inverse"

    def infer_shape(self, *shapes: Shape) -> Shape:
        _one_of(self, "element", shapes[0], _OF_ELEMENT)
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        result: jax.Array = _OF_ELEMENT[self.shape].inverse(values[0])
        return result

    def makes_group_element(self) -> bool:
        return is_group_element(self.element)

    def simplify(self) -> Expr:
        """The inverse of the inverse of a group element is the element."""
        inner = self.element
        if isinstance(inner, Inverse) and is_group_element(inner.element):
            return inner.element
        return self

    def to_latex(self, *operands: str) -> str:
        return rf"{{{operands[0]}}}^{{-1}}"

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(cls(pose_value("T")), body_values()), Example(cls(pose_value("R", rotation=True)), body_values())]


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

    def infer_shape(self, *shapes: Shape) -> Shape:
        _one_of(self, "element", shapes[0], _OF_ELEMENT)
        if len(shapes[1]) != 2 or shapes[1][1] != 3:
            expect(self, "point", shapes[1], (3,), "one point (3,) or k points (k, 3)")
        return shapes[1]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        result: jax.Array = _OF_ELEMENT[self.element.shape].act(*values)
        return result

    def simplify(self) -> Expr:
        """The identity vanishes."""
        return self.point if is_identity_element(self.element) else self

    def to_latex(self, *operands: str) -> str:
        return r" \cdot ".join(operands)

    @classmethod
    def example(cls) -> list[Example]:
        v, R = State("v", shape=(3,)), pose_value("R", rotation=True)
        return [Example(cls(pose_value("T"), v), body_values()), Example(cls(R, v), body_values())]


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

    def infer_shape(self, *shapes: Shape) -> Shape:
        expect(self, "rotation", shapes[0], (3, 3))
        expect(self, "position", shapes[1], (3,))
        return (4, 4)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return se3.transform(*values)

    def makes_group_element(self) -> bool:
        return is_group_element(self.rotation)

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(cls(pose_value("R", rotation=True), State("v", shape=(3,))), body_values())]


class Hat(Expr):
    """hat: (3,) -> so(3), hat(w) x = w x x; (6,) -> se(3), hat([v; w]) = [[w]x v; 0 0]. Linear first.

    Attributes:
        vector: (3,) or (6,).
    Raises:
        ShapeError: vector of another shape.
    """

    vector: Operand
    label = "hat"

    def infer_shape(self, *shapes: Shape) -> Shape:
        _one_of(self, "vector", shapes[0], _OF_TANGENT)
        return {(3,): (3, 3), (6,): (4, 4)}[shapes[0]]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        result: jax.Array = _OF_TANGENT[self.vector.shape].hat(values[0])
        return result

    def applied_to(self, vector: Expr) -> Expr | None:
        from ..linalg import Cross

        return Cross(self.vector, vector) if self.vector.shape == (3,) else None

    def to_latex(self, *operands: str) -> str:
        return rf"{{{operands[0]}}}^\wedge"

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(cls(State("w", shape=(3,))), body_values()), Example(cls(twist_state("a")), body_values())]


class Vee(Expr):
    """vee, the inverse of hat: so(3) (3, 3) -> (3,), se(3) (4, 4) -> (6,), linear first.

    Attributes:
        matrix: an element of the algebra; of another matrix its skew part is read.
    Raises:
        ShapeError: matrix of another shape.
    """

    matrix: Operand
    label = "vee"

    def infer_shape(self, *shapes: Shape) -> Shape:
        _one_of(self, "matrix", shapes[0], _OF_ELEMENT)
        return {(3, 3): (3,), (4, 4): (6,)}[shapes[0]]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        result: jax.Array = _OF_ELEMENT[self.matrix.shape].vee(values[0])
        return result

    def simplify(self) -> Expr:
        """Vee(Hat(x)) is x."""
        return self.matrix.vector if isinstance(self.matrix, Hat) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\left({operands[0]}\right)^\vee"

    @classmethod
    def example(cls) -> list[Example]:
        values = body_values()
        with jax.enable_x64(True), jax.ensure_compile_time_eval():
            algebra = {"X": np.asarray(jnp.asarray(se3.hat(values["a"])))}
        return [Example(cls(State("X", shape=(4, 4))), algebra), Example(cls(Hat(State("w", shape=(3,)))), values)]


__all__ = ["Act", "Compose", "Hat", "Inverse", "Pose", "Vee"]
