"""Common parts of nodes: shape rules, and base classes of entrywise and variadic nodes."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ShapeError
from .fields import ExprLike
from .node import Expr, Numbers, Shape


def expect_square(node: Expr, operand: str, got: Shape, *, stacks: bool = False) -> None:
    """Raise an error unless the operand is a square matrix, or a stack of square matrices if `stacks` permits it."""
    if len(got) < 2 or got[-1] != got[-2] or (len(got) > 2 and not stacks):
        raise ShapeError(f"{type(node).__name__} expects {operand} to be a square matrix, got shape {got}")


def broadcast(node: Expr, *shapes: Shape) -> Shape:
    """NumPy's broadcast shape, or an error that names all shapes."""
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ShapeError(
            f"{type(node).__name__} shapes not broadcastable: {' and '.join(map(str, shapes))}",
            hint="index or reshape an operand so that the shapes agree",
        ) from None


def align(*values: Numbers) -> list[Numbers]:
    """Add leading axes of length 1 so that all values have the same rank; scalars are unchanged.

    This satisfies JAX's strict rank promotion.
    """
    rank = max(value.ndim for value in values)
    return [v if v.ndim in (0, rank) else v.reshape((1,) * (rank - v.ndim) + v.shape) for v in values]


class Entrywise(Expr, init=False):
    """Base class of entrywise nodes, with NumPy's broadcasting for several operands."""

    abstract = True
    keeps_order = True
    of_numbers = True
    by_values = True

    def infer_shape(self, *shapes: Shape) -> Shape:
        return broadcast(self, *shapes)

    def evaluate(self, *values: Numbers) -> Numbers:
        return type(self).function(*align(*values))


class Variadic(Expr, init=False):
    """Base class of nodes with any number of operands, for type checkers."""

    abstract = True

    if TYPE_CHECKING:

        def __init__(self, *operands: ExprLike | Sequence[ExprLike]) -> None: ...


class Chained(Entrywise, Variadic, init=False):
    """Base class of nodes that combine two or more operands entry by entry, pairwise in any order."""

    abstract = True
    by_values = True
    fewest = 2
    associative = True

    def evaluate(self, *values: Numbers) -> Numbers:
        return functools.reduce(lambda a, b: type(self).function(*align(a, b)), values)
