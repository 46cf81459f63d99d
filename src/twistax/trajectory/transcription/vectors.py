"""Named arrays as one vector, the form in which compiled functions read them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...expr import Control, State
from ...groups import Euclidean
from .iterate import Instance, PhaseEnds

#: The rotation angle in rad that counts as the typical size of a rotation, at which its tangent space has changed
#: noticeably.
_TURN = 0.5


def declared_scales(leaves: Sequence[State | Control]) -> Array:
    """The declared scales of all tangents as one vector; by default 1, and half a radian for rotations."""
    parts = [np.zeros(0)]
    for leaf in leaves:
        group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
        parts.append(np.where(group.sized | group.flat, 1.0, _TURN) if leaf.scale is None else np.ravel(leaf.scale))
    return np.concatenate(parts)


class Flat:
    """Named arrays as one vector, in the order of the names."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self.shapes = dict(shapes)
        sizes = [math.prod(shape) for shape in self.shapes.values()]
        self.size = sum(sizes)
        self._ends = np.cumsum([0, *sizes]).tolist()

    def places(self, name: str) -> Array:
        """The index range of an array in the vector."""
        k = list(self.shapes).index(name)
        return np.arange(self._ends[k], self._ends[k + 1])

    def split(self, vector: Any) -> dict[str, Any]:
        """The arrays of a vector (..., size)."""
        places = zip(self.shapes.items(), self._ends, self._ends[1:])
        return {name: vector[..., a:b].reshape(*vector.shape[:-1], *shape) for (name, shape), a, b in places}

    def joined(self, arrays: Mapping[str, Any], axes: int = 0) -> Array:
        """The vector (..., size) of arrays with this number of leading axes."""
        flat = [np.reshape(arrays[name], (*np.shape(arrays[name])[:axes], -1)) for name in self.shapes]
        return np.concatenate(flat, axis=-1, dtype=float) if flat else np.zeros(0)


class Numbers:
    """The data of a solve as one vector: parameters, then for each phase its initial and final states and the limits of
    its duration, then the limits of free parameters.

    Args:
        points: a node's states, for each phase.
        instance: data of a solve, for shapes.
        by_node: for each phase the `ByNode` of the parameters with a value for each node. Their rows follow the
            numbers.

    Attributes:
        size: of the vector without these rows.
        names: the parameters in order.
        key: equal for vectors of the same layout.
        duration_places: (phases, 2) the indices of the limits of durations, which are equal for a fixed duration.
    """

    def __init__(self, points: Sequence[Flat], instance: Instance, by_node: Sequence[Any]) -> None:
        self._by_node = by_node
        with_rows = {name for part in by_node for name in part.leaves}
        self._params = Flat({name: np.shape(value) for name, value in instance.params.items() if name not in with_rows})
        self._points, self._limits = points, np.shape(instance.limits)
        of_phases = [size for point in points for size in (point.size, point.size, 2)]
        sizes = [self._params.size, *of_phases, math.prod(self._limits) - 2 * len(points)]
        self._ends = np.cumsum([0, *sizes]).tolist()
        self.duration_places = np.array(self._ends[3:-1:3])[:, None] + np.arange(2)
        self.size = self._ends[-1]
        self._last: tuple[Instance | None, Array] = None, np.zeros(0)
        self.names = tuple(self._params.shapes)
        self.key = (*(tuple(p.shapes.values()) for p in (self._params, *points)), self._limits)

    def vector(self, instance: Instance) -> Array:
        """The numbers of a solve."""
        known, vector = self._last
        if known is instance:
            return vector
        ends = (
            instance.final if isinstance(instance.final, PhaseEnds) else PhaseEnds((instance.final,), (instance.final,))
        )
        parts = [self._params.joined(instance.params)]
        durations, of_free = np.split(np.asarray(instance.limits), [len(self._points)])
        for point, initial, final, limits in zip(self._points, ends.initial, ends.final, durations):
            parts += [point.joined(initial), point.joined(final), limits]
        rows = [part.rows(instance.params).ravel() for part in self._by_node]
        vector = np.concatenate([*parts, of_free.ravel(), *rows])
        vector.flags.writeable = False
        self._last = instance, vector
        return vector

    def node_rows(self, phase: int) -> tuple[int, int]:
        """The index of the first row of a phase's nodes, and the number of entries of a row."""
        sizes = [part.width * len(part.shares) for part in self._by_node[:phase]]
        return self.size + sum(sizes), self._by_node[phase].width

    def places(self, params: Iterable[str], final: Iterable[str], phase: int = -1) -> Array:
        """The index ranges of the parameters, and of the final states of a phase, by default the last one."""
        number = phase % len(self._points)
        of_final = [self._ends[2 + 3 * number] + self._points[number].places(name) for name in final]
        return np.concatenate([np.zeros(0, int), *map(self._params.places, params), *of_final])

    def params(self, vector: Any) -> dict[str, Any]:
        return self._params.split(self._part(vector, 0))

    def of_phase(self, phase: int) -> slice:
        """The numbers of a phase: its initial and final states, then the limits of its duration."""
        return slice(self._ends[1 + 3 * phase], self._ends[4 + 3 * phase])

    def final(self, vector: Any, phase: int) -> dict[str, Any]:
        return self._points[phase].split(self._part(vector, 2 + 3 * phase))

    def limits(self, vector: Any) -> Any:
        """(g, 2) the limits of the shared unknowns."""
        xp = np if isinstance(vector, Array) else jnp
        parts = [self._part(vector, k) for k in (*range(3, len(self._ends) - 1, 3), len(self._ends) - 2)]
        return xp.concatenate(parts).reshape(self._limits)

    def at_times(self, vector: Array, border: Array) -> Array:
        """The numbers of a solve with other fixed durations, taken from the shared unknowns."""
        vector = vector.copy()
        vector[self.duration_places] = np.reshape(border, (-1, 1))[: len(self._points)]
        return vector

    @property
    def final_time(self) -> Array:
        """The index of the fixed duration of a problem of one phase, which is stored as both limits."""
        places: Array = self.duration_places[0]
        return places

    def _part(self, vector: Any, k: int) -> Any:
        return vector[self._ends[k] : self._ends[k + 1]]
