"""Limits held between the points where they are asked: tightened, interval by interval, by what a rollout exceeds them.

A limit g(x(t)) <= 0 is asked at the ends of substeps alone. After a solve its largest value over interval k of a dense
rollout, e_k, is added to a margin, m_k <- max(0, m_k + e_k), and the problem is solved again, warm, with
g + m_k <= 0 there. At rest the largest value is zero in each interval where the limit binds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import numpy as np
from numpy import ndarray as Array

from ..integrators import RKMK
from ..integrators.tableaus import RK4
from .replay import rolled_out, times_along
from .result import Trajectory, found_params, trajectory_at
from .solver import Outcome
from .transcribed import Given
from .warm import WarmStart
from .watch import Status

if TYPE_CHECKING:
    from .problem import Problem

#: Samples of a rollout in an interval, how often margins may change, and by how much more than a limit is exceeded.
_SAMPLES, _ROUNDS, _MORE = 40, 12, 1.2


def held(
    problem: Problem,
    outcome: Outcome,
    given: Given,
    params: dict[str, Array],
    run: Callable[[WarmStart, Given], Outcome],
    between: float,
) -> Outcome:
    """A solved outcome whose limits hold between nodes as well, within `between` of their scales.

    Where none is found the last that is SOLVED, with status EXCEEDED.

    Args:
        run: solves again.
    """
    shooting = problem.shooting
    margins = np.zeros((shooting.intervals, len(problem.path.names)))
    iterations = outcome.iterations
    for left in reversed(range(_ROUNDS + 1)):
        over = _excess(problem, outcome, params)
        if float((over / shooting.path_scales(np.asarray(outcome.scales.rows))).max(initial=0.0)) <= between:
            return outcome._replace(iterations=iterations)
        if not left:
            break
        # Tightened in one interval a trajectory touches its limit in the next.
        over = np.maximum(over, np.maximum(0.0, _beside(over)))
        margins = np.maximum(0.0, margins + np.where(over > 0.0, _MORE * over, over))
        point = jax.tree.map(np.asarray, outcome.point)
        start = WarmStart(problem, point, outcome.dynamics, outcome.rows, outcome.scales, params)
        again = run(start, given._replace(margins=shooting.spread_over_points(margins)))
        iterations += again.iterations
        if again.status is not Status.SOLVED:
            break
        outcome = again
    return outcome._replace(status=Status.EXCEEDED, iterations=iterations)


def _beside(over: Array) -> Array:
    """The larger of what both neighbours have."""
    closed = np.pad(over, ((1, 1), (0, 0)), constant_values=-np.inf)
    return np.maximum(closed[:-2], closed[2:])


def _excess(problem: Problem, outcome: Outcome, params: dict[str, Array]) -> Array:
    """(intervals, rows) the largest value of every inequality along a rollout; minus infinity for equalities."""
    point, intervals = outcome.point, problem.nodes - 1
    params = found_params(problem.border, outcome, params)
    trajectory = Trajectory(**trajectory_at(problem, point, params))
    rolled = rolled_out(trajectory, RKMK(RK4), _SAMPLES)
    window = (_SAMPLES * np.arange(intervals)[:, None] + np.arange(_SAMPLES + 1)).ravel()
    controls = problem.shooting.local.controls.split(np.repeat(np.asarray(point.us), _SAMPLES + 1, axis=0))
    states = {name: values[window] for name, values in rolled.items()}
    rows = np.asarray(problem.path_rows(times_along(trajectory, _SAMPLES)[window], states, controls, params))
    most = rows.reshape(intervals, _SAMPLES + 1, -1).max(axis=1)
    return np.where(problem.path.equality, -np.inf, most)
