"""What an optimisation of several phases gives back."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from ..jax_inside import in_double
from .found import Found, Tried, found_params
from .outcome import Outcome
from .pictures import animated, drawn
from .replay import Replay
from .result import Trajectory, multipliers_of, trajectory_at, violations_of
from .transcribed import Segment, Values

if TYPE_CHECKING:
    from ..view import Scene
    from .phases import PhasedProblem
    from .refine import Meshed


@dataclasses.dataclass(frozen=True, repr=False)
class PhasedResult(Found):
    """Trajectories of phases, and how well they solve their problem; see `Found` for the other attributes.

    Names have the phase's in front. The multipliers of the join before a phase are "join before <phase>: <state>".

    Attributes:
        phases: the trajectory of each, with `xs`, `us`, `ts`, `replay()`; times go on from phase to phase.
        durations: how long each phase takes, s.
        meshes: of `solve(refine=...)` the meshes it went through, a `Meshed` each.
    """

    problem: PhasedProblem
    phases: tuple[Trajectory, ...]
    durations: dict[str, float]
    meshes: tuple[Meshed, ...] = ()

    @functools.cached_property
    def between_nodes(self) -> dict[str, float]:
        """Name of a path constraint or box -> its largest violation along a dense rollout, in its own unit."""
        self._need_finite()
        return self._by_phase([phase.between_nodes for phase in self.phases])

    @functools.cached_property
    def mesh_error(self) -> dict[str, dict[str, float]]:
        """State name -> how far a rollout of its phase, in ten times as many steps, ends from the planned node."""
        self._need_finite()
        return self._by_phase([phase.mesh_error for phase in self.phases])

    def replay(self, method: Any = None, steps: int = 20, **options: Any) -> tuple[Replay, ...]:
        """The replay of each phase from its own first node; see `TrajectoryResult.replay`."""
        self._need_finite()
        return tuple(phase.replay(method, steps, **options) for phase in self.phases)

    def plot(self, names: Sequence[str] | None = None, *, units: Mapping[str, str] | None = None) -> Any:
        """All phases in one figure; see `TrajectoryResult.plot`."""
        return drawn(self.phases, names, units, self.message, {name: self.multipliers[name] for name in self.active})

    def show(self, path: Any = None, **choices: Any) -> Scene:
        """All phases one after the other, the states and controls that all of them have; see `Solution.show`."""
        return animated(self.phases, path, choices)

    def _by_phase(self, found: Sequence[dict[str, Any]]) -> dict[str, Any]:
        pairs = zip(self.problem.names, found, strict=True)
        return {f"{phase}: {name}": value for phase, own in pairs for name, value in own.items()}


def best_of_phases(problem: PhasedProblem, tried: Tried) -> PhasedResult:
    """The best of several tries."""
    best = tried.best
    params, point = found_params(problem.border, best, tried.params), best.point
    limits = set(problem.border.row_names)
    phases, lost, multipliers, shown = [], dict[str, float](), dict[str, Array](), set[str]()
    with in_double():
        for part, name, segment in zip(problem.parts, problem.names, problem.shooting.segments):
            own = _of_phase(problem, best, segment)
            named = lambda key, name=name: key if key in limits else f"{name}: {key}"  # noqa: E731
            phases.append(Trajectory(**trajectory_at(part, own.point, params)))
            lost |= {named(key): value for key, value in violations_of(part, own, params).items()}
            multipliers |= {named(key): value for key, value in multipliers_of(part, own).items()}
            shown |= set(map(named, part.path.shown))
            if segment is not problem.shooting.segments[0]:
                gap = np.abs(np.asarray(best.values.defects)[segment.stages.start - 1])
                for state, place in part.dynamics.group.slices.items():
                    key = f"join before {name}: {state}"
                    multipliers[key] = best.dynamics[segment.stages.start - 1, place]
                    lost[key] = float(gap[place].max(initial=0.0))
    durations = np.asarray(point.border)[: len(phases)]
    return PhasedResult(
        **tried.fields(problem, params, lost, shown),
        problem=problem,
        phases=tuple(phases),
        final_time=phases[-1].final_time,
        durations={name: float(size) for name, size in zip(problem.names, durations)},
        multipliers=multipliers,
    )


def _of_phase(problem: PhasedProblem, best: Outcome, segment: Segment) -> Outcome:
    """What a phase has of an outcome."""
    joined, n, stages = problem.shooting, segment.shooting.n, segment.stages
    defects, rows = np.asarray(best.values.defects)[stages, :n], np.asarray(best.values.rows)
    return best._replace(
        point=segment.of(best.point),
        values=Values(best.values.cost, defects, joined.rows_of(segment, rows)),
        dynamics=best.dynamics[stages, :n],
        rows=joined.rows_of(segment, best.rows),
    )
