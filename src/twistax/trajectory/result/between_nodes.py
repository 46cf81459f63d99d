"""Limits held between the points where they are asked: tightened, interval by interval, by what a rollout exceeds them.

A limit g(x(t)) <= 0 is asked at the ends of substeps alone. After a solve its largest value over interval k of a dense
rollout, e_k, is added to a margin, m_k <- max(0, m_k + e_k), and the problem is solved again, warm, with
g + m_k <= 0 there. At rest the largest value is zero in each interval where the limit binds.
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

#: Samples of a rollout in an interval, how often margins may change, and by how much more than a limit is exceeded.
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
    """A solved outcome whose limits hold between nodes as well, within `between` of their scales.

    Where none is found the last that is SOLVED, with status EXCEEDED.

    Args:
        run: solves again.
        staged: the problem for the core, which rolls out.
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
    """New margins of a phase whose limits were exceeded; neighbouring intervals are tightened, too."""
    over = np.maximum(over, np.maximum(0.0, _beside(over)))
    return np.maximum(0.0, margins + np.where(over > 0.0, _MORE * over, over))


def _beside(over: Array) -> Array:
    """The larger value of both neighbouring intervals."""
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
