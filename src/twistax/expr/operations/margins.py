"""Conditions as numbers that cross zero where the truth value changes."""

from __future__ import annotations

from ...errors import ModelError
from ..node import Expr
from .arithmetic import Neg
from .choice import All, Any, Max, Min, Not
from .comparisons import Inequality, Less


def margin(what: str, condition: Expr) -> Expr:
    """A number that is negative if a condition of shape () holds, and positive if it does not.

    For a <= b and a < b it is a - b; for All the largest margin of the operands, for Any the smallest, for Not the
    negative.

    Raises:
        ModelError: a part that is not a comparison by < or <=, so that its truth is not determined by a sign.
    """
    if isinstance(condition, (Less, Inequality)):
        return condition.lhs - condition.rhs
    if isinstance(condition, Not) and isinstance(condition.condition, (Less, Inequality)):
        return condition.condition.rhs - condition.condition.lhs
    if isinstance(condition, Not):
        return Neg(margin(what, condition.condition))
    if isinstance(condition, (All, Any)):
        entries = [entry for predicate in condition.predicates for entry in _entries(margin(what, predicate))]
        joined = Max if isinstance(condition, All) else Min
        return joined(*entries) if len(entries) > 1 else entries[0]
    raise ModelError(
        f"{what} expects an expression whose root is the event, or comparisons by < and <=, got the condition "
        f"{condition!r}.\n"
        "  fix: pass the expression, e.g. a - b for a == b"
    )


def _entries(numbers: Expr) -> list[Expr]:
    return [entry for part in numbers for entry in _entries(part)] if numbers.ndim else [numbers]
