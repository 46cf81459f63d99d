"""Options of `tx.Interp`: the interpolation between points, and the extrapolation."""

from .kinds import BSpline, Clamped, Extrapolated, Linear, MonotoneCubic, Refused

__all__ = ["BSpline", "Clamped", "Extrapolated", "Linear", "MonotoneCubic", "Refused"]
