"""A phase of a staged problem, whose rows are general rows of the solver's core or bounds of single unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...solver.transcription import EQUALITY, INEQUALITY, NONE, CorePhase, JoinKernels, PhaseKernels
from ..problem.conditions import Conditions
from ..sizes import SizeMeter
from .kernels import point_of
from .shooting import PhaseSegment, Shooting


class Bounds(NamedTuple):
    """Rows that limit a single unknown, which the core treats as bounds.

    Attributes:
        rows: their indices among all rows of the phase.
        stages, columns: the position of the unknown; column n + m + i is unknown i of the shared ones.
        upper: whether each is an upper limit.
        limits: the limits of leaves; NaN for limits of a time or of a free parameter.
    """

    rows: Array
    stages: Array
    columns: Array
    upper: Array
    limits: Array


class StagedPhase:
    """A phase of a staged problem.

    Attributes:
        shooting: the transcribed phase.
        point: a node's states as one vector.
        stages: the indices of its stages in the whole problem; the last one is that of the join with the next phase.
        bounds: its rows that are limits of single unknowns.
        meter: measures the typical sizes of the phase.
        phase: the phase in the form of the core.
    """

    def __init__(
        self,
        segment: PhaseSegment,
        conditions: Mapping[int, Conditions],
        kernels: PhaseKernels,
        join: JoinKernels | None,
        node_rows: tuple[int, int],
        of_phase: int,
    ) -> None:
        self.shooting, self.stages = segment.shooting, segment.nodes
        self.point, self.meter = point_of(segment.shooting), SizeMeter(segment.shooting)
        self._conditions, self._join, self._kernels, self._places = conditions, join, kernels, (node_rows, of_phase)
        self.describe()

    def describe(self) -> None:
        """Describe the present rows to the core."""
        shooting = self.shooting
        self.bounds = _bounds_of_rows(shooting)
        kinds = np.where(shooting.exists, np.where(shooting.equality, EQUALITY, INEQUALITY), NONE)
        kinds[self.bounds.rows] = NONE
        self.phase = CorePhase(
            shooting.n,
            shooting.m,
            self.point.size,
            shooting.transcription.scheme,
            self._kernels,
            shooting.mesh.shares[:-1],
            shooting.mesh.widths,
            *self.by_place(kinds),
            self._join,
            *self._places,
        )

    def by_place(self, rows: Array) -> tuple[Array, list[Array]]:
        """Values of all rows of the phase, split into path rows at their points and conditions at nodes."""
        layout, K = self.shooting.layout, self.shooting.intervals
        inner, end = np.split(rows, [K * layout.per_interval])
        inner = inner.reshape(K, -1)
        path = np.zeros((K, (self.shooting.substeps + 1) * layout.path_rows), rows.dtype)
        path[:, layout.path_indices] = inner[:, : len(layout.path_indices)]
        path = path.reshape(K, self.shooting.substeps + 1, layout.path_rows)[:, :, : len(self.shooting.path.names)]
        return path, [*(inner[k, len(layout.path_indices) :][: layout.counts[k]] for k in self._conditions), end]

    def all_rows(self, path: Array, nodes: Sequence[Array], rest: float = 0.0) -> Array:
        """The inverse of `by_place`; rows that it does not contain get the value `rest`."""
        layout, K = self.shooting.layout, self.shooting.intervals
        *inner_nodes, end = nodes
        inner = np.full((K, layout.per_interval), rest)
        if path.size:
            inner[:, : len(layout.path_indices)] = path.reshape(K, -1)[:, layout.path_indices]
        for k, values in zip(self._conditions, inner_nodes):
            inner[k, len(layout.path_indices) :][: len(values)] = values
        return np.concatenate([inner.ravel(), end])


def _bounds_of_rows(shooting: Shooting) -> Bounds:
    """The rows of a phase that limit states at nodes, controls, times or free parameters."""
    layout, path, group = shooting.layout, shooting.path, shooting.dynamics.group
    K, count, first_box = shooting.intervals, len(shooting.exists), len(path.names) - len(path.bounds)
    bounds: list[tuple[int, int, int, bool, float]] = []

    def add(row: int, path_row: int, stage: int) -> None:
        if path_row < first_box or not shooting.exists[row]:
            return
        bound = path.bounds[path_row - first_box]
        if bound.leaf not in group.slices:
            column = shooting.n + shooting.local.controls.slices[bound.leaf].start + bound.entry
        elif group.factors[bound.leaf].flat:
            column = group.slices[bound.leaf].start + bound.entry
        else:
            return
        bounds.append((row, stage, column, bound.sign > 0.0, bound.limit))

    for k in range(K):
        for place, row in shooting.start_rows():
            add(k * layout.per_interval + place, row, k)
    limits, shared = shooting.border.finite if shooting.is_last else [], np.cumsum(shooting.border.unknown) - 1
    first = count - len(limits) - len(layout.end_states)
    for place, row in enumerate(layout.end_states):
        add(first + place, int(row), K)
    for row, (entry, side) in zip(range(count - len(limits), count), limits):
        if shooting.exists[row]:
            bounds.append((row, K, shooting.n + shooting.m + int(shared[entry]), bool(side), np.nan))
    kinds = (int, int, int, bool, float)
    return Bounds(*(np.array(a, kind) for a, kind in zip(zip(*bounds) if bounds else ((),) * 5, kinds)))
