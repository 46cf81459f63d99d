"""The status of a solve."""

from __future__ import annotations

import enum
from typing import Any


class Status(enum.Enum):
    """The status of an optimisation. Each member has a sentence that explains it."""

    SOLVED = "the first-order conditions of an optimum hold within the tolerance"
    ACCEPTABLE = (
        "the first-order conditions of an optimum hold within a hundred times the tolerance, and no step improves them"
    )
    EXCEEDED = "the first-order conditions hold, but limits are exceeded between nodes by more than `between`"
    COARSE = "the first-order conditions hold on this mesh, but it is too coarse for the path"
    DEGENERATE = (
        "the constraints hold, but an active one has zero derivatives, so the optimality conditions are not meaningful"
    )
    INFEASIBLE = "no trajectory was found that satisfies every constraint"
    UNBOUNDED = "the objective improves without limit while the constraints hold; most often a limit is missing"
    MAX_ITERATIONS = "the solve reached max_iterations before the first-order conditions held"
    OUT_OF_TIME = "the solve reached max_seconds before the first-order conditions held"
    STOPPED = "the callback ended the solve before the first-order conditions held"
    STALLED = "the solver made no progress, but the first-order conditions do not hold"
    NON_FINITE = "values or derivatives of the problem are not finite"
    REFUSED = "the arguments of this case are invalid, so it was not solved"

    def __str__(self) -> str:
        return f"{self.name}: {self.value}"

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickles and copies use the name, because the sentences may change between versions."""
        return getattr, (type(self), self.name)


#: Statuses of points at which the first-order conditions hold on the mesh, in some cases only numerically.
AT_OPTIMUM = (Status.SOLVED, Status.EXCEEDED, Status.ACCEPTABLE, Status.COARSE, Status.DEGENERATE)
