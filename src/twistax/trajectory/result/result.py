"""The result of a solve: the trajectories of its phases, and their quality."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from ...integrators import FirstOrderHold, PiecewisePolynomial, ZeroOrderHold
from ...jax_inside import in_double
from ..strategy.outcome import Outcome
from ..transcription.iterate import Values
from ..transcription.shooting import PhaseSegment
from .pictures import animated, drawn
from .quality import Attempts, Quality, params_of
from .refine import Meshed
from .replay import Replay
from .trajectory import Trajectory, multipliers_of, trajectory_at, violations_of

if TYPE_CHECKING:
    from ...view import Scene


@dataclasses.dataclass(frozen=True, repr=False)
class TrajectoryResult(Quality):
    """The result of a solve: the trajectories of its phases, and their quality. See `Quality` for its other attributes.

    For a problem without a list of phases, `xs`, `us`, `ts`, `controls`, `integrals` and `extremes` are those of its
    only trajectory; see `Trajectory`.

    Attributes:
        phases: the trajectory of each phase; times continue from phase to phase.
        durations: duration of each phase, s.
        meshes: with `solve(refine=...)`, a list with a `Meshed` for each mesh.
    """

    phases: tuple[Trajectory, ...]
    durations: dict[str, float]
    meshes: tuple[Meshed, ...] = ()

    @property
    def _trajectory(self) -> Trajectory:
        if not self.problem.alone:
            raise AttributeError(
                "the result of a problem of several phases has states, controls and times by phase.\n"
                "  fix: result.phases[0].xs"
            )
        return self.phases[0]

    @property
    def xs(self) -> dict[str, Array]:
        """States by name; the leading axis is that of the nodes."""
        return self._trajectory.xs

    @property
    def us(self) -> dict[str, Array]:
        """Controls by name; the leading axis is that of the intervals for piecewise constant ones, and of the nodes for
        continuous ones.
        """
        return self._trajectory.us

    @property
    def ts(self) -> Array:
        """(nodes,) times in s."""
        return self._trajectory.ts

    @property
    def controls(self) -> dict[str, ZeroOrderHold | FirstOrderHold | PiecewisePolynomial]:
        """The controls over time, as `tx.integrate(u=...)` takes them."""
        return self._trajectory.controls

    @property
    def integrals(self) -> dict[str, Array]:
        """`Integral(...)` -> its value from the start until each node."""
        self._need_finite()
        return self._trajectory.integrals

    @property
    def extremes(self) -> dict[str, float]:
        """`Maximum(...)`, `Minimum(...)` -> its value along a dense rollout."""
        self._need_finite()
        return self._trajectory.extremes

    @property
    def dense(self) -> Replay:
        """The result of `replay()`, computed once."""
        self._need_finite()
        return self._trajectory.dense

    @functools.cached_property
    def between_nodes(self) -> dict[str, float]:
        """Name of a path constraint or bound -> its largest violation along a dense rollout, in its unit."""
        return self._by_phase("between_nodes")

    @functools.cached_property
    def mesh_error(self) -> dict[str, dict[str, float]]:
        """State name -> distance between the end of a rollout of its phase, in ten times as many steps, and the last
        node.
        """
        return self._by_phase("mesh_error")

    def replay(self, method: Any = None, steps: int = 20, *, rtol: float = 1e-10, atol: float = 1e-10) -> Replay:
        """The dense rollout of the controls; see `Trajectory.replay`. Also raises TrajectoryError if values of the
        problem are not finite.
        """
        self._need_finite()
        return self._trajectory.replay(method, steps, rtol=rtol, atol=atol)

    def plot(self, *names: Any, units: Mapping[str, str] | None = None) -> Any:
        """A figure of all phases with the multipliers of active constraints; see `Trajectory.plot`."""
        return drawn(self.phases, names, units, self.message, {name: self.multipliers[name] for name in self.active})

    def show(self, path: Any = None, **choices: Any) -> Scene:
        """An animation of all phases in succession, with the states and controls that all of them have; see
        `Trajectory.show`.
        """
        return animated(self.phases, path, choices)

    def video(self, path: Any, *, size: tuple[int, int] = (1280, 720), **choices: Any) -> Path:
        """A video of what `show` draws; see `Trajectory.video`."""
        return self.show(opened=False, **choices).video(path, size=size)

    def _by_phase(self, attribute: str) -> dict[str, Any]:
        self._need_finite()
        if self.problem.alone:
            return dict(getattr(self.phases[0], attribute))
        pairs = zip(self.problem.names, self.phases, strict=True)
        return {f"{name}: {key}": value for name, phase in pairs for key, value in getattr(phase, attribute).items()}


class PhasedResult(TrajectoryResult):
    """The result of a problem with a list of phases: `phases`, and their `durations` in s.

    `result.phases[0].xs["v"]` has the shape (nodes, ...), as in a `Trajectory`. Names of rows begin with the name of
    the phase. The multipliers of the link before a phase are "join before <phase>: <state>".
    """

    def replay(self, method: Any = None, steps: int = 20, **options: Any) -> Any:
        """A tuple with the replay of each phase from its own first node; see `Trajectory.replay`."""
        self._need_finite()
        return tuple(phase.replay(method, steps, **options) for phase in self.phases)


def best_result(problem: Any, tried: Attempts) -> TrajectoryResult:
    """The result of the best of several tries."""
    best, shooting = tried.best, problem.shooting
    params = params_of(problem.border, best, tried.params)
    solve = (problem, np.asarray(best.point.border)) if problem.alone else None
    phases, violations, multipliers, shown = [], dict[str, float](), dict[str, Array](), set[str]()
    with in_double():
        for part, segment in zip(problem.parts, shooting.segments):
            outcome, named = _of_phase(shooting, best, segment), functools.partial(shooting.named, segment)
            phases.append(Trajectory(**trajectory_at(part, outcome.point, params), solve=solve))
            violations |= {named(key): value for key, value in violations_of(part, outcome, params).items()}
            multipliers |= {named(key): value for key, value in multipliers_of(part, outcome).items()}
            shown |= set(map(named, part.path.shown))
        for name, before, after in zip(problem.names[1:], shooting.segments, shooting.segments[1:]):
            join = before.stages.stop
            for state, place in after.shooting.dynamics.group.slices.items():
                key = f"join before {name}: {state}"
                multipliers[key] = best.dynamics[join, place]
                violations[key] = float(np.abs(np.asarray(best.values.defects)[join, place]).max(initial=0.0))
    durations = np.asarray(best.point.border)[: len(phases)]
    return (TrajectoryResult if problem.alone else PhasedResult)(
        **tried.fields(problem, params, violations, shown),
        problem=problem,
        phases=tuple(phases),
        final_time=phases[-1].final_time,
        durations={name: float(size) for name, size in zip(problem.names, durations)},
        multipliers=multipliers,
    )


def _of_phase(shooting: Any, best: Outcome, segment: PhaseSegment) -> Outcome:
    """The part of an outcome that belongs to a phase."""
    n, stages = segment.shooting.n, segment.stages
    defects, rows = np.asarray(best.values.defects)[stages, :n], np.asarray(best.values.rows)
    return dataclasses.replace(
        best,
        point=segment.of(best.point),
        values=Values(best.values.cost, defects, shooting.rows_of(segment, rows)),
        dynamics=best.dynamics[stages, :n],
        rows=shooting.rows_of(segment, best.rows),
    )
