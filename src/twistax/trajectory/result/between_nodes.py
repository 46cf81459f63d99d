"""Constraints between the points at which they are imposed: each interval is tightened by the violation along a
rollout.

A path constraint g(x(t)) <= 0 is imposed only at the ends of substeps. After a solve, let e_k be its largest value over
interval k of a dense rollout. It updates a margin m_k <- max(0, m_k + e_k), and the problem is solved again from a warm
start with g + m_k <= 0. At convergence the largest value is zero in each interval where the constraint is active.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..strategy.integration import CoreRollout
from ..strategy.outcome import Outcome
from ..strategy.status import Status
from ..strategy.warm import WarmStart
from ..transcription.iterate import Instance, Iterate
from ..transcription.staged import Staged
from .quality import params_of
from .replay import times_along
from .trajectory import Trajectory, trajectory_at

if TYPE_CHECKING:
    from ..problem.stated_phase import StatedPhase

#: Samples of a rollout in an interval, the maximal number of updates of the margins, and the tightening relative to the
#: violation.
_SAMPLES, _ROUNDS, _MORE = 40, 12, 1.2


def hold_between_nodes(
    problem: Any,
    outcome: Outcome,
    instance: Instance,
    params: dict[str, Array],
    run: Callable[[WarmStart, Instance], Outcome],
    between: float,
    staged: Staged,
) -> Outcome:
    """A solved outcome whose constraints also hold between nodes, within `between` of their scales.

    If there is none, the result is the last outcome with status SOLVED, with its status changed to EXCEEDED.

    Args:
        run: solves the problem again.
        staged: the problem in the core's form, which performs the rollout.
    """
    data = staged.numbers.vector(instance)
    rollouts = [
        CoreRollout(values, part.transcription.rolling(_SAMPLES), staged.numbers, data)
        for values, part in zip(staged.parts, problem.parts, strict=True)
    ]
    shooting, parts = problem.shooting, list(zip(problem.parts, problem.shooting.segments, strict=True))
    margins = [np.zeros((part.shooting.intervals, len(part.path.names))) for part, _ in parts]
    iterations = outcome.iterations
    for left in reversed(range(_ROUNDS + 1)):
        values = params_of(problem.border, outcome, params)
        scales = np.asarray(outcome.scales.rows)
        excess = [
            _excess(part, segment.of(outcome.point), values, rollout)
            for (part, segment), rollout in zip(parts, rollouts)
        ]
        shares = [
            over / part.shooting.row_scales(shooting.rows_of(segment, scales)).min(axis=0)
            for over, (part, segment) in zip(excess, parts)
        ]
        if max(float(share.max(initial=0.0)) for share in shares) <= between:
            return dataclasses.replace(outcome, iterations=iterations)
        if not left:
            break
        margins = [_tightened(margin, over) for margin, over in zip(margins, excess)]
        point = jax.tree.map(np.asarray, outcome.point)
        start = WarmStart(problem, point, outcome.dynamics, outcome.rows, outcome.scales, params)
        spread = [part.shooting.spread_over_points(margin) for (part, _), margin in zip(parts, margins)]
        again = run(start, instance.with_margins(shooting.rows_of_all(spread)))
        iterations += again.iterations
        if again.status is not Status.SOLVED:
            break
        outcome = again
    return dataclasses.replace(outcome, status=Status.EXCEEDED, iterations=iterations)


def _tightened(margins: Array, over: Array) -> Array:
    """New margins of a phase whose constraints are violated; neighbouring intervals are tightened, too."""
    over = np.maximum(over, np.maximum(0.0, _beside(over)))
    return np.maximum(0.0, margins + np.where(over > 0.0, _MORE * over, over))


def _beside(over: Array) -> Array:
    """The larger of the values of the two neighbouring intervals."""
    closed = np.pad(over, ((1, 1), (0, 0)), constant_values=-np.inf)
    return np.maximum(closed[:-2], closed[2:])


def _excess(problem: StatedPhase, point: Iterate, params: dict[str, Array], rollout: CoreRollout) -> Array:
    """(intervals, rows) the largest value of every inequality along a rollout; minus infinity for equalities."""
    intervals = problem.nodes - 1
    trajectory = Trajectory(**trajectory_at(problem, point, params))
    rolled = rollout.states(point)
    window = (_SAMPLES * np.arange(intervals)[:, None] + np.arange(_SAMPLES + 1)).ravel()
    controls = problem.shooting.local.controls.split(np.repeat(np.asarray(point.us), _SAMPLES + 1, axis=0))
    states = {name: values[window] for name, values in rolled.items()}
    rows = np.asarray(problem.path_rows(times_along(trajectory, _SAMPLES)[window], states, controls, params))
    most = rows.reshape(intervals, _SAMPLES + 1, -1).max(axis=1)
    return np.where(problem.path.equality, -np.inf, most)
