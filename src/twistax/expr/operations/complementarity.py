"""Products that an optimum drives to zero, and constraints that belong together."""

from __future__ import annotations

import abc
from typing import Any

from .comparisons import Inequality


class Complementarity(Inequality):
    """lhs <= rhs, entry by entry: a product of two quantities that are not negative, at most a relaxation.

    In a `tx.trajectory.Problem` it relates the controls of an interval to the states at the end of it, as a time step
    by the backward Euler method does, and `solve` lowers the relaxation step by step. `tx.trajectory.Contact` makes
    it.

    Attributes:
        lhs: the product.
        rhs: the relaxation, a `Parameter`.

    Raises: ShapeError if the sides do not broadcast.
    """


class ConstraintSet(abc.ABC):
    """Constraints that belong together, such as those of a contact. A system takes it in place of one constraint."""

    @abc.abstractmethod
    def named(self) -> dict[str, Any]:
        """The constraints, by names that follow the name of the set."""
