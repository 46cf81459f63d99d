"""Do all methods find the same answer? Asked before any times are compared."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

from .row import Row

__all__ = ["AGREED", "Doubt", "doubts"]

#: A method agrees with the truth if one of its flights comes this close.
AGREED = 1e-6
#: Or if its finest flight comes within so many of its tolerances: then it was only not run finer.
_TOLERANCES = 100.0


@dataclasses.dataclass(frozen=True)
class Doubt:
    """A method that did not come close to the truth of a scene.

    Attributes:
        best: its smallest error; infinite where it finished no flight with a finite one.
        excuse: why that need not mean that it disagrees; empty where there is none.
    """

    scene: str
    method: str
    best: float
    excuse: str

    @property
    def disagrees(self) -> bool:
        return not self.excuse

    @property
    def sentence(self) -> str:
        best = f"smallest error {self.best:.1e}, " if math.isfinite(self.best) else ""
        return f"{self.method} on {self.scene}: {best}{self.excuse or 'and does not fall: IT DISAGREES'}"


def doubts(rows: Iterable[Row]) -> list[Doubt]:
    """Methods whose errors do not get below `AGREED`."""
    flights: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        flights.setdefault((row.scene, row.method), []).append(row)
    found = []
    for (scene, method), own in flights.items():
        # From coarse to fine: tolerances fall, numbers of steps grow.
        done = [row for row in sorted(own, key=lambda r: r.setting if r.unit == "steps" else -r.setting) if row.done]
        best = min((row.error for row in done if math.isfinite(row.error)), default=math.inf)
        if best > AGREED:
            found.append(Doubt(scene, method, best, _excuse(done)))
    return found


def _excuse(done: list[Row]) -> str:
    if not done:
        return "none of its flights was finished"
    last = done[-1]
    if len(done) > 1 and last.error < 0.5 * done[-2].error:
        return "still falling where it was stopped"
    if last.unit == "tolerance" and last.error <= _TOLERANCES * last.setting:
        return "as close as its tolerance asks where it was stopped"
    return ""
