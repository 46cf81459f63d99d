"""`tx.kinds`: the kinds that a leaf may declare, and the rules by which nodes propagate them."""

from typing import Any

from .expr.kinds.declare import declare
from .expr.kinds.kinds import FreeVector, Inertia, Kind, Momentum, Point, Pose, Rotation, Twist, Wrench
from .expr.kinds.rules import OPEN, FixedUnits, Rule
from .expr.kinds.unit import Unit

__all__ = [
    "FixedUnits",
    "FreeVector",
    "Inertia",
    "Kind",
    "Momentum",
    "OPEN",
    "Point",
    "Pose",
    "Rotation",
    "Rule",
    "Twist",
    "Unit",
    "Wrench",
    "declare",
]


def __getattr__(name: str) -> Any:
    """Say where a name that has changed is now."""
    if name == "Fixed":
        raise AttributeError(
            "tx.kinds.Fixed, the rule of nodes with fixed units, is tx.kinds.FixedUnits.\n  fix: use the new name"
        )
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
