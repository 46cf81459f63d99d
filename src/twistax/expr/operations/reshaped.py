"""Reshaping of arrays."""

from __future__ import annotations

import math

from ...errors import ShapeError
from ..fields import Operand
from ..kinds import rules
from ..node import Expr, Numbers, Shape


class Reshaped(Expr):
    """The entries of an array, row by row, in another shape.

    Shapes: any with the same number of entries -> `target`.

    Attributes:
        target: the shape of the result.
    Raises:
        ShapeError: an operand with another number of entries.
    """

    operand: Operand
    target: Shape
    kinds = rules.OPEN
    by_operators = True
    cases = ({"operand": [[1.0, 2.0, 3.0], [4.0, 5.0, -6.0]], "target": (3, 2)},)

    def infer_shape(self, *shapes: Shape) -> Shape:
        if math.prod(shapes[0]) != (size := math.prod(self.target)):
            raise ShapeError(f"Reshaped expects an operand with {size} entries, got shape {shapes[0]}")
        return self.target

    def evaluate(self, *values: Numbers) -> Numbers:
        return values[0].reshape(self.target)
