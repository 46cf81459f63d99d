"""Constraints: what `==`, `<=` and `>=` build. They have no truth value before they are evaluated."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from .fields import Operand
from .leaves import Constant
from .node import Expr
from .shapes import Entrywise, align


class Constraint(Entrywise):
    """A relation between two expressions, entry by entry.

    As an expression its value is boolean: which entries hold. An optimiser uses `residual()`.

    Attributes:
        lhs, rhs: both sides, of broadcastable shapes.
    """

    lhs: Operand
    rhs: Operand
    precedence = 5
    abstract = True
    latex_symbol: ClassVar[str] = "?"

    @property
    def boolean(self) -> bool:
        return True

    def residual(self) -> Expr:
        """lhs - rhs, of which the optimiser wants <= 0 (inequality) or = 0 (equality)."""
        return self.lhs - self.rhs

    def simplify(self) -> Expr:
        """Bring everything to the left: lhs - rhs (<= or =) 0."""
        if isinstance(self.rhs, Constant) and not self.rhs.value.any() and self.lhs.shape == self.shape:
            return self if self.rhs.shape == () else type(self)(self.lhs, 0.0)
        return type(self)(self.residual(), 0.0)

    def to_text(self, *operands: str) -> str:
        return f"{operands[0]} {self.infix} {operands[1]}"

    def to_latex(self, *operands: str) -> str:
        return f"{operands[0]} {self.latex_symbol} {operands[1]}"

    def __bool__(self) -> bool:
        raise TypeError(
            f"the constraint {self!r} has no truth value.\n"
            "  fix: chain constraints as a list [a <= x, x <= b]; choose with tx.Where; "
            "compare structure with a.key() == b.key()"
        )


class Inequality(Constraint):
    """lhs <= rhs, entry by entry.

    Raises:
        ShapeError: the sides do not broadcast.
    """

    infix = "<="
    kinks = ({"lhs": [0.0, 2.0, -1.0], "rhs": Constant(1.0)},)
    latex_symbol = r"\le"

    def evaluate(self, *values: jax.Array) -> jax.Array:
        left, right = align(*values)
        return left <= right


class Equality(Constraint):
    """lhs == rhs, entry by entry.

    Raises:
        ShapeError: the sides do not broadcast.
    """

    infix = "=="
    kinks = ({"lhs": [0.0, 1.0, -1.0], "rhs": Constant(1.0)},)
    latex_symbol = "="

    def evaluate(self, *values: jax.Array) -> jax.Array:
        left, right = align(*values)
        return jnp.equal(left, right)
