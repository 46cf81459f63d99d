"""Common parts of the Lie nodes: the order of twists, shapes of both groups, linear and angular parts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import numpy as np

from ...checks import reals
from ...errors import ModelError, OperationError, ShapeError
from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order, se3, so3
from ...groups.arrays import element_defect
from ..canonical import fold
from ..fields import ExprLike, Operand
from ..kinds import lie_rules
from ..leaves import Constant, State
from ..node import Expr, Shape, expect
from ..operations.arithmetic import is_constant

_SIX = ((6,), (6, 6))

# Values of the conformance suite.
TWIST = np.array([0.3, -1.2, 0.8, 0.5, -0.4, 0.9])
OTHER_TWIST = np.array([-0.7, 0.2, 1.1, 0.6, 1.3, -0.8])
COLUMNS = np.stack([TWIST, OTHER_TWIST], axis=1)
ROTATION = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3.0
POSE = np.block([[ROTATION, np.array([[0.7], [-0.3], [1.4]])], [np.eye(4)[3:]]])


def both_orders(**values: Any) -> list[dict[str, Any]]:
    """The same case with [v; w] and with [w; v]."""
    return [values | {"order": order} for order in (LINEAR_FIRST, ANGULAR_FIRST)]


#: The largest deviation of a constant from a rotation or a pose. Matrices with four digits are accepted, a reflection
#: is not.
NEARLY = 1e-4


def check_element(owner: str, operand: str, element: Expr) -> None:
    """Raise ModelError if a constant operand is neither a rotation nor a pose, or if a state is on another group."""
    refuse_other_group(owner, operand, element)
    value = element.value if isinstance(element, Constant) else np.zeros(0)
    if value.shape in ELEMENTS and not element_defect(value) <= NEARLY:
        raise ModelError(
            f"{owner} expects {operand} to be a {'pose [R p; 0 1]' if len(value) == 4 else 'rotation'}, got\n{value}, "
            f"with an error of {element_defect(value):.2g}\n"
            "  fix: tx.pose(...) builds one, tx.SE3.normalize(T) returns the pose nearest to a matrix"
        )


def refuse_other_group(owner: str, operand: str, element: Expr) -> None:
    """Raise ModelError for a state on a group other than SO(3) and SE(3), regardless of its shape."""
    if isinstance(element, State) and not (element.group.flat or element.group.rigid):
        raise ModelError(
            f"{owner} expects {operand} to be a rotation or a pose, state {element!r} is on {element.group.name}.\n"
            "  fix: use the entries of the state, or a custom node"
        )


class TwistNode(Expr):
    """A node over six-vectors. It has an order, which its six-dimensional operands and result must have, too."""

    # Not annotated here: each node declares `order: Order = LINEAR_FIRST` after its operands.
    order = LINEAR_FIRST
    abstract = True
    by_values = True

    def validate(self) -> None:
        if hasattr(self, "transform"):
            check_element(type(self).__name__, "transform", self.transform)
        if not isinstance(self.order, Order):
            raise OperationError(
                f"{type(self).__name__} expects order=tx.LINEAR_FIRST or tx.ANGULAR_FIRST, got {self.order!r}"
            )

    def twist_orders(self) -> tuple[list[Order | None], Order | None]:
        shapes = [child.shape for child in self.children()]
        return [self.order if s in _SIX else None for s in shapes], self.order if self.shape in _SIX else None

    def evaluate(self, *values: jax.Array) -> jax.Array:
        """The function computes with the linear part first; values that are not six-dimensional are unchanged."""
        return self._swapped(type(self).function(*map(self._swapped, values)))

    def _swapped(self, value: jax.Array) -> jax.Array:
        return value if self.order.linear_leads or value.shape not in _SIX else self.order.from_linear_first(value)


class ColumnsNode(TwistNode):
    """A node over six-vectors that may be the k columns of (6, k). Only its rows have an order."""

    abstract = True

    def twist_orders(self) -> tuple[list[Order | None], Order | None]:
        has_six_rows = [value.shape[:1] == (6,) for value in [*self.children(), self]]
        *operands, result = [self.order if six else None for six in has_six_rows]
        return operands, result

    def twist_axes(self, value: Expr) -> list[int]:
        return [-value.ndim]

    def shared_orders(self) -> list[list[tuple[Expr, int]]]:
        return [[(value, -1) for value in [*self.children(), self] if value.ndim == 2]]


def expect_columns(node: Expr, operand: str, got: Shape, rows: int) -> None:
    """Raise ShapeError unless an operand is one vector with this number of rows, or a matrix of k such columns."""
    if len(got) != 2 or got[0] != rows:
        expect(node, operand, got, (rows,), f"one vector ({rows},) or k columns ({rows}, k)")


_GROUPS = {(3,): so3, (6,): se3, (3, 3): so3, (4, 4): se3}


def of_group(name: str) -> Callable[..., jax.Array]:
    """The map with this name of the group that has the shape of the first value."""
    return lambda *values: getattr(_GROUPS[values[0].shape], name)(*values)


TANGENTS, ELEMENTS = ((3,), (6,)), ((3, 3), (4, 4))


def expect_one_of(node: Expr, operand: str, got: Shape, known: tuple[Shape, Shape]) -> None:
    """Raise ShapeError if the shape of an operand is that of neither group."""
    if got not in known:
        raise ShapeError(f"{type(node).__name__} expects {operand} with shape {known[0]} or {known[1]}, got {got}")


def unit_vector(owner: str, name: str, value: Any) -> np.ndarray:
    """A direction (3,) as a unit vector.

    Raises:
        ShapeError: it has not three entries.
        ModelError: it is zero, not finite, or does not consist of numbers.
    """
    vector = reals(f"{owner}: {name}", value, ModelError).astype(np.float64)
    if vector.shape != (3,):
        raise ShapeError(f"{owner} expects {name} with shape (3,), got {vector.shape}")
    largest = np.max(np.abs(vector))
    if not np.isfinite(largest) or largest == 0.0:
        raise ModelError(
            f"{owner} expects {name} to be a direction, got {vector.tolist()}.\n"
            "  fix: pass three finite numbers, not all zero; the vector is normalised"
        )
    # Scaled first: the squares of very large or very small entries leave the range. Adding 0 turns -0 into 0.
    vector = vector / largest
    return vector / np.linalg.norm(vector) + 0.0


# ---- parts of six-vectors ----------------------------------------------------------------------------------------


class _Part(ColumnsNode):
    vector: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.HALF
    abstract = True
    by_values = True
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
        known = isinstance(joined, JoinedParts) and joined.order == self.order
        return joined.children()[self.place] if known else self


class LinearPart(_Part):
    """v of [v; w], or f of [f; tau]. Shapes: (6,) -> (3,); (6, k) -> (3, k).

    Attributes:
        vector: a twist, wrench or momentum (6,), or k of them as columns.
        order: its order.
    Raises: ShapeError if vector does not have six rows.
    """

    label = "linear"


class AngularPart(_Part):
    """w of [v; w], or tau of [f; tau]. Shapes: (6,) -> (3,); (6, k) -> (3, k).

    Attributes, Raises: as for `LinearPart`; ShapeError if vector does not have six rows.
    """

    label = "angular"
    place = 1


class JoinedParts(ColumnsNode):
    """The six-vector of a linear and an angular part. Shapes: (3,), (3,) -> (6,); (3, k), (3, k) -> (6, k).

    Made by `twist` and `wrench`.

    Attributes:
        linear, angular: (3,) each, or k columns each.
        order: order of the result.
    Raises: ShapeError if a part does not have three rows, or if the parts differ in shape.
    """

    by_values = True
    linear: Operand
    angular: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.HALVES
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
    """The linear and the angular part of a canonical six-vector or of columns, if they are known."""
    linear, angular = (fold(part(vector, order=order).simplify()) for part in (LinearPart, AngularPart))
    return linear, angular


def has_zero_half(vector: Expr, order: Order) -> bool:
    """Whether one part is known to be zero."""
    return any(is_constant(half, 0.0) for half in halves(vector, order))


class Reorder(TwistNode):
    """The same twist, wrench or 6x6 operator in the other order. Shapes: (6,) -> (6,) or (6, 6) -> (6, 6).

    Attributes:
        value: a twist, wrench or operator in the other order.
        order: order of the result.
    Raises: ShapeError if value is neither (6,) nor (6, 6).
    """

    value: Operand
    order: Order = LINEAR_FIRST
    kinds = lie_rules.REORDERED
    label = "reorder"
    cases = (*both_orders(value=TWIST), {"value": np.outer(TWIST, OTHER_TWIST)})

    def infer_shape(self, *shapes: Shape) -> Shape:
        if shapes[0] != (6, 6):
            expect(self, "value", shapes[0], (6,), "a vector (6,) or an operator (6, 6)")
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        # Exchanging the halves is its own inverse.
        return ANGULAR_FIRST.from_linear_first(values[0])

    def simplify(self) -> Expr:
        """Reordering twice is the identity."""
        return self.value.value if isinstance(self.value, Reorder) else self

    def twist_orders(self) -> tuple[list[Order | None], Order | None]:
        return [Order(linear_leads=not self.order.linear_leads)], self.order


def linear(vector: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The linear part (3,) of a vector (6,) in the order `order`, a twist, wrench or momentum; for k columns (6, k) it
    is (3, k).

    Raises ShapeError.
    """
    return LinearPart(vector, order=order)


def angular(vector: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The angular part (3,) of a vector (6,) in the order `order`, a twist, wrench or momentum; for k columns (6, k) it
    is (3, k).

    Raises ShapeError.
    """
    return AngularPart(vector, order=order)


def twist(*, linear: ExprLike, angular: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The twist (6,) of a linear velocity (3,) in m/s and an angular rate (3,) in rad/s, both in the body frame.

    `order` determines which part is first. Raises ShapeError if a part is not of shape (3,).
    """
    return JoinedParts(linear, angular, order=order)


def wrench(*, force: ExprLike, torque: ExprLike, order: Order = LINEAR_FIRST) -> Expr:
    """The wrench (6,) of a force (3,) in N and a torque (3,) in N m, both in the body frame.

    `order` determines which part is first. Raises ShapeError if a part is not of shape (3,).
    """
    return JoinedParts(force, torque, order=order)
