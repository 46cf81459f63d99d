"""Integration on groups: tableaus, charts, the stage loop, controls over time, fixed-step flights."""

from .controls import Held, Linear, Table
from .integrate import integrate
from .method import Method
from .rkmk import RKMK
from .solution import Result, Solution, Stats
from .tableau import ButcherTableau

__all__ = [
    "RKMK",
    "ButcherTableau",
    "Held",
    "Linear",
    "Method",
    "Result",
    "Solution",
    "Stats",
    "Table",
    "integrate",
]
