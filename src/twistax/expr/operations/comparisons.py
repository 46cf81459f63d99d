"""Comparisons and constraints, which the operators `<`, `<=`, `==` and others build."""

from __future__ import annotations

import abc
import operator
from typing import Any

import jax.numpy as jnp

from ...errors import ModelError, OperationError
from ..bases import Entrywise
from ..fields import Operand
from ..kinds import rules
from ..leaves import Constant
from ..node import Expr


class Comparison(Entrywise):
    """A relation between two expressions, entry by entry. Its value is boolean: whether each entry holds.

    It is evaluated exactly as written: at a tie, x <= y holds and x < y does not; if a side is NaN, neither holds. It
    has no truth value before it is evaluated.

    Attributes:
        lhs, rhs: both sides, of broadcastable shapes.
    """

    lhs: Operand
    rhs: Operand
    kinds = rules.COMPARISON
    precedence = 5
    abstract = True

    def makes_boolean(self, *operands: bool) -> bool:
        return True

    def to_text(self, *operands: str) -> str:
        return f"{operands[0]} {self.infix} {operands[1]}"

    def __bool__(self) -> bool:
        raise OperationError(
            f"the comparison {self!r} has no truth value.\n"
            "  fix: join conditions by tx.All(a, b), tx.Any(a, b), ~a; chain constraints as a list [a <= x, x <= b]; "
            "choose with tx.Where, tx.Max, tx.Min; compare structure with a.key() == b.key()"
        )


class Constraint(Comparison):
    """A comparison that can be a constraint of an optimisation; the operators `==`, `<=` and `>=` build it.

    Attributes:
        lhs, rhs: both sides, of broadcastable shapes.
    """

    abstract = True

    def residual(self) -> Expr:
        """lhs - rhs: at most 0 for a satisfied inequality, 0 for a satisfied equality."""
        return self.lhs - self.rhs


class Less(Comparison):
    """lhs < rhs, entry by entry; the operators `<` and `>`. A condition, but not a constraint.

    Raises: ShapeError if the sides do not broadcast.
    """

    function = operator.lt
    infix = "<"
    formula = "<0> < <1>"
    kinks = ({"lhs": [0.0, 1.0, 2.0, -1.0], "rhs": Constant(1.0)},)


class Inequality(Constraint):
    """lhs <= rhs, entry by entry.

    Raises: ShapeError if the sides do not broadcast.
    """

    function = operator.le
    infix = "<="
    formula = r"<0> \le <1>"
    kinks = ({"lhs": [0.0, 2.0, -1.0], "rhs": Constant(1.0)},)


class Complementarity(Inequality):
    """lhs <= rhs, entry by entry: a product of two quantities that are not negative, at most a relaxation.

    In a `tx.trajectory.Problem`, it relates the controls of an interval to the states at its end, as a backward Euler
    step does, and `solve` lowers the relaxation successively. `tx.trajectory.Contact` builds it.

    Attributes:
        lhs: the product.
        rhs: the relaxation, a `Parameter`.

    Raises: ShapeError if the sides do not broadcast.
    """


class Equality(Constraint):
    """lhs == rhs, entry by entry.

    Raises: ShapeError if the sides do not broadcast.
    """

    function = jnp.equal
    infix = "=="
    formula = "<0> = <1>"
    kinks = ({"lhs": [0.0, 1.0, -1.0], "rhs": Constant(1.0)},)


class ConstraintSet(abc.ABC):
    """Constraints that belong together, such as those of a contact. A system accepts it in place of a single
    constraint.
    """

    @abc.abstractmethod
    def named(self) -> dict[str, Any]:
        """The constraints, with names that begin with the name of the set."""


def refuse_conditions(what: str, constraint: Any) -> None:
    """Raise an error for a condition where an optimiser requires a constraint.

    Raises: ModelError.
    """
    if isinstance(constraint, Less):
        raise ModelError(
            f"{what} expects a constraint, got the strict comparison {constraint!r}, whose feasible set is open.\n"
            f"  fix: use {Inequality(constraint.lhs, constraint.rhs)!r}; to keep away from the bound, move "
            "it by a margin"
        )
    if isinstance(constraint, Expr) and constraint.boolean and not isinstance(constraint, Constraint):
        raise ModelError(
            f"{what} expects constraints, a <= b or a == b, got the condition {constraint!r}.\n"
            "  fix: pass constraints that must all hold in a list"
        )
