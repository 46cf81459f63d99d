"""Where a run is beside its start: whether it goes on without end, and what is left of excursions on the way.

Every unknown counts in units of its own size at the start, so nothing hangs on units. One with limits on both sides
does not run off: where all have them nothing is without end.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from ..groups import Euclidean, SpecialEuclidean
from .iterate import Scales
from .iterate import State as Iterate
from .transcribed import Point, Segment, Transcribed


class Descent:
    """How far a run is from its start."""

    def __init__(self, shooting: Transcribed, start: Iterate) -> None:
        self._shooting = shooting
        limits = [_limits(leaf) for part in shooting.segments for leaf in part.shooting.leaves.values()]
        self._open = ~np.isfinite(np.concatenate([shooting.border.limits, *limits])).all(axis=1)
        self._begun = np.maximum(self._largest(start.point), self._scales(start.scales))
        self._cost, self._scale = float(start.values.cost), float(start.scales.cost)

    @np.errstate(over="ignore", invalid="ignore")
    def beyond(self, state: Iterate, far: float) -> bool:
        """Whether an unknown is more than so many times as large, and the objective lower by the root of it, scaled."""
        if not float(state.values.cost) < self.low(far):
            return False
        grown = self._largest(state.point) / self._begun
        return bool(grown[self._open].max(initial=0.0) > far)

    def low(self, far: float) -> float:
        """The objective that is lower by the root of so much."""
        return self._cost - far**0.5 * self._scale

    def gaps(self, state: Iterate) -> float:
        """The largest gap of the dynamics over the largest size of its state, now or at the start."""
        sizes, defects = self._known(state), np.abs(state.values.defects)
        found, first = 0.0, self._shooting.border.size
        for part in self._shooting.segments:
            own, arrivals = part.shooting, slice(max(part.nodes.start - 1, 0), part.nodes.stop - 1)
            shares = defects[arrivals, : own.n] / sizes[first : first + own.n]
            found, first = max(found, float(shares.max(initial=0.0))), first + own.n + own.m
        return found

    def inflated(self, state: Iterate, factor: float) -> bool:
        """Whether a scale is so many times as large as its unknown, now and at the start: one of an excursion."""
        return bool((self._scales(state.scales) > factor * self._known(state)).any())

    def _known(self, state: Iterate) -> Array:
        return np.maximum(self._largest(state.point), self._begun)

    def _largest(self, point: Point) -> Array:
        """The largest magnitude of every unknown along its phase, zero of rotations: border, then phases."""
        return np.concatenate([np.abs(point.border), *(_along(part, point) for part in self._shooting.segments)])

    def _scales(self, scales: Scales) -> Array:
        """The scales of the same."""
        found, d, u = [np.asarray(scales.border)], np.asarray(scales.d), np.asarray(scales.u)
        for part in self._shooting.segments:
            own = part.shooting
            found += [d[part.nodes, : own.n].max(axis=0), u[part.stages, : own.m].max(axis=0)]
        return np.concatenate(found)


def _along(part: Segment, point: Point) -> Array:
    """Of the states and controls of a phase."""
    own, group, found = part.of(point), part.shooting.dynamics.group, []
    for name, factor in group.factors.items():
        values, most = np.asarray(own.xs[name]), np.zeros(factor.dimension)
        if isinstance(factor, Euclidean):
            most = np.abs(values.reshape(len(values), -1)).max(axis=0)
        elif isinstance(factor, SpecialEuclidean):
            away = np.linalg.norm(values[:, :3, 3], axis=1).max()
            most = np.where(part.shooting.turns[group.slices[name]], 0.0, away)
        found.append(most)
    return np.concatenate([*found, np.abs(own.us).max(axis=0)])


def _limits(leaf: State | Control) -> Array:
    """(dimension, 2) of a leaf, infinite where it has none."""
    dimension = leaf.group.dimension if isinstance(leaf, State) else int(np.prod(leaf.shape))
    sides = [np.full(dimension, np.inf) if side is None else np.ravel(side) for side in (leaf.min, leaf.max)]
    return np.stack(sides, axis=1)
