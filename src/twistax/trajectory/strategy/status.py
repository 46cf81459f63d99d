"""The status of a solve."""

from __future__ import annotations

import enum
from typing import Any


class Status(enum.Enum):
    """The status of an optimisation. Each member has a sentence that explains it."""

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
    STOPPED = "the callback ended the search before the first-order conditions held"
    STALLED = "the search found nothing better, but the first-order conditions do not hold"
    NON_FINITE = "the problem has values or slopes that are not finite"
    REFUSED = "the arguments of this case do not fit the problem, so it was not solved"

    def __str__(self) -> str:
        return f"{self.name}: {self.value}"

    def __reduce_ex__(self, protocol: Any) -> Any:
        """By name, in pickles and copies: sentences change."""
        return getattr, (type(self), self.name)


#: Statuses of points where the first-order conditions hold on the mesh, some in numbers alone.
AT_OPTIMUM = (Status.SOLVED, Status.EXCEEDED, Status.ACCEPTABLE, Status.COARSE, Status.DEGENERATE)
