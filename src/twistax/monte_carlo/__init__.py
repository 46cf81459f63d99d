"""Monte Carlo: one function of many members, in chunks over all devices, resumable from disk, failures by number."""

from .sweeps import Statistics, Sweep, sweep

__all__ = ["Statistics", "Sweep", "sweep"]
