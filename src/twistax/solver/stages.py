"""Sizes of a multi-stage problem, and the positions of its parts in flat arrays."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from ..errors import TrajectoryError


@dataclasses.dataclass(frozen=True)
class Stages:
    """Sizes of a problem, for each of its N + 1 stages.

    Attributes:
        states: dimensions of the states' tangent spaces.
        controls: counts of controls; the last stage has none.
        inequalities, equalities: counts of rows h and e.
        parameters: count of parameters p, which all stages share.
        point_states: entries of a state's point, where states lie on a manifold.
    """

    states: Sequence[int]
    controls: Sequence[int]
    inequalities: Sequence[int]
    equalities: Sequence[int]
    parameters: int = 0
    point_states: Sequence[int] | None = None

    def __post_init__(self) -> None:
        counts = (self.states, self.controls, self.inequalities, self.equalities, self.point_states or self.states)
        if len(set(map(len, counts))) != 1 or len(self.states) < 2:
            raise TrajectoryError(f"Stages expects lists of one length, 2 or more, got {[len(c) for c in counts]}")
        if min(map(min, counts)) < 0 or self.parameters < 0:
            raise TrajectoryError("Stages expects counts of 0 or more")
        if self.controls[-1] != 0:
            raise TrajectoryError(f"Stages: the last stage has no controls, got {self.controls[-1]}")

    @functools.cached_property
    def variables(self) -> int:
        """Entries of v."""
        return sum(self.states) + sum(self.controls) + self.parameters

    @functools.cached_property
    def points(self) -> int:
        """Entries of z, which has points in place of states."""
        return sum(self.point_states or self.states) + sum(self.controls) + self.parameters

    @functools.cached_property
    def first(self) -> Array:
        """Where each stage begins in v."""
        widths = np.array(self.states) + np.array(self.controls)
        return np.asarray(np.cumsum(widths) - widths)

    @functools.cached_property
    def first_point(self) -> Array:
        """Where each stage begins in z."""
        widths = np.array(self.point_states or self.states) + np.array(self.controls)
        return np.asarray(np.cumsum(widths) - widths)

    @functools.cached_property
    def columns(self) -> list[int]:
        """Columns of each stage's derivatives: x_k, u_k, p."""
        return [x + u + self.parameters for x, u in zip(self.states, self.controls)]

    @functools.cached_property
    def after(self) -> list[int]:
        """States of the stage after each one."""
        return [*self.states[1:], 0]

    @functools.cached_property
    def first_defect(self) -> Array:
        """Where the defects of each stage begin."""
        return np.asarray(np.cumsum(self.after) - self.after)

    @functools.cached_property
    def first_slope(self) -> Array:
        """Where the derivatives of the defects of each stage begin."""
        sizes = np.array(self.after) * np.array(self.columns)
        return np.asarray(np.cumsum(sizes) - sizes)

    @functools.cached_property
    def runs(self) -> list[slice]:
        """Consecutive stages whose counts are all the same: their blocks have one shape."""
        points = self.point_states or self.states
        counts = np.array([self.states, self.controls, self.inequalities, self.equalities, self.after, points])
        begins = np.flatnonzero((np.diff(counts) != 0).any(axis=0)) + 1
        ends = [0, *begins.tolist(), len(self.states)]
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    @functools.cached_property
    def row_counts(self) -> tuple[int, int, int]:
        """Defects, inequalities and equalities of all stages."""
        return sum(self.after), sum(self.inequalities), sum(self.equalities)

    @functools.cached_property
    def slope_sizes(self) -> list[int]:
        """Entries of the derivatives of all defects, inequalities and equalities."""
        return [self.block_sizes(rows) for rows in (self.after, self.inequalities, self.equalities)]

    @functools.cached_property
    def hessian_size(self) -> int:
        """Entries of the second derivatives of all stages."""
        return self.block_sizes(self.columns)

    def block_sizes(self, rows: Sequence[int]) -> int:
        """Entries of a block (rows, columns) of each stage, one after the other."""
        return sum(r * n for r, n in zip(rows, self.columns))
