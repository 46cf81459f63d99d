"""How each JAX primitive acts on arrays of scalars, family by family."""

from .contraction import CONTRACTION
from .elementwise import ELEMENTWISE
from .linear_algebra import LINEAR_ALGEBRA
from .movement import MOVEMENT
from .rule import Rule

__all__ = ["RULES"]

#: By the name of the primitive. A rule that returns None leaves the equation to be called as it is.
RULES: dict[str, Rule] = {**ELEMENTWISE, **MOVEMENT, **CONTRACTION, **LINEAR_ALGEBRA}
