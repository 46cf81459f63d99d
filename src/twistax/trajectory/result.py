"""What an optimisation gives back."""

from __future__ import annotations

import dataclasses
import enum
from typing import TYPE_CHECKING, Any

from .arrays import Array

if TYPE_CHECKING:
    from .problem import Problem
    from .replay import Replay

__all__ = ["Status", "TrajectoryResult"]


class Status(enum.Enum):
    """How an optimisation ended, as a sentence."""

    SOLVED = "every constraint holds within the tolerance and the objective has settled"
    MAX_ITERATIONS = "the iterations ran out before every constraint held and the objective settled"
    INFEASIBLE = "no trajectory was found that meets every constraint"
    NON_FINITE = "the problem has values that are not finite at the guess"

    def __str__(self) -> str:
        return f"{self.name}: {self.value}"


@dataclasses.dataclass(frozen=True)
class TrajectoryResult:
    """A trajectory and how well it solves its problem. All arrays are NumPy, double precision.

    Attributes:
        xs: states by name, leading axis the nodes.
        us: controls by name, leading axis the intervals; held over each.
        ts: (nodes,) times in s.
        final_time: the last of them.
        cost: the objective as stated (a maximum is not negated).
        violation: the largest violation of a constraint, each measured in its own scale; 0 where all hold.
        violations: row name -> largest violation in the constraint's own unit, all rows of the problem.
        status: how it ended; `message` says it in one sentence, and which constraint is worst and where.
        iterations: evaluations of the problem in the try that gave this result.
        tries: one line (status, cost, violation, iterations) for every guess.
        compile_seconds, solve_seconds: wall time.
    """

    problem: Problem
    xs: dict[str, Array]
    us: dict[str, Array]
    ts: Array
    final_time: float
    cost: float
    violation: float
    violations: dict[str, float]
    status: Status
    message: str
    iterations: int
    tries: tuple[tuple[Status, float, float, int], ...]
    compile_seconds: float
    solve_seconds: float

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED

    def replay(self, method: Any = None, steps: int | None = None, **tolerances: float) -> Replay:
        """Fly the found controls from the first node and measure what comes out. See `Replay` and `replay`."""
        from .replay import replay

        return replay(self, method, steps, **tolerances)

    def __repr__(self) -> str:
        return (
            f"TrajectoryResult({self.message} cost={self.cost:.6g}, violation={self.violation:.1e}, "
            f"final_time={self.final_time:.6g}, iterations={self.iterations}, "
            f"compile {self.compile_seconds:.1f} s, solve {self.solve_seconds:.1f} s)"
        )
