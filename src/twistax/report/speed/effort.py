"""How much time a run spends: the full one, and the quick one."""

from __future__ import annotations

import dataclasses

__all__ = ["FULL", "QUICK", "Effort"]


@dataclasses.dataclass(frozen=True)
class Effort:
    """What is run, and how often it is repeated.

    Attributes:
        name: for the page.
        cases, quantities: names of those that are run if none is asked for; empty for all.
        largest: batches of more points are left out.
        longest: a call that takes longer, s, is timed once only; left out if a smaller batch says so before.
        patience: where compiling takes longer, s, further uses of the same are left out.
        rounds: how often every call of a group is timed in turn, at most.
        least: and at least, however long the call.
        share: time for all repeats of one call, s; a longer one is repeated less often.
    """

    name: str
    cases: tuple[str, ...]
    quantities: tuple[str, ...]
    largest: int
    longest: float
    patience: float
    rounds: int
    least: int
    share: float


FULL = Effort("full", (), (), 65536, longest=20.0, patience=150.0, rounds=41, least=5, share=1.0)
QUICK = Effort(
    "quick", ("free-body", "aba-7"), ("value",), 4096, longest=1.0, patience=60.0, rounds=15, least=3, share=0.1
)
