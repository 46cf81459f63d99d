"""What an optimisation of several phases gives back."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from ..precision import in_double
from .replay import Replay
from .result import (
    Optimality,
    Trajectory,
    active_of,
    best_of,
    explained,
    found_params,
    multipliers_of,
    trajectory_at,
    violations_of,
)
from .solver import Outcome
from .transcribed import Values
from .watch import Status

if TYPE_CHECKING:
    from .phases import PhasedProblem


@dataclasses.dataclass(frozen=True)
class PhasedResult:
    """Trajectories of phases, and how well they solve their problem. Names have the phase's in front.

    Attributes:
        phases: the trajectory of each, with `xs`, `us`, `ts`, `replay()`; times go on from phase to phase.
        final_time: when the last phase ends, s.
        durations: how long each phase takes, s.
        cost, violation, violations, optimality, multipliers, active, status, message, iterations, tries, params,
            compile_seconds, solve_seconds: see `TrajectoryResult`. The multipliers of the join before a phase are
            "join before <phase>: <state>".
    """

    problem: PhasedProblem
    phases: tuple[Trajectory, ...]
    final_time: float
    durations: dict[str, float]
    cost: float
    violation: float
    violations: dict[str, float]
    optimality: Optimality
    multipliers: dict[str, Array]
    active: tuple[str, ...]
    status: Status
    message: str
    iterations: int
    tries: tuple[tuple[Status, float, float, int], ...]
    params: dict[str, Array]
    compile_seconds: float
    solve_seconds: float

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED

    @functools.cached_property
    def between_nodes(self) -> dict[str, float]:
        """Name of a path constraint or box -> its largest violation along a dense rollout, in its own unit."""
        return self._by_phase([phase.between_nodes for phase in self.phases])

    @functools.cached_property
    def mesh_error(self) -> dict[str, dict[str, float]]:
        """State name -> how far a rollout of its phase, in ten times as many steps, ends from the planned node."""
        return self._by_phase([phase.mesh_error for phase in self.phases])

    def replay(self, method: Any = None, steps: int = 20, **options: Any) -> tuple[Replay, ...]:
        """The replay of each phase from its own first node; see `TrajectoryResult.replay`."""
        return tuple(phase.replay(method, steps, **options) for phase in self.phases)

    def explain(self) -> str:
        """How good it is, a line each: errors, active constraints, what a finer rollout misses and exceeds."""
        return explained(self)

    def _by_phase(self, found: Sequence[dict[str, Any]]) -> dict[str, Any]:
        pairs = zip(self.problem.names, found, strict=True)
        return {f"{phase}: {name}": value for phase, own in pairs for name, value in own.items()}

    def __repr__(self) -> str:
        return (
            f"PhasedResult({self.message} cost={self.cost:.6g}, violation={self.violation:.1e}, "
            f"final_time={self.final_time:.6g}, iterations={self.iterations}, "
            f"compile {self.compile_seconds:.1f} s, solve {self.solve_seconds:.1f} s)"
        )


def best_of_phases(
    problem: PhasedProblem,
    outcomes: Sequence[Outcome],
    params: dict[str, Array],
    tolerance: float,
    compile_seconds: float,
    solve_seconds: float,
) -> PhasedResult:
    """The best of several tries."""
    joined, sign, best = problem.shooting, problem.none.sign, best_of(outcomes)
    params, point = found_params(problem.border, best, params), best.point
    limits = set(problem.border.row_names)
    phases, lost, multipliers = [], dict[str, float](), dict[str, Array]()
    with in_double():
        for part, name, segment in zip(problem.parts, problem.names, joined.segments):
            n, stages = segment.shooting.n, segment.stages
            own = best._replace(
                point=segment.of(point),
                values=Values(
                    best.values.cost,
                    np.asarray(best.values.defects)[stages, :n],
                    joined.rows_of(segment, np.asarray(best.values.rows)),
                ),
                dynamics=best.dynamics[stages, :n],
                rows=joined.rows_of(segment, best.rows),
            )
            named = lambda key, name=name: key if key in limits else f"{name}: {key}"  # noqa: E731
            phases.append(Trajectory(**trajectory_at(part, own.point, params)))
            lost |= {named(key): value for key, value in violations_of(part, own, params).items()}
            multipliers |= {named(key): value for key, value in multipliers_of(part, own).items()}
            if segment is not joined.segments[0]:
                for state, place in part.dynamics.group.slices.items():
                    key = f"join before {name}: {state}"
                    multipliers[key] = best.dynamics[stages.start - 1, place]
                    lost[key] = float(np.abs(np.asarray(best.values.defects)[stages.start - 1, place]).max(initial=0.0))
    durations = np.asarray(point.border)[: len(phases)]
    return PhasedResult(
        problem=problem,
        phases=tuple(phases),
        final_time=phases[-1].final_time,
        durations={name: float(size) for name, size in zip(problem.names, durations)},
        cost=sign * best.cost,
        violation=best.violation,
        violations=lost,
        optimality=Optimality(*best.errors),
        multipliers=multipliers,
        active=active_of(joined, best),
        status=best.status,
        message=_message(problem, best, tolerance),
        iterations=best.iterations,
        tries=tuple((o.status, sign * o.cost, o.violation, o.iterations) for o in outcomes),
        params=params,
        compile_seconds=compile_seconds,
        solve_seconds=solve_seconds,
    )


def _message(problem: PhasedProblem, outcome: Outcome, tolerance: float) -> str:
    """The status, and where it is no success the worst constraint and the worst break of the dynamics."""
    joined, worst = problem.shooting, []
    if outcome.status in (Status.SOLVED, Status.ACCEPTABLE):
        return f"{outcome.status}."
    count = joined.intervals * joined.n
    rows, dynamics = outcome.violations[count:], outcome.violations[:count].reshape(-1, joined.n)
    if rows.max(initial=0.0) > tolerance:
        row = int(rows.argmax())
        size = abs(float(outcome.values.rows[row]))
        worst.append(f"{joined.names[row]!r} {joined.places[row]} is off by {size:.3g}")
    if dynamics.max(initial=0.0) > tolerance:
        stage, column = divmod(int(dynamics.argmax()), joined.n)
        size = abs(float(outcome.values.defects[stage, column]))
        part = next(part for part in joined.segments if stage <= part.stages.stop)
        name = problem.names[part.number]
        if stage < part.stages.stop:
            k = stage - part.stages.start
            place = f"'{name}: dynamics of {part.shooting.states[column]}' between nodes {k} and {k + 1}"
        else:
            after = joined.segments[part.number + 1]
            place = f"'join before {problem.names[after.number]}: {after.shooting.states[column]}'"
        worst.append(f"{place} is off by {size:.3g}")
    return f"{outcome.status}. Worst: {'; '.join(worst)}." if worst else f"{outcome.status}."
