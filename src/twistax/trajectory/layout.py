"""Which rows a transcribed phase has, where they stand, and which of its unknowns may move."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from .border import Border
from .problem.conditions import Conditions, Ends
from .problem.statement import PathRows


@dataclasses.dataclass(frozen=True)
class Layout:
    """The rows of all intervals, each with those of conditions at its first node after its own, then those of the end.

    Attributes:
        names, places, equality, exists, decided, own: (rows,), see `Transcribed`.
        asked: of the path rows at all points of an interval one after the other, those that some interval has.
        per_interval: rows of an interval.
        path_rows: path rows at a point, 1 where the path has no rows.
        end_states: path rows that the last node has.
        fixed: tangents that the final values fix.
        counts: node -> how many conditions it has.
    """

    names: Array
    places: Array
    equality: Array
    exists: Array
    decided: Array
    own: Array
    asked: Array
    per_interval: int
    path_rows: int
    end_states: Array
    fixed: Array
    counts: dict[int, int]

    @property
    def at_nodes(self) -> int:
        """Of the rows of an interval those of conditions at its first node."""
        return self.per_interval - len(self.asked)

    def spread(self, of_rows: Array) -> Array:
        """(rows,) of numbers (intervals, path rows), at every point of an interval where a row is asked."""
        found = np.zeros((len(of_rows), self.per_interval))
        found[:, : len(self.asked)] = of_rows[:, self.asked % self.path_rows]
        return np.concatenate([found.ravel(), np.zeros(len(self.names) - found.size)])

    def least(self, of_rows: Array, intervals: int, rows: int) -> Array:
        """(intervals, path rows) the least of numbers (rows,) of each path row, infinite where it is not asked."""
        found = np.full((intervals, rows), np.inf)
        sizes = of_rows[: intervals * self.per_interval].reshape(intervals, -1)[:, : len(self.asked)]
        np.minimum.at(found.T, self.asked % self.path_rows, sizes.T)
        return found


def laid_out(
    tangents: list[str],
    intervals: int,
    substeps: int,
    path: PathRows,
    ends: Ends,
    final: Conditions,
    at_nodes: Mapping[int, Conditions],
    border: Border,
    phase: int,
) -> Layout:
    """The rows of a phase.

    Args:
        tangents: names of the states' tangents.
        phase: its number.
    """
    count, points, rows = intervals, substeps + 1, len(path.names)
    asked = path.asked(count, substeps)
    decided = np.zeros_like(asked)
    times_free = border.free[: border.phases]
    known_start = not times_free[:phase].any()
    decided[0, 0] = path.decided(ends.initial_fixed, known_start)
    flat = asked.reshape(count, -1)
    kept = np.flatnonzero(flat.any(axis=0))
    states = np.flatnonzero(path.at_nodes())
    fixed = np.flatnonzero(ends.final_mask)
    limits = border.row_names if phase == border.phases - 1 else []
    end_names = [*final.names, *(f"final {tangents[i]}" for i in fixed), *(path.names[i] for i in states), *limits]
    place = np.array([[_place(k, p, points) for p in range(points)] for k in range(count)])
    place = np.repeat(place.reshape(count, points, 1), rows, axis=2).reshape(count, -1)[:, kept]
    most = max((len(own.names) for own in at_nodes.values()), default=0)
    node_names = np.full((count, most), "", object)
    node_equality, node_decided = np.zeros((2, count, most), bool)
    loose = [box.name for box in border.boxes]
    for k, own in at_nodes.items():
        here = slice(len(own.names))
        node_names[k, here], node_equality[k, here] = own.names, own.equality
        if k == 0:
            node_decided[0, here] = own.decided(ends.initial_fixed, loose, known_start)
    node_places = np.repeat(np.array([[f"at node {k}"] for k in range(count)], object), most, axis=1)

    def joined(inner: Any, at_node: Array, end: Any) -> Array:
        return np.concatenate([np.concatenate([inner, at_node], axis=1).ravel(), end])

    inner_names = np.tile(np.array(path.names, object)[kept % max(rows, 1)], (count, 1))
    inner_equality = np.tile(path.equality[kept % max(rows, 1)], (count, 1))
    end_equality = [*final.equality, *[True] * len(fixed), *path.equality[states], *[False] * len(limits)]
    end_decided = np.zeros(len(end_names), bool)
    first = len(final.names) + len(fixed)
    end_decided[first : first + len(states)] = path.decided(ends.final_fixed, not times_free[: phase + 1].any())[states]
    # Rows of single nodes: conditions, fixed entries, limits of the border.
    end_own = np.repeat([True, False, True], [first, len(states), len(limits)])
    all_decided = joined((decided.reshape(count, -1) & flat)[:, kept], node_decided, end_decided)
    every = joined(flat[:, kept], node_names != "", np.ones(len(end_names), bool))
    return Layout(
        names=joined(inner_names, node_names, np.array(end_names, object)),
        places=joined(place, node_places, np.full(len(end_names), f"at node {count}", object)),
        equality=joined(inner_equality, node_equality, np.array(end_equality, bool)),
        exists=every & ~all_decided,
        decided=all_decided,
        own=joined(np.zeros((count, len(kept)), bool), node_names != "", end_own),
        asked=kept,
        per_interval=len(kept) + most,
        path_rows=max(rows, 1),
        end_states=states,
        fixed=fixed,
        counts={k: len(own.names) for k, own in at_nodes.items()},
    )


def _place(interval: int, point: int, points: int) -> str:
    if point == 0:
        return f"at node {interval}"
    return f"at node {interval + 1}" if point == points - 1 else f"between nodes {interval} and {interval + 1}"
