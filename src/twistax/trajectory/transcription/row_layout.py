"""The constraint rows of a transcribed phase and their order."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..problem.conditions import Conditions, Ends
from ..problem.statement import PathRows
from .border import Border


@dataclasses.dataclass(frozen=True)
class RowLayout:
    """The rows of all intervals, each followed by the conditions at its first node, then the rows of the end.

    Attributes:
        names, places, equality, exists, determined, at_single_node: (rows,), see `Transcribed`.
        path_indices: the indices, among the path rows of all points of an interval, of the rows that some interval has,
            in order.
        per_interval: the number of rows of an interval.
        path_rows: the number of path rows at a point, 1 if there are none.
        end_states: the path rows that are imposed at the last node.
        fixed: the tangents that the final values fix.
        counts: node -> the number of its conditions.
    """

    names: Array
    places: Array
    equality: Array
    exists: Array
    determined: Array
    at_single_node: Array
    path_indices: Array
    per_interval: int
    path_rows: int
    end_states: Array
    fixed: Array
    counts: dict[int, int]

    @property
    def at_nodes(self) -> int:
        """The number of rows of an interval that are conditions at its first node."""
        return self.per_interval - len(self.path_indices)

    def spread(self, of_rows: Array) -> Array:
        """(rows,) from values (intervals, path rows): the value of an interval at every point of it
        that has the row.
        """
        inner = np.zeros((len(of_rows), self.per_interval))
        inner[:, : len(self.path_indices)] = of_rows[:, self.path_indices % self.path_rows]
        return np.concatenate([inner.ravel(), np.zeros(len(self.names) - inner.size)])

    def least(self, of_rows: Array, intervals: int, rows: int) -> Array:
        """(intervals, path rows) the smallest value of each path row in values (rows,); infinite for missing rows."""
        least = np.full((intervals, rows), np.inf)
        sizes = of_rows[: intervals * self.per_interval].reshape(intervals, -1)[:, : len(self.path_indices)]
        np.minimum.at(least.T, self.path_indices % self.path_rows, sizes.T)
        return least


def row_layout(
    path: PathRows,
    ends: Ends,
    final: Conditions,
    at_nodes: Mapping[int, Conditions],
    border: Border,
    *,
    tangents: list[str],
    intervals: int,
    substeps: int,
    phase: int,
) -> RowLayout:
    """The layout of the rows of a phase.

    Args:
        tangents: names of the states' tangents.
        phase: the index of the phase.
    """
    free_times = border.free[: border.phases]
    known_start, known_end = not free_times[:phase].any(), not free_times[: phase + 1].any()
    points, rows = substeps + 1, len(path.names)
    exists = path.asked(intervals, substeps)
    determined = np.zeros_like(exists)
    determined[0, 0] = path.determined(ends.initial_fixed, known_start)
    exists, determined = (a.reshape(intervals, -1) for a in (exists, determined & exists))
    kept = np.flatnonzero(exists.any(axis=0))
    place = np.array([[_place(k, p, points) for p in range(points)] for k in range(intervals)])
    place = np.repeat(place.reshape(intervals, points, 1), rows, axis=2).reshape(intervals, -1)
    path_row = kept % max(rows, 1)

    most = max((len(conditions.names) for conditions in at_nodes.values()), default=0)
    node_names = np.full((intervals, most), "", object)
    node_equality, node_determined = np.zeros((2, intervals, most), bool)
    boxes = [box.name for box in border.boxes]
    for k, conditions in at_nodes.items():
        here = slice(len(conditions.names))
        node_names[k, here], node_equality[k, here] = conditions.names, conditions.equality
        if k == 0:
            node_determined[0, here] = conditions.determined(ends.initial_fixed, boxes, known_start)

    # The end: conditions, fixed entries, path rows of the last node, limits of the shared unknowns. Indices have 32
    # bits, because JAX without double precision has no others.
    states, fixed = (np.flatnonzero(a).astype(np.int32) for a in (path.at_nodes(), ends.final_mask))
    limits = border.row_names if phase == border.phases - 1 else []
    end_names = [*final.names, *(f"final {tangents[i]}" for i in fixed), *(path.names[i] for i in states), *limits]
    first = len(final.names) + len(fixed)
    end_determined = np.zeros(len(end_names), bool)
    end_determined[first : first + len(states)] = path.determined(ends.final_fixed, known_end)[states]

    def every(inner: Any, of_nodes: Any, end: Any) -> Array:
        parts = np.broadcast_to(inner, (intervals, len(kept))), np.broadcast_to(of_nodes, (intervals, most))
        return np.concatenate([np.concatenate(parts, axis=1).ravel(), end])

    all_determined = every(determined[:, kept], node_determined, end_determined)
    end_equality = [*final.equality, *[True] * len(fixed), *path.equality[states], *[False] * len(limits)]
    node_places = np.array([[f"at node {k}"] for k in range(intervals)], object)
    return RowLayout(
        names=every(np.array(path.names, object)[path_row], node_names, np.array(end_names, object)),
        places=every(place[:, kept], node_places, np.full(len(end_names), f"at node {intervals}", object)),
        equality=every(path.equality[path_row], node_equality, np.array(end_equality, bool)),
        exists=every(exists[:, kept], node_names != "", np.ones(len(end_names), bool)) & ~all_determined,
        determined=all_determined,
        at_single_node=every(
            False, node_names != "", np.repeat([True, False, True], [first, len(states), len(limits)])
        ),
        path_indices=kept,
        per_interval=len(kept) + most,
        path_rows=max(rows, 1),
        end_states=states,
        fixed=fixed,
        counts={k: len(conditions.names) for k, conditions in at_nodes.items()},
    )


def _place(interval: int, point: int, points: int) -> str:
    if point == 0:
        return f"at node {interval}"
    return f"at node {interval + 1}" if point == points - 1 else f"between nodes {interval} and {interval + 1}"
