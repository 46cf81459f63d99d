"""The shift of a plan by one interval: for each entry of an iterate, the index of the entry that replaces it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy import ndarray as Array

from ...solver.prepared import PreparedSolve
from ...solver.transcription import EQUALITY, INEQUALITY
from ..transcription.evaluation import Evaluated, moved
from ..transcription.staged import Staged


class Shift:
    """Shifts the iterate of a prepared solve by one interval.

    Controls, multipliers and slacks of an interval are replaced by those of the next one. The last control is repeated,
    and the last state is integrated with it, by the problem's transcription. A continuous control stays at its last
    value.

    Args:
        staged: a problem of one phase, with nodes at equal distances.
        rates: the names of the rates of continuous controls.

    Attributes:
        points, variables, defects, rows, equalities: for each entry the index of its value one interval later.
        resting: the indices in z and in v, (2, entries), of these rates in the last interval, which become zero.
    """

    def __init__(self, staged: Staged, rates: Iterable[str]) -> None:
        self._staged, transcription = staged, staged.transcription
        stages, phase = transcription.stages, transcription.phases[0]
        points = stages.point_states or stages.states
        shared = np.arange(stages.parameters)
        self.points = _stage_after(points, stages.controls, stages.points - stages.parameters + shared)
        self.variables = _stage_after(stages.states, stages.controls, stages.variables - stages.parameters + shared)
        self.defects = _interval_after(phase.n, phase.intervals)
        of_rates = [np.zeros(0, int)]
        for name in rates:
            here = staged.parts[0].shooting.local.controls.slices[name]
            of_rates.append(np.arange(here.start, here.stop))
        first = [stages.first_point[-2] + points[0], stages.first[-2] + phase.n]
        self.resting = np.array(first)[:, None] + np.concatenate(of_rates)
        counts = stages.row_counts
        path, places = phase.path, transcription.path_places[0]
        self.rows, self.equalities = (
            _row_after(np.where(path == kind, places, -1), count)
            for kind, count in zip((INEQUALITY, EQUALITY), counts[1:])
        )

    def __call__(self, solve: PreparedSolve) -> None:
        solve.z[:] = solve.z[self.points]
        for array in (solve.v, solve.zl, solve.zu):
            array[:] = array[self.variables]
        for array, places in zip((solve.z, solve.v), self.resting):
            array[places] = 0.0
        solve.lam[:] = solve.lam[self.defects]
        for array in (solve.s, solve.y):
            array[:] = array[self.rows]
        solve.ye[:] = solve.ye[self.equalities]
        self._integrate_last(solve)

    def _integrate_last(self, solve: PreparedSolve) -> None:
        """Move the last node by the defect before it, if that is finite."""
        transcription = self._staged.transcription
        stages = transcription.stages
        at, step = Evaluated(transcription, solve.z), np.zeros(stages.variables)
        gap = at.c[stages.first_defect[-2] :]
        if at.failed or not np.isfinite(gap).all():
            return
        step[stages.first[-1] : stages.first[-1] + stages.states[-1]] = gap
        solve.z[:] = moved(transcription, solve.z, step)
        solve.v[self._staged.plain[1]] = solve.z[self._staged.plain[0]]


def _stage_after(states: Sequence[int], controls: Sequence[int], shared: Array) -> Array:
    """For each entry of (x_0, u_0, ..., x_N, p), the index of the entry one stage later."""
    nodes, n, m = len(states), states[0], controls[0]
    places = np.arange(nodes * (n + m)).reshape(nodes, n + m)
    later = np.concatenate([places[1:], places[-1:]])
    later[-2:, n:] = places[-2, n:]  # the last control is repeated; the last stage has none
    return np.concatenate([later[:-1].ravel(), later[-1, :n], shared])


def _interval_after(n: int, intervals: int) -> Array:
    places = np.arange(n * intervals).reshape(intervals, n)
    return np.concatenate([places[1:], places[-1:]]).ravel()


def _row_after(places: Array, count: int) -> Array:
    """For each row, the index of the same row in the next interval, or of the row itself if there is none.

    Args:
        places: (intervals, points, rows) indices of path rows, -1 for none.
    """
    after = np.arange(count)
    here, later = places[:-1].ravel(), places[1:].ravel()
    both = (here >= 0) & (later >= 0)
    after[here[both]] = later[both]
    return after
