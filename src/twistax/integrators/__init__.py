"""Integration on groups: tableaus, charts, the stage loop, controls over time, fixed-step flights."""

from .commutator_free import CF4, CommutatorFree, CommutatorFreeTableau
from .controls import FirstOrderHold, Table, ZeroOrderHold
from .events import Event
from .implicit import CollocationTableau, ImplicitRKMK
from .integrate import integrate
from .magnus import Magnus
from .method import Method
from .result import Result
from .rkmk import RKMK
from .solution import Solution, Stats
from .step_control import StepControl
from .tableau import ButcherTableau

__all__ = [
    "CF4",
    "RKMK",
    "ButcherTableau",
    "CollocationTableau",
    "CommutatorFree",
    "CommutatorFreeTableau",
    "Event",
    "ZeroOrderHold",
    "ImplicitRKMK",
    "FirstOrderHold",
    "Magnus",
    "Method",
    "Result",
    "Solution",
    "Stats",
    "StepControl",
    "Table",
    "integrate",
]
