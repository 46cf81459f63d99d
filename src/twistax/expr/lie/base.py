"""What the Lie nodes share: the order of their twists, the shapes of both groups, and the values of their cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import jax
import numpy as np

from ...errors import ShapeError
from ...groups import ANGULAR_FIRST, LINEAR_FIRST, Order, se3, so3
from ..node import Expr, Shape
from ..shapes import expect

_SIX = ((6,), (6, 6))


class TwistNode(Expr):
    """A node over 6-vectors. It has an order, which its six-dimensional operands and result must have too."""

    # Not annotated here: each node declares `order: Order = LINEAR_FIRST` after its operands.
    order = LINEAR_FIRST
    abstract = True

    def validate(self) -> None:
        if not isinstance(self.order, Order):
            raise TypeError(
                f"{type(self).__name__} expects order=tx.LINEAR_FIRST or tx.ANGULAR_FIRST, got {self.order!r}"
            )

    def twist_orders(self) -> tuple[list[Order | None], Order | None]:
        shapes = [child.shape for child in self.children()]
        return [self.order if s in _SIX else None for s in shapes], self.order if self.shape in _SIX else None

    def in_linear_first(self, function: Callable[..., jax.Array], *values: jax.Array) -> jax.Array:
        """A function of linear-first values, in this node's order; what is not six-dimensional passes as it is."""
        return self._swapped(function(*(self._swapped(value) for value in values)))

    def _swapped(self, value: jax.Array) -> jax.Array:
        return self.order.from_linear_first(value) if value.shape in _SIX else value


class ColumnsNode(TwistNode):
    """A node over six-vectors that may stand side by side, as the k columns of (6, k). Only its rows have an order."""

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
    """Raise the plain sentence unless an operand is one vector of so many rows, or k of them side by side."""
    if len(got) != 2 or got[0] != rows:
        expect(node, operand, got, (rows,), f"one vector ({rows},) or k columns ({rows}, k)")


#: The numeric maps that belong to a tangent vector, and to a group element or a matrix of the algebra, by shape.
OF_TANGENT: dict[Shape, ModuleType] = {(3,): so3, (6,): se3}
OF_MATRIX: dict[Shape, ModuleType] = {(3, 3): so3, (4, 4): se3}


def expect_one_of(node: Expr, operand: str, got: Shape, known: Mapping[Shape, ModuleType]) -> None:
    """Raise the plain sentence if an operand has neither group's shape."""
    if got not in known:
        first, second = known
        raise ShapeError(f"{type(node).__name__} expects {operand} with shape {first} or {second}, got {got}")


# ---- cases for the conformance suite -----------------------------------------------------------------------------

TWIST = np.array([0.3, -1.2, 0.8, 0.5, -0.4, 0.9])
OTHER_TWIST = np.array([-0.7, 0.2, 1.1, 0.6, 1.3, -0.8])
COLUMNS = np.stack([TWIST, OTHER_TWIST], axis=1)
ROTATION = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3.0
POSE = np.block([[ROTATION, np.array([[0.7], [-0.3], [1.4]])], [np.eye(4)[3:]]])


def both_orders(**values: Any) -> list[dict[str, Any]]:
    """The same case with [v; w] and with [w; v]."""
    return [values | {"order": order} for order in (LINEAR_FIRST, ANGULAR_FIRST)]
