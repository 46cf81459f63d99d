"""What is decided between the steps of a run: new scales, or its end. One run at a time, or each of a batch."""

from __future__ import annotations

import enum
import time
from typing import Any

import numpy as np
from numpy import ndarray as Array

from . import scaling
from .descent import Descent
from .iterate import Scales
from .iterate import State as Iterate
from .stride import AWAY
from .transcribed import Derivatives, Transcribed

#: Scales are renewed once they are off by this factor. A result stands in scales that are not.
RENEW = 3.0
#: What was begun in scales that are off by this factor is worth nothing.
_WORTHLESS = 1e3
#: How often a run begins anew because multipliers have run away.
_RESTARTS = 4
#: Iterations after which scales are looked at, beside those at which the barrier parameter falls.
_EARLY = (1, 3, 6)
#: Seconds after which Python is to see signals, Ctrl-C among them.
_PATIENCE = 0.2
#: An unknown that is so many times as large as at the start has lost all digits of it, and has run off; where it is so
#: many times as large, scales are looked at again and again.
_FAR, _NEAR = 1e16, 1e5
#: Where a solution stands in scales that are so many times too large, for they were once, these are forgotten.
_INFLATED = 10.0


class Status(enum.Enum):
    """How an optimisation ended, as a sentence."""

    SOLVED = "the first-order conditions of an optimum hold within the tolerance"
    ACCEPTABLE = (
        "the first-order conditions of an optimum hold within a hundred times the tolerance, and no step does better"
    )
    EXCEEDED = "the first-order conditions hold, but between nodes limits are exceeded by more than was asked for"
    COARSE = "the first-order conditions hold, but the mesh could not be refined to what was asked for"
    INFEASIBLE = "no trajectory was found that meets every constraint"
    UNBOUNDED = (
        "the objective improves without end while the constraints hold; most often nothing limits what it pushes"
    )
    MAX_ITERATIONS = "the iterations ran out before the first-order conditions held"
    OUT_OF_TIME = "the time ran out before the first-order conditions held"
    STALLED = "no step improves the trajectory, but the first-order conditions do not hold"
    NON_FINITE = "the problem has values or slopes that are not finite"

    def __str__(self) -> str:
        return f"{self.name}: {self.value}"


class Watch:
    """Watches one run.

    Args:
        seen: the largest scales seen at its start.
        most: iterations it may take.

    Attributes:
        count: iterations so far.
        restarts: how often multipliers have run away.
    """

    def __init__(
        self,
        shooting: Transcribed,
        tolerance: float,
        seen: Scales,
        most: int,
    ) -> None:
        self._shooting, self._tolerance = shooting, tolerance
        self._first = self._seen = seen
        self._most, self._forgot = most, False
        self.count = self.restarts = 0
        self._looked = 0, time.perf_counter()

    def until(self) -> int:
        """How many steps may be taken without a look at them, or at signals: as long as the last ones took."""
        (before, then), self._looked = self._looked, (self.count, time.perf_counter())
        pace = (self.count - before) / max(self._looked[1] - then, 1e-9)
        free = min(k for k in (*_EARLY, self._most) if k > self.count) - self.count
        return min(free, max(1, int(_PATIENCE * pace)))

    @property
    def low(self) -> float:
        """The objective that runs do not fall below unless they seem to have no end."""
        return self._descent.low(_NEAR)

    def at_once(self, state: Iterate) -> Status | None:
        """How it ends before the first step."""
        if not all(np.isfinite(np.asarray(a)).all() for a in (*state.scales, *state.values)):
            return Status.NON_FINITE
        shooting = self._shooting
        self._descent = Descent(shooting, state)
        lost = np.where(shooting.decided & ~shooting.pinned, row_violations(shooting, state), 0.0)
        return Status.INFEASIBLE if lost.max(initial=0.0) > self._tolerance else None

    def anew(self, seen: Scales) -> None:
        """A run goes on from another start, where these are the largest scales seen."""
        self._first = self._seen = seen

    def renewed(self, state: Iterate, slopes: Derivatives, before: float) -> Scales | None:
        """New scales for a measured state, where its own are off.

        Args:
            before: the barrier parameter before the state was measured; infinite after a search for feasible points.
        """
        there = error(state) <= self._tolerance
        due = there or self.count in _EARLY or float(state.barrier) < before
        if not due and not self._descent.beyond(state, _NEAR):
            return None
        measured, sloped = scaling.measured(self._shooting, state.point, slopes, state.scales)
        fresh, seen = scaling.not_below(measured, self._seen, sloped)
        if there and not self._forgot and self._descent.inflated(state._replace(scales=fresh), _INFLATED):
            self._forgot = True
            fresh, seen = scaling.not_below(measured, self._first, sloped)
        self._seen = seen
        return fresh if scaling.change(fresh, state.scales) > RENEW else None

    def misled(self, state: Iterate, fresh: Scales) -> bool:
        """Whether a run in its first steps began in scales so far from fresh ones that it does better to begin anew."""
        return 0 < self.count <= max(_EARLY) and scaling.change(fresh, state.scales) > _WORTHLESS

    def astray(self, state: Iterate) -> bool:
        """Whether multipliers have run away, and the run should begin anew.

        They do where many steps in a row need a large diagonal: it adds to them, they add to the second derivatives,
        and these ask for a larger one.
        """
        largest = max(float(np.abs(a).max(initial=0.0)) for a in (state.dynamics, state.rows))
        away = largest > AWAY and self.restarts < _RESTARTS and not self._descent.beyond(state, _NEAR)
        self.restarts += away
        return away

    def runs_off(self, state: Iterate) -> bool:
        """Whether it seems to have no end; a feasible point from there tells."""
        return self._descent.beyond(state, _FAR)

    def _holds(self, state: Iterate) -> bool:
        """Whether every constraint does, in scales without memory."""
        lost = np.where(self._shooting.exists, row_violations(self._shooting, state), 0.0).max(initial=0.0)
        return max(float(lost), self._descent.gaps(state)) <= self._tolerance

    def ended(self, state: Iterate) -> Status | None:
        """How a measured state in good scales ends the run, if it does."""
        size = error(state)
        if size <= self._tolerance:
            pinned = np.where(self._shooting.pinned, row_violations(self._shooting, state), 0.0)
            return Status.INFEASIBLE if pinned.max(initial=0.0) > 10.0 * self._tolerance else Status.SOLVED
        if not np.isfinite(size):
            return Status.NON_FINITE
        if self.runs_off(state) and self._holds(state):
            return Status.UNBOUNDED
        return Status.MAX_ITERATIONS if self.count >= self._most else None


def error(state: Iterate) -> float:
    """The largest of what SOLVED asks for."""
    return max(float(e) for e in (state.errors.stationarity, state.errors.feasibility, state.errors.gap))


def row_violations(shooting: Transcribed, state: Any) -> Array:
    """Scaled, of all rows."""
    rows = np.asarray(state.values.rows) / np.asarray(state.scales.rows)
    return np.where(shooting.equality, np.abs(rows), np.maximum(rows, 0.0))
