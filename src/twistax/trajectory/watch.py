"""How runs end, and what is watched meanwhile."""

from __future__ import annotations

import enum
import time

import numpy as np

from .decisions import Opening, Signs

#: How often a run begins anew because multipliers have run away, and how often because no step helps.
_ASTRAY, _LOST = 4, 2
#: Seconds after which Python is to see signals, Ctrl-C among them.
_PATIENCE = 0.2


class Status(enum.Enum):
    """How an optimisation ended, as a sentence."""

    SOLVED = "the first-order conditions of an optimum hold within the tolerance"
    ACCEPTABLE = (
        "the first-order conditions of an optimum hold within a hundred times the tolerance, and no step does better"
    )
    EXCEEDED = "the first-order conditions hold, but between nodes limits are exceeded by more than was asked for"
    COARSE = "the first-order conditions hold on this mesh, but it is too coarse for the path"
    DEGENERATE = (
        "the constraints hold, but one of them has no slope where it binds, so the conditions of an optimum say nothing"
    )
    INFEASIBLE = "no trajectory was found that meets every constraint"
    UNBOUNDED = (
        "the objective improves without end while the constraints hold; most often nothing limits what it pushes"
    )
    MAX_ITERATIONS = "the iterations ran out before the first-order conditions held"
    OUT_OF_TIME = "the time ran out before the first-order conditions held"
    STALLED = "the search found nothing better, but the first-order conditions do not hold"
    NON_FINITE = "the problem has values or slopes that are not finite"

    def __str__(self) -> str:
        return f"{self.name}: {self.value}"


#: Statuses of points where the first-order conditions hold on the mesh, some in numbers alone.
AT_OPTIMUM = (Status.SOLVED, Status.EXCEEDED, Status.ACCEPTABLE, Status.COARSE, Status.DEGENERATE)


class Watch:
    """Watches one run.

    Args:
        most: iterations it may take.
        count, restarts: of these, and of ways begun anew, those so far.

    Attributes:
        count: iterations so far.
        restarts: how often the run has begun anew because multipliers had run away, and because no step helped.
    """

    def __init__(self, tolerance: float, most: int, count: int = 0, restarts: tuple[int, int] = (0, 0)) -> None:
        self._tolerance, self._most = tolerance, most
        self.count, self.restarts = count, restarts
        self._looked = count, time.perf_counter()

    def until(self) -> int:
        """How many steps may be taken without a look at signals: as long as the last ones took."""
        (before, then), self._looked = self._looked, (self.count, time.perf_counter())
        pace = (self.count - before) / max(self._looked[1] - then, 1e-9)
        return min(self._most - self.count, max(1, int(_PATIENCE * pace)))

    def astray(self, signs: Signs) -> bool:
        """Whether multipliers have run away, and the run may begin anew."""
        return bool(signs.away) and self.restarts[0] < _ASTRAY and not bool(signs.near)

    def lost(self, status: Status) -> bool:
        """Whether a run that comes to rest so may begin anew, while there are steps left."""
        return status is Status.STALLED and self.hasty and self.count < self._most

    def again(self, astray: bool) -> None:
        """Count a run that begins anew, because multipliers had run away or because no step helped."""
        self.restarts = self.restarts[0] + astray, self.restarts[1] + (not astray)

    @property
    def hasty(self) -> bool:
        """Whether a search for feasible points that creeps is left; later ones may need steps for a certificate."""
        return self.restarts[1] < _LOST

    def at_once(self, opening: Opening) -> Status | None:
        """How it ends before the first step."""
        if not bool(opening.finite):
            return Status.NON_FINITE
        return Status.INFEASIBLE if float(opening.decided) > self._tolerance else None

    def ended(self, signs: Signs) -> Status | None:
        """How a measured state in good scales ends the run, if it does."""
        if signs.error <= self._tolerance:
            return Status.INFEASIBLE if signs.pinned > 10.0 * self._tolerance else Status.SOLVED
        if not np.isfinite(signs.error):
            return Status.NON_FINITE
        if bool(signs.far) and bool(signs.holds):
            return Status.UNBOUNDED
        return Status.MAX_ITERATIONS if self.count >= self._most else None
