"""Mechanisms and vehicles from model files."""

from .daveml import DaveModel, Signal, StaticCheck, load_daveml
from .load import load

__all__ = ["DaveModel", "Signal", "StaticCheck", "load", "load_daveml"]
