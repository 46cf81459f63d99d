"""From trees to functions: one expression (`lower`) or a whole system (`compile`)."""

from .dynamics import Dynamics, compile
from .emitters import XLA, Arrays, Emitter
from .explain import Explanation
from .export.loaded import load
from .lower import lower
from .native.emitter import Native

__all__ = [
    "XLA",
    "Arrays",
    "Dynamics",
    "Emitter",
    "Explanation",
    "Native",
    "compile",
    "load",
    "lower",
]
