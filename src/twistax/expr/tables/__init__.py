"""How `tx.Interp` reads a table: between its points, and outside."""

from .kinds import BSpline, Clamped, Extrapolated, Linear, MonotoneCubic, Refused

__all__ = ["BSpline", "Clamped", "Extrapolated", "Linear", "MonotoneCubic", "Refused"]
