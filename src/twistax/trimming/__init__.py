"""Trim: the states, controls and parameters at which a system is in steady motion."""

from .trim import Trim, trim

__all__ = ["Trim", "trim"]
