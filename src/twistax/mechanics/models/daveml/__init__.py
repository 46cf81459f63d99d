"""Models in DAVE-ML, the Dynamic Aerospace Vehicle Exchange Markup Language (ANSI/AIAA S-119), as expressions."""

from .model import DaveModel, Signal, load_daveml
from .static_checks import StaticCheck

__all__ = ["DaveModel", "Signal", "StaticCheck", "load_daveml"]
