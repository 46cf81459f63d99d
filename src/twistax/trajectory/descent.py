"""Where a run is beside its start: whether it goes on without end, and what is left of excursions on the way.

Every unknown counts in units of its own size at the start, so nothing hangs on units. One with limits on both sides
does not run off: where all have them nothing is without end. All of it is traceable.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from .iterate import Scales
from .iterate import State as Iterate
from .magnitudes import largest_along
from .transcribed import Point, Transcribed


class Begun(NamedTuple):
    """Where a run began."""

    sizes: Any  # of every unknown
    cost: Any
    scale: Any  # of the cost


class Descent:
    """How far runs of a problem are from their starts."""

    def __init__(self, shooting: Transcribed) -> None:
        self._shooting = shooting
        limits = [_limits(leaf) for part in shooting.segments for leaf in part.shooting.leaves.values()]
        self._open = ~np.isfinite(np.concatenate([shooting.border.limits, *limits])).all(axis=1)

    def begun(self, start: Iterate) -> Begun:
        sizes = jnp.maximum(self._largest(start.point), self._scales(start.scales))
        return Begun(sizes, start.values.cost, start.scales.cost)

    def nothing(self) -> Begun:
        """In place of a start, where there is none."""
        return Begun(np.ones(len(self._open)), np.zeros(()), np.ones(()))

    def beyond(self, begun: Begun, state: Iterate, far: float) -> jax.Array:
        """Whether an unknown is more than so many times as large, and the objective lower by the root of it, scaled."""
        lower = state.values.cost < begun.cost - far**0.5 * begun.scale
        grown = self._largest(state.point) / begun.sizes
        return lower & (jnp.where(self._open, grown, 0.0).max(initial=0.0) > far)

    def gaps(self, begun: Begun, state: Iterate) -> jax.Array:
        """The largest gap of the dynamics over the largest size of its state, now or at the start."""
        sizes, defects = self._known(begun, state), jnp.abs(state.values.defects)
        found, first = [jnp.zeros(())], self._shooting.border.size
        for part in self._shooting.segments:
            own, arrivals = part.shooting, slice(max(part.nodes.start - 1, 0), part.nodes.stop - 1)
            found.append((defects[arrivals, : own.n] / sizes[None, first : first + own.n]).max(initial=0.0))
            first += own.n + own.m
        return jnp.stack(found).max()

    def _known(self, begun: Begun, state: Iterate) -> jax.Array:
        return jnp.maximum(self._largest(state.point), begun.sizes)

    def _largest(self, point: Point) -> jax.Array:
        """The largest magnitude of every unknown along its phase, zero of rotations: border, then phases."""
        return jnp.concatenate(
            [jnp.abs(point.border), *(largest_along(part, point) for part in self._shooting.segments)]
        )

    def _scales(self, scales: Scales) -> jax.Array:
        """The scales of the same."""
        found = [scales.border]
        for part in self._shooting.segments:
            own = part.shooting
            found += [scales.d[part.nodes, : own.n].max(axis=0), scales.u[part.stages, : own.m].max(axis=0)]
        return jnp.concatenate(found)


def _limits(leaf: State | Control) -> Array:
    """(dimension, 2) of a leaf, infinite where it has none."""
    dimension = leaf.group.dimension if isinstance(leaf, State) else int(np.prod(leaf.shape))
    sides = [np.full(dimension, np.inf) if side is None else np.ravel(side) for side in (leaf.min, leaf.max)]
    return np.stack(sides, axis=1)
