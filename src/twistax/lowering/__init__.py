"""From trees to functions: one expression (`lower`) or a whole system (`compile`)."""

from .dynamics import Dynamics, compile
from .emitters import XLA, Arrays, Emitter
from .explain import Explanation
from .lower import lower
from .scalar.numbering import ValueNumbering

__all__ = ["XLA", "Arrays", "Dynamics", "Emitter", "Explanation", "ValueNumbering", "compile", "lower"]
