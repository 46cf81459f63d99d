"""Shape rules shared by the nodes, and the alignment that keeps JAX's strict rank promotion content."""

from __future__ import annotations

import numpy as np

from ..errors import ShapeError
from .node import Expr, Numbers, Shape


def expect(node: Expr, operand: str, got: Shape, wanted: Shape, hint: str | None = None) -> None:
    """Raise the plain sentence if an operand has another shape than the one it must have."""
    if got != wanted:
        raise ShapeError(f"{type(node).__name__} expects {operand} with shape {wanted}, got {got}", hint=hint)


def expect_square(node: Expr, operand: str, got: Shape, *, stacks: bool = False) -> None:
    """Raise the plain sentence unless the operand is a square matrix, or a stack of them where `stacks` allows it."""
    if len(got) < 2 or got[-1] != got[-2] or (len(got) > 2 and not stacks):
        raise ShapeError(f"{type(node).__name__} expects {operand} to be a square matrix, got shape {got}")


def broadcast(node: Expr, *shapes: Shape) -> Shape:
    """NumPy's broadcast shape, or an error that shows all of them."""
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        listed = " and ".join(map(str, shapes))
        raise ShapeError(
            f"{type(node).__name__} shapes not broadcastable: {listed}",
            hint="index or reshape an operand so that the shapes agree",
        ) from None


class Entrywise(Expr):
    """Base of what works entry by entry, with NumPy's broadcasting where it has several operands."""

    abstract = True
    keeps_order = True

    def infer_shape(self, *shapes: Shape) -> Shape:
        return broadcast(self, *shapes)


def align(*values: Numbers) -> list[Numbers]:
    """Give all values the rank of the highest by leading axes of length 1; scalars stay scalars."""
    rank = max(value.ndim for value in values)
    return [v if v.ndim in (0, rank) else v.reshape((1,) * (rank - v.ndim) + v.shape) for v in values]
