"""Monte Carlo simulation: one function for many members, in chunks over all devices, resumable from disk, with failures
by member.
"""

from .sweeps import Statistics, Sweep, sweep

__all__ = ["Statistics", "Sweep", "sweep"]
