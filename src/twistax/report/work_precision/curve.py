"""Error against time as a curve, and the time at an error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

from .row import Row

__all__ = ["Curve"]

#: Errors below this are round-off, and have a logarithm.
_ROUND_OFF = 1e-16


@dataclasses.dataclass(frozen=True)
class Curve:
    """The best of a line's flights: each takes longer than the one before and is more accurate.

    Attributes:
        rows: those flights, from the fastest to the most accurate.
    """

    rows: tuple[Row, ...]

    @classmethod
    def of(cls, rows: Iterable[Row]) -> Curve:
        """The front of some rows; those without a time or an error are left out."""
        timed = [row for row in rows if row.done and math.isfinite(row.error) and math.isfinite(row.seconds)]
        front: list[Row] = []
        for row in sorted(timed, key=lambda row: (row.seconds, row.error)):
            if not front or row.error < front[-1].error:
                front.append(row)
        return cls(tuple(front))

    def time_at(self, error: float) -> float:
        """Seconds for an error, on straight lines between the flights in logarithms of both.

        Of an error that the fastest flight undercuts it is the time of that flight. Not a number where no flight is
        accurate enough: nothing is extrapolated.
        """
        for number, row in enumerate(self.rows):
            if row.error <= error:
                return row.seconds if number == 0 else _between(self.rows[number - 1], row, error)
        return math.nan

    def row_at(self, error: float) -> Row | None:
        """The fastest flight that is accurate enough."""
        return next((row for row in self.rows if row.error <= error), None)


def _between(coarse: Row, fine: Row, error: float) -> float:
    high, low, at = (math.log(max(value, _ROUND_OFF)) for value in (coarse.error, fine.error, error))
    if high == low:
        return fine.seconds
    share = (high - at) / (high - low)
    return math.exp((1.0 - share) * math.log(coarse.seconds) + share * math.log(fine.seconds))
