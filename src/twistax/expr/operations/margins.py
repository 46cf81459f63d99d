"""Conditions as numbers that become zero where they begin or cease to hold."""

from __future__ import annotations

from ...errors import ModelError
from ..node import Expr
from .arithmetic import Neg
from .choice import All, Any, Max, Min, Not
from .comparisons import Inequality, Less


def margin(what: str, condition: Expr) -> Expr:
    """A number that is negative where a condition of shape () holds, positive where it does not.

    Of a <= b and a < b it is a - b; of all conditions the largest of theirs, of any the smallest, of not the negative.

    Raises:
        ModelError: of a part that is no comparison by < or <=, whose truth no sign tells.
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
