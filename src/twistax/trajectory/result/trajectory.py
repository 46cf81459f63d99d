"""The trajectory of a phase, its dense rollout, its multipliers and violations."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from ...checks import whole
from ...errors import TrajectoryError
from ...integrators import FirstOrderHold, PiecewisePolynomial, ZeroOrderHold
from ...jax_inside import in_double
from ..problem.statement import largest_by_name, violations
from ..strategy.outcome import Outcome
from ..transcription.iterate import Iterate
from .pictures import animated, drawn
from .replay import Replay, replayed

if TYPE_CHECKING:
    from ...view import Scene
    from ..problem.stated_phase import StatedPhase


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """States and controls of a problem, or of one phase of it. All arrays are NumPy, double precision.

    Attributes:
        xs: states by name; the leading axis is that of the nodes.
        us: controls by name; the leading axis is that of the intervals for piecewise constant ones, of the nodes for
            continuous ones.
        ts: (nodes,) times in s.
        final_time: the last of these times.
        params: the parameter values of the solve, including optimal free parameters.
        added: the states that represent each `Integral` and `Initial`, by name.
        problem: the phase of the problem to which it belongs.
        solve: for a problem without a list of phases, that problem and its shared unknowns, with which the solver's
            core performs rollouts.
    """

    problem: StatedPhase
    xs: dict[str, Array]
    us: dict[str, Array]
    ts: Array
    final_time: float
    params: dict[str, Array]
    added: dict[str, Array]
    solve: tuple[Any, Array] | None = dataclasses.field(default=None, repr=False)

    @property
    def controls(self) -> dict[str, ZeroOrderHold | FirstOrderHold | PiecewisePolynomial]:
        """The controls over time, as `tx.integrate(u=...)` takes them."""
        return self.problem.continuous.over_time(self.ts, self.us, self.us | self.added)

    @property
    def integrals(self) -> dict[str, Array]:
        """`Integral(...)` -> its value from the start until each node."""
        reduced, integrals = self.problem.functionals, dict[str, Array]()
        for name in reduced.integrals:
            # Bounds of norms may exceed the norms; a rollout with the norms themselves has the exact integrals.
            rollout = self.dense.integrals[name] if name in reduced.loose else self.added[name]
            integrals[name] = rollout[:: (len(rollout) - 1) // (len(self.ts) - 1)]
        return integrals

    @functools.cached_property
    def dense(self) -> Replay:
        """The result of `replay()`, computed once."""
        return self.replay()

    @property
    def extremes(self) -> dict[str, float]:
        """`Maximum(...)`, `Minimum(...)` -> its value along a dense rollout."""
        return self.dense.extremes

    @property
    def between_nodes(self) -> dict[str, float]:
        """Name of a path constraint or bound -> its largest violation along a dense rollout, in its own unit."""
        return self.dense.violations

    @functools.cached_property
    def mesh_error(self) -> dict[str, dict[str, float]]:
        """State name -> distance between the end of a rollout in ten times as many steps and the planned final node."""
        return self.replay(steps=10 * self.problem.transcription.substeps).misses

    def plot(self, *names: Any, units: Mapping[str, str] | None = None) -> Any:
        """A matplotlib figure of states and controls over time: dots at nodes, lines of a dense rollout, dashed lines
        for limits.

        Poses are drawn as positions and Euler angles in deg. The figure of a result also shows the largest multipliers.

        Args:
            names: names of the states and controls to draw; by default all.
            units: units of the drawn values by name, as in `Solution.plot`.
        Raises:
            InputError: an unknown name.
            ModelError: matplotlib is not installed.
        """
        return drawn([self], names, units)

    def show(self, path: Any = None, **choices: Any) -> Scene:
        """An animation of the dense rollout in three dimensions; the arguments are those of `Solution.show`.

        If the rollout does not reach its end, the animation shows the nodes, connected by straight lines.
        """
        return animated([self], path, choices)

    def video(self, path: Any, *, size: tuple[int, int] = (1280, 720), **choices: Any) -> Path:
        """A video of what `show` draws; see `Solution.video`."""
        return self.show(opened=False, **choices).video(path, size=size)

    def replay(self, method: Any = None, steps: int = 20, *, rtol: float = 1e-10, atol: float = 1e-10) -> Replay:
        """Roll out the controls of the solution from the first node, and measure errors and violations.

        Args:
            method: an RKMK method; or a diffrax solver, which integrates the same system as a plain ODE in quaternions
                with adaptive steps. The default is RK4, or for collocation by a stiffly accurate tableau the
                corresponding implicit method.
            steps: the number of samples in an interval; also the number of steps of an RKMK method.
            rtol, atol: tolerances of a diffrax solver.
        Raises:
            TrajectoryError: `steps` is not a positive whole number; node times decrease.
            InputError: `method` is neither an RKMK method nor a diffrax solver.
            IntegrationError: the rollout did not reach its end.
        """
        whole("steps", steps, 1, TrajectoryError)
        with in_double():
            return replayed(self, method, steps, rtol, atol)


def trajectory_at(problem: StatedPhase, point: Iterate, params: dict[str, Array]) -> dict[str, Any]:
    """The attributes of a `Trajectory` at a point."""
    controls = problem.shooting.local.controls.split(np.asarray(point.us))
    ts, (xs, us) = times_of(problem, point), problem.seen(point.xs, controls)
    return {
        "problem": problem,
        "xs": {name: np.asarray(values) for name, values in xs.items()},
        "added": {name: np.asarray(values) for name, values in point.xs.items() if name not in xs},
        "us": {name: np.asarray(values) for name, values in us.items()},
        "ts": ts,
        "final_time": float(ts[-1]),
        "params": params,
    }


def times_of(problem: StatedPhase, point: Iterate) -> Array:
    """The times of the nodes."""
    return np.asarray(problem.continuous.times(point.xs, problem.shooting.times(np.asarray(point.border))))


def multipliers_of(problem: StatedPhase, outcome: Outcome) -> dict[str, Array]:
    """The multipliers of a phase by the names of its rows."""
    shooting = problem.shooting
    multipliers = {
        f"dynamics of {name}": outcome.dynamics[:, part] for name, part in problem.dynamics.group.slices.items()
    }
    exists, labels = np.flatnonzero(shooting.exists), shooting.labels
    by_name = exists[np.argsort(labels.of_rows[exists], kind="stable")]
    numbers, firsts = np.unique(labels.of_rows[by_name], return_index=True)
    of_names = np.split(outcome.rows[by_name], firsts[1:])
    return multipliers | {labels.names[number]: rows for number, rows in zip(numbers, of_names)}


def violations_of(problem: StatedPhase, outcome: Outcome, params: dict[str, Array]) -> dict[str, float]:
    """The violations at the nodes by name, in the units of the constraints."""
    shooting, path, point = problem.shooting, problem.path, outcome.point
    defects = np.abs(np.asarray(outcome.values.defects)).max(axis=0)
    largest = {f"dynamics of {n}": float(defects[p].max(initial=0.0)) for n, p in problem.dynamics.group.slices.items()}
    if path.shown:
        ts = times_of(problem, point)
        controls = shooting.local.controls.split(np.asarray(point.us))
        ends = [({n: np.asarray(a)[s] for n, a in point.xs.items()}, ts[s]) for s in (slice(None, -1), slice(1, None))]
        first, last = (
            violations(np.asarray(problem.shown_rows(t, x, controls, params)), path.shown_equality).max(axis=0)
            for x, t in ends
        )
        first[np.isin(path.shown, list(path.of_steps))] = 0.0
        largest |= largest_by_name(path.shown, np.maximum(first, last))
    at_nodes = shooting.at_single_node
    sizes_at_nodes = violations(np.asarray(outcome.values.rows), shooting.equality)
    largest |= shooting.node_labels.largest(sizes_at_nodes[at_nodes])
    xs = {name: np.asarray(values) for name, values in point.xs.items()}
    return largest | problem.node_slacks.violations(problem.conditions, xs, times_of(problem, point), params)
