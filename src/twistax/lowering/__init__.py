"""From trees to functions: one expression (`lower`) or a whole system (`compile`)."""

from .dynamics import Dynamics, compile
from .explain import Explanation
from .lower import lower

__all__ = ["Dynamics", "Explanation", "compile", "lower"]
