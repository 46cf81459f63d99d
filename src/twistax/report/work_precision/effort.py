"""How much time a run spends: the full one, and the quick one."""

from __future__ import annotations

import dataclasses

from .ladder import Steps, Tolerances

__all__ = ["FULL", "QUICK", "Effort"]


@dataclasses.dataclass(frozen=True)
class Effort:
    """Settings to run, and how often each flight is repeated.

    Attributes:
        name: for the page.
        tolerances: of methods that choose their steps.
        steps: of methods with equal steps.
        longest: a method is not run finer once one of its flights takes longer, s.
        rounds: how often every flight of a scene is timed in turn, at most.
        least: and at least, however long the flight.
        share: time for all repeats of one flight, s; a longer flight is repeated less often.
    """

    name: str
    tolerances: Tolerances
    steps: Steps
    longest: float
    rounds: int
    least: int
    share: float


FULL = Effort("full", Tolerances(-3, -13, 2), Steps(32, 4), longest=0.5, rounds=31, least=5, share=0.2)
QUICK = Effort("quick", Tolerances(-4, -12, 1), Steps(32, 4), longest=0.1, rounds=9, least=3, share=0.05)
