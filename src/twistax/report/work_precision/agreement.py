"""Do all methods find the same answer? Asked before any times are compared."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

from .row import Row

__all__ = ["AGREED", "Doubt", "doubts"]

#: A method agrees with the truth if one of its flights comes this close.
AGREED = 1e-6


@dataclasses.dataclass(frozen=True)
class Doubt:
    """A method that did not come close to the truth of a scene.

    Attributes:
        best: its smallest error.
        falling: whether its error was still falling with finer settings when it was stopped; then it was only not
            run far enough.
    """

    scene: str
    method: str
    best: float
    falling: bool

    @property
    def sentence(self) -> str:
        end = "still falling where it was stopped" if self.falling else "and does not fall: IT DISAGREES"
        return f"{self.method} on {self.scene}: smallest error {self.best:.1e}, {end}"


def doubts(rows: Iterable[Row]) -> list[Doubt]:
    """Methods whose errors do not get below `AGREED`."""
    errors: dict[tuple[str, str], list[tuple[bool, float, float]]] = {}
    for row in rows:
        # From coarse to fine: tolerances fall, numbers of steps grow.
        place = row.setting if row.unit == "steps" else -row.setting
        errors.setdefault((row.scene, row.method), []).append((row.done, place, row.error))
    found = []
    for (scene, method), flights in errors.items():
        reached = [error for done, _, error in sorted(flights, key=lambda flight: flight[1]) if done]
        best = min((error for error in reached if math.isfinite(error)), default=math.inf)
        if best > AGREED:
            found.append(Doubt(scene, method, best, len(reached) > 1 and reached[-1] < 0.5 * reached[-2]))
    return found
