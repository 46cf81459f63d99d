"""What an optimisation gives back, and the rollout of the controls it found, densely and with any method."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from ..checks import whole
from ..errors import TrajectoryError
from ..integrators import FirstOrderHold, PiecewisePolynomial, ZeroOrderHold
from ..jax_inside import in_double
from .found import Found, Tried, found_params
from .outcome import Outcome
from .pictures import animated, drawn
from .replay import Replay, replayed
from .statement import largest_by_name, violations
from .transcribed import Point

if TYPE_CHECKING:
    from ..view import Scene
    from .problem import Problem
    from .refine import Meshed


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """States and controls of a problem, or of one phase of it. All arrays are NumPy, double precision.

    Attributes:
        xs: states by name, leading axis the nodes.
        us: controls by name, leading axis the intervals for held ones, the nodes for continuous ones.
        ts: (nodes,) times in s.
        final_time: the last of them.
        params: the parameters it was solved for, and those that were found.
        added: what `Integral` and `Initial` became, states by name.
    """

    problem: Problem
    xs: dict[str, Array]
    us: dict[str, Array]
    ts: Array
    final_time: float
    params: dict[str, Array]
    added: dict[str, Array]

    @property
    def controls(self) -> dict[str, ZeroOrderHold | FirstOrderHold | PiecewisePolynomial]:
        """The controls over time, as `tx.integrate(u=...)` takes them."""
        return self.problem.restated.over_time(self.ts, self.us, self.us | self.added)

    @property
    def integrals(self) -> dict[str, Array]:
        """`Integral(...)` -> from the beginning until each node."""
        reduced, found = self.problem.reduced, dict[str, Array]()
        for name in reduced.integrals:
            # What bounds of norms stand for is told by a rollout with the norms themselves.
            along = self.dense.integrals[name] if name in reduced.loose else self.added[name]
            found[name] = along[:: (len(along) - 1) // (len(self.ts) - 1)]
        return found

    @functools.cached_property
    def dense(self) -> Replay:
        """`replay()`, rolled out once."""
        return self.replay()

    @property
    def extremes(self) -> dict[str, float]:
        """`Maximum(...)`, `Minimum(...)` -> that value along a dense rollout."""
        return self.dense.extremes

    @property
    def between_nodes(self) -> dict[str, float]:
        """Name of a path constraint or box -> its largest violation along a dense rollout, in its own unit."""
        return self.dense.violations

    @functools.cached_property
    def mesh_error(self) -> dict[str, dict[str, float]]:
        """State name -> how far a rollout in ten times as many steps ends from the planned final node."""
        return self.replay(steps=10 * self.problem.transcription.substeps).misses

    def plot(self, names: Sequence[str] | None = None, *, units: Mapping[str, str] | None = None) -> Any:
        """States and controls over time, a matplotlib figure: dots at nodes, lines of a dense rollout, limits dashed.

        Poses are drawn as positions and Euler angles in deg. Of a result the largest multipliers are shown, too.

        Args:
            names: of the states and controls to draw; all unless given.
            units: labels of values by name, such as {"v": "m/s"}; "SI", and "m" of positions, unless given.
        Raises:
            InputError: a name that is not there.
            ModelError: matplotlib is not installed.
        """
        return drawn([self], names, units)

    def show(self, path: Any = None, **choices: Any) -> Scene:
        """The dense rollout in three dimensions, with the choices of `Solution.show`.

        Where the rollout does not reach its end, the nodes and straight lines between them.
        """
        return animated([self], path, choices)

    def replay(self, method: Any = None, steps: int = 20, *, rtol: float = 1e-10, atol: float = 1e-10) -> Replay:
        """Roll out the found controls from the first node, and measure what comes out.

        Args:
            method: an RKMK method; or a diffrax solver, which integrates the same system as a plain ODE in quaternions
                with adaptive steps. RK4 if left out, of collocation by a stiffly accurate tableau its implicit method.
            steps: samples an interval, and for an RKMK method its steps there.
            rtol, atol: tolerances of a diffrax solver.
        Raises:
            TrajectoryError: steps is no positive whole number; node times that go back.
            InputError: method is neither.
            IntegrationError: the rollout did not reach its end.
        """
        whole("steps", steps, 1, TrajectoryError)
        with in_double():
            return replayed(self, method, steps, rtol, atol, self._border)

    @property
    def _border(self) -> Array | None:
        """What all stages share in the solve that it comes from."""
        return None


@dataclasses.dataclass(frozen=True, repr=False)
class TrajectoryResult(Found, Trajectory):
    """A trajectory and how well it solves its problem; see `Trajectory` and `Found` for the attributes.

    Attributes:
        meshes: of `solve(refine=...)` the meshes it went through, a `Meshed` each.
    """

    meshes: tuple[Meshed, ...] = ()

    def replay(self, method: Any = None, steps: int = 20, *, rtol: float = 1e-10, atol: float = 1e-10) -> Replay:
        """As `Trajectory.replay`. Raises TrajectoryError, too, where values of the problem are not finite there."""
        self._need_finite()
        return super().replay(method, steps, rtol=rtol, atol=atol)

    @property
    def _border(self) -> Array:
        return np.asarray(self.warm.point.border)

    def plot(self, names: Sequence[str] | None = None, *, units: Mapping[str, str] | None = None) -> Any:
        """As `Trajectory.plot`, with the multipliers of what is active."""
        return drawn([self], names, units, self.message, {name: self.multipliers[name] for name in self.active})


def best_result(problem: Problem, tried: Tried) -> TrajectoryResult:
    """The best of several tries."""
    best = tried.best
    params = found_params(problem.border, best, tried.params)
    with in_double():
        violations = violations_of(problem, best, params)
    return TrajectoryResult(
        **trajectory_at(problem, best.point, params) | tried.fields(problem, params, violations, problem.path.shown),
        multipliers=multipliers_of(problem, best),
    )


def trajectory_at(problem: Problem, point: Point, params: dict[str, Array]) -> dict[str, Any]:
    """The fields of a `Trajectory` at a point."""
    controls = problem.shooting.local.controls.split(np.asarray(point.us))
    states, ts = problem.reduced.states, times_of(problem, point)
    own = {s.name for s in states}
    return {
        "problem": problem,
        "xs": {s.name: np.asarray(point.xs[s.name]) for s in states},
        "added": {name: np.asarray(values) for name, values in point.xs.items() if name not in own},
        "us": {n: np.asarray(values) for n, values in problem.restated.us(point.xs, controls).items()},
        "ts": ts,
        "final_time": float(ts[-1]),
        "params": params,
    }


def times_of(problem: Problem, point: Point) -> Array:
    """The times of the nodes."""
    return np.asarray(problem.restated.times(point.xs, problem.shooting.times(np.asarray(point.border))))


def multipliers_of(problem: Problem, outcome: Outcome) -> dict[str, Array]:
    """By the names of rows."""
    shooting = problem.shooting
    found = {f"dynamics of {name}": outcome.dynamics[:, part] for name, part in problem.dynamics.group.slices.items()}
    for name in dict.fromkeys(shooting.names[shooting.exists]):
        found[name] = outcome.rows[shooting.exists & (shooting.names == name)]
    return found


def violations_of(problem: Problem, outcome: Outcome, params: dict[str, Array]) -> dict[str, float]:
    """At the nodes, in the constraints' own units."""
    shooting, path, point = problem.shooting, problem.path, outcome.point
    defects = np.abs(np.asarray(outcome.values.defects)).max(axis=0)
    found = {f"dynamics of {n}": float(defects[p].max(initial=0.0)) for n, p in problem.dynamics.group.slices.items()}
    if path.shown:
        ts = times_of(problem, point)
        held = shooting.local.controls.split(np.asarray(point.us))
        ends = [({n: np.asarray(a)[s] for n, a in point.xs.items()}, ts[s]) for s in (slice(None, -1), slice(1, None))]
        sizes = [
            violations(np.asarray(problem.shown_rows(t, x, held, params)), path.shown_equality).max(axis=0)
            for x, t in ends
        ]
        found |= largest_by_name(path.shown, np.maximum(*sizes))
    own = shooting.own
    lost = violations(np.asarray(outcome.values.rows), shooting.equality)
    found |= largest_by_name([str(name) for name in shooting.names[own]], lost[own])
    xs = {name: np.asarray(values) for name, values in point.xs.items()}
    return found | problem.softened.violations(problem.conditions, xs, times_of(problem, point), params)
