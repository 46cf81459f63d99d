"""What an optimisation gives back."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from .optimizer import Outcome, Status

if TYPE_CHECKING:
    from .problem import Problem
    from .replay import Replay

__all__ = ["TrajectoryResult", "best_result", "largest_by_name"]


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
        """Roll out the found controls from the first node and measure what comes out. See `Replay` and `replay`."""
        from .replay import replay

        return replay(self, method, steps, **tolerances)

    def __repr__(self) -> str:
        return (
            f"TrajectoryResult({self.message} cost={self.cost:.6g}, violation={self.violation:.1e}, "
            f"final_time={self.final_time:.6g}, iterations={self.iterations}, "
            f"compile {self.compile_seconds:.1f} s, solve {self.solve_seconds:.1f} s)"
        )


def best_result(
    problem: Problem, outcomes: Sequence[Outcome], tolerance: float, compile_seconds: float, solve_seconds: float
) -> TrajectoryResult:
    """The best of several tries: a solved one of least cost, else the one that violates least."""
    sign = problem.objective.sign
    statuses = [outcome.status for outcome in outcomes]
    costs = [float(outcome.evaluation.cost) for outcome in outcomes]
    violations = [float(outcome.violations.max(initial=0.0)) for outcome in outcomes]

    def rank(number: int) -> tuple[bool, bool, float]:
        solved = statuses[number] is Status.SOLVED
        return not solved, statuses[number] is Status.NON_FINITE, costs[number] if solved else violations[number]

    best = min(range(len(outcomes)), key=rank)
    outcome, iterate = outcomes[best], outcomes[best].evaluation.iterate
    final_time = float(iterate.final_time)
    return TrajectoryResult(
        problem=problem,
        xs={name: np.asarray(values) for name, values in iterate.xs.items()},
        us=problem.transcription.controls.split(np.asarray(iterate.us)),
        ts=np.linspace(0.0, final_time, problem.nodes),
        final_time=final_time,
        cost=sign * costs[best],
        violation=violations[best],
        violations=_violations(problem, outcome),
        status=statuses[best],
        message=_message(problem, statuses[best], outcome, tolerance),
        iterations=outcome.iterations,
        tries=tuple((s, sign * c, v, o.iterations) for s, c, v, o in zip(statuses, costs, violations, outcomes)),
        compile_seconds=compile_seconds,
        solve_seconds=solve_seconds,
    )


def largest_by_name(names: Sequence[str], sizes: Array) -> dict[str, float]:
    """The largest size of each name; names may repeat."""
    found: dict[str, float] = {}
    for name, size in zip(names, sizes):
        found[name] = max(found.get(name, 0.0), float(size))
    return found


def _violations(problem: Problem, outcome: Outcome) -> dict[str, float]:
    """In the constraints' own units."""
    t, rows = problem.transcription, np.asarray(outcome.evaluation.rows)
    sizes = np.where(t.exists, np.where(t.equality, np.abs(rows), np.maximum(rows, 0.0)), 0.0)
    return largest_by_name(t.names, sizes.max(axis=0))


def _message(problem: Problem, status: Status, outcome: Outcome, tolerance: float) -> str:
    """The status, and where it is no success the worst constraint and the worst break of the dynamics."""
    t, rows = problem.transcription, np.asarray(outcome.evaluation.rows)
    worst = []
    for first, last in ((t.n, len(t.names)), (0, t.n)):
        scaled = outcome.violations[:, first:last]
        if scaled.max(initial=0.0) > tolerance:
            interval, row = divmod(int(scaled.argmax()), scaled.shape[1])
            row += first
            worst.append(f"{t.names[row]!r} {t.place(interval, row)} is off by {abs(rows[interval, row]):.3g}")
    return f"{status}. Worst: {'; '.join(worst)}." if worst else f"{status}."
