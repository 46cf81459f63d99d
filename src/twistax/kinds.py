"""`tx.kinds`: what a leaf may say of itself, and the rules by which nodes hand it on."""

from .expr.kinds.kinds import FreeVector, Inertia, Kind, Momentum, Point, Pose, Rotation, Twist, Wrench
from .expr.kinds.rules import OPEN, Fixed, Rule
from .expr.kinds.unit import Unit

__all__ = [
    "Fixed",
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
]
