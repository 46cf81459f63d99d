"""Warm starts: states, controls, times, multipliers and scales of a solution."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ...checks import short, whole
from ...errors import TrajectoryError
from ...jax_inside import in_double
from ..start_units import StartUnits
from ..strategy.integration import CoreRollout
from ..transcription.iterate import Instance, Iterate
from .outcome import Scales


@dataclasses.dataclass(frozen=True, eq=False)
class WarmStart:
    """A solution as the start of another solve: `problem.solve(warm=...)`.

    Attributes:
        problem: the problem that was solved.
        point: states, controls including the bounds on norms, times and free parameters.
        dynamics, rows: their multipliers, in the problem's units.
        scales: scales of unknowns, rows and objective.
        params: the parameter values of that solve.
        units: the units of the solver, if they are known and fit the problem.
    """

    problem: Any
    point: Iterate
    dynamics: Array  # (intervals, n)
    rows: Array  # (rows,)
    scales: Scales
    params: dict[str, Array]
    units: StartUnits | None = None

    def shifted(self, steps: int = 1) -> WarmStart:
        """A warm start, shifted by a number of intervals. The last control stays constant after the end, and the states
        are integrated.

        Raises:
            TrajectoryError: `steps` is not a positive whole number; interval lengths differ.
        """
        whole("steps", steps, 1, TrajectoryError)
        point = self.point
        if isinstance(point.xs, tuple):
            raise TrajectoryError(
                "shifted: the problem has several phases, and only a problem of one phase can be shifted"
            )
        if self.problem is None:
            raise TrajectoryError(
                "shifted: the warm start has no problem.\n  fix: use result.shifted() of a result of problem.solve"
            )
        (problem,) = self.problem.parts
        shooting = problem.shooting
        if not problem.mesh.is_even:
            raise TrajectoryError(
                "shifted: intervals have different lengths.\n  fix: use a mesh with nodes at equal distances"
            )
        # Linear controls are not changed.
        split = shooting.local.controls.split
        still = {name: np.asarray(a) for name, a in problem.continuous.at_rest(split(np.ones(shooting.m))).items()}
        rest = point.us[-1] * np.concatenate([np.zeros(0), *(a.ravel() for a in still.values())])
        us = np.concatenate([point.us[steps:], np.repeat(rest[None], min(steps, len(point.us)), axis=0)])
        with in_double():
            instance = self.problem.started(begin=point).instance.with_params(self.params)
            staged = self.problem.core(1e-6, point, instance).staged
            last, data = staged.parts[0], staged.numbers.vector(instance)
            rollout = CoreRollout(last, problem.transcription, staged.numbers, data)
            nodes = list(last.point.joined(point.xs, 1))
            for _ in range(steps):
                ends = rollout.interval(shooting.intervals - 1, nodes[-1], rest, nodes[-1], np.ravel(point.border))
                nodes.append(ends[-1])
        inner, end = np.split(self.rows, [shooting.intervals * shooting.rows_per_interval])
        return dataclasses.replace(
            self,
            point=Iterate(last.point.split(np.stack(nodes[steps:])), us, point.border),
            dynamics=_moved_on(self.dynamics, steps),
            rows=np.concatenate([_moved_on(inner.reshape(shooting.intervals, -1), steps).ravel(), end]),
        )


def _moved_on(values: Array, steps: int) -> Array:
    """Values shifted by a number of intervals; the last one is repeated."""
    return values[np.minimum(np.arange(len(values)) + steps, len(values) - 1)]


def warm_start(value: Any) -> WarmStart:
    """The argument itself if it is a warm start; else the warm start of a result.

    Raises:
        TrajectoryError: the argument is neither.
    """
    warm = value if isinstance(value, WarmStart) else getattr(value, "warm", None)
    if not isinstance(warm, WarmStart):
        raise TrajectoryError(f"solve: warm expects a result or result.shifted(), got {short(value)}")
    arrays = [*jax.tree.leaves(warm.point), warm.dynamics, warm.rows]
    if not all(np.isfinite(np.asarray(a)).all() for a in arrays):
        raise TrajectoryError("solve: warm has values that are not finite\n  fix: solve from a guess")
    return warm


def with_ends(warm: WarmStart, problem: Any, ends: Any, instance: Instance) -> WarmStart:
    """The warm start with other initial and final values, projected onto the limits of times and free parameters.

    Raises:
        TrajectoryError: it belongs to a problem with other states, controls, nodes or constraints.
    """
    shooting, point = problem.shooting, warm.point
    shapes = [np.shape(a) for a in (point.us, warm.dynamics, warm.rows, point.border)]
    expected = [(shooting.intervals, k) for k in (shooting.m, shooting.n)]
    expected += [np.shape(a) for a in (shooting.exists, problem.border.limits[:, 0])]
    if shapes != expected:
        raise other_problem()
    start = Iterate(_at_ends(problem, point.xs, ends), point.us, np.clip(point.border, *np.asarray(instance.limits).T))
    same = warm.problem is problem and all(np.array_equal(warm.params[n], a) for n, a in instance.params.items())
    return dataclasses.replace(warm, point=start, units=warm.units if same else None)


def _at_ends(problem: Any, xs: Any, ends: Any) -> Any:
    """States at the nodes in which fixed initial and final entries have their values."""
    if problem.alone:
        return problem.parts[0].at_ends(xs, ends[0])
    if not isinstance(xs, tuple) or len(xs) != len(problem.parts):
        raise other_problem()
    return tuple(part.at_ends(states, side) for part, states, side in zip(problem.parts, xs, ends))


def other_problem() -> TrajectoryError:
    """The error for a warm start from another problem."""
    return TrajectoryError(
        "solve: warm must be of a problem with the same states, controls, nodes and constraints.\n"
        "  fix: give its xs and us as guess"
    )
