"""How an integration ended."""

from __future__ import annotations

import enum

__all__ = ["Result"]


class Result(enum.IntEnum):
    """How an integration ended; `sentence` says it in words. SUCCESS and EVENT are no failures."""

    SUCCESS = 0
    NON_FINITE = 1
    MAX_STEPS = 2
    STEP_TOO_SMALL = 3
    NEWTON_FAILED = 4
    EVENT = 5

    @property
    def sentence(self) -> str:
        """What happened, in plain words."""
        return _SENTENCES[self]

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


_SENTENCES = {
    Result.SUCCESS: "the end time was reached",
    Result.NON_FINITE: "a state became infinite or not a number",
    Result.MAX_STEPS: "the steps ran out before the end time",
    Result.STEP_TOO_SMALL: "no step is small enough for the tolerances",
    Result.NEWTON_FAILED: "the equations of an implicit step could not be solved",
    Result.EVENT: "an event stopped it",
}
