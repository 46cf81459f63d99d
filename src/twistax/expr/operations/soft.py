"""Soft constraints, which may be violated at a penalty."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeAlias

import numpy as np

from ...errors import ModelError, ShapeError
from ..leaves import Constant
from ..matrices.linalg import Sum
from ..node import Expr, to_expr
from .comparisons import Constraint, ConstraintSet, refuse_conditions


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Soft:
    r"""A constraint that a trajectory may violate at a penalty.

    With $r$ = lhs - rhs, the violation is s = max(r, 0) for an inequality and s = |r| for an equality, entry by entry.
    The penalty $\sum l_1 s + l_2 s^2$ is added to the objective to minimise; along the path, its integral over time.
    Use it like a constraint: in the `constraints` of a `System`, and in `initial`, `final` and `at` of a problem.

    If `l1` is larger than the multiplier of the hard constraint, the optimum is unchanged (an exact penalty). With `l2`
    alone, an active constraint is always violated, by the multiplier divided by 2 `l2`.
    Source: Nocedal and Wright, Numerical Optimization (2006), (17.22) and Theorem 17.3.

    Example: `tx.System(rates={p: v, v: u}, constraints={"speed": tx.Soft(v <= 0.8, l1=100.0)})`.

    Attributes:
        constraint: of any shape.
        l1, l2: the weights, expressions: scalars or of the shape of the constraint, not negative; None for no weight. A
            weight that is a parameter can be changed by `params` of each solve.

    Raises:
        ModelError: the operand is not a constraint; there is no weight, or a negative one.
        ShapeError: a weight of another shape.
    """

    constraint: Constraint
    l1: Expr | None
    l2: Expr | None

    def __init__(self, constraint: Any, *, l1: Any = None, l2: Any = None) -> None:
        refuse_conditions("Soft", constraint)
        if not isinstance(constraint, Constraint):
            raise ModelError(f"Soft expects a constraint, a <= b or a == b, got {type(constraint).__name__}")
        if l1 is None and l2 is None:
            raise ModelError(f"Soft expects at least one weight, l1= or l2=, for {constraint!r}")
        object.__setattr__(self, "constraint", constraint)
        for name, weight in (("l1", l1), ("l2", l2)):
            object.__setattr__(self, name, None if weight is None else _weight(name, weight, constraint))

    def __repr__(self) -> str:
        weights = [f"{name}={weight!r}" for name, weight in (("l1", self.l1), ("l2", self.l2)) if weight is not None]
        return f"Soft({', '.join([repr(self.constraint), *weights])})"

    def price(self, size: Expr) -> Expr:
        """The penalty of a violation, entry by entry."""
        parts = [] if self.l1 is None else [self.l1 * size]
        parts += [] if self.l2 is None else [self.l2 * size * size]
        total = parts[0] if len(parts) == 1 else parts[0] + parts[1]
        return total if total.shape == () else Sum(total)


#: What a system, or a node of a trajectory, may be asked to hold.
Asked: TypeAlias = Constraint | Soft | ConstraintSet


def hard(constraint: Any) -> Any:
    """The constraint without its penalty."""
    return constraint.constraint if isinstance(constraint, Soft) else constraint


def parts_of(constraint: Asked) -> list[Expr]:
    """The expressions of a constraint and of its weights."""
    weights = [constraint.l1, constraint.l2] if isinstance(constraint, Soft) else []
    return [hard(constraint), *(weight for weight in weights if weight is not None)]


def _weight(name: str, value: Any, constraint: Constraint) -> Expr:
    try:
        weight = to_expr(value)
    except ModelError as error:
        raise ModelError(f"Soft: {name} expects a number or an expression: {error}") from None
    shape = constraint.residual().check_shape()
    if weight.shape not in ((), shape):
        raise ShapeError(f"Soft: {name} expects shape () or that of the constraint {shape}, got {weight.shape}")
    if isinstance(weight, Constant) and not (np.isfinite(weight.value) & (weight.value >= 0.0)).all():
        raise ModelError(f"Soft: {name} expects finite numbers of 0 or more, got {weight!r}")
    return weight
