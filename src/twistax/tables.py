"""How `tx.Interp` reads a table: between its points, and outside."""

from .expr.table_kinds import BSpline, Clamped, Extrapolated, Linear, MonotoneCubic, Refused

__all__ = ["BSpline", "Clamped", "Extrapolated", "Linear", "MonotoneCubic", "Refused"]
