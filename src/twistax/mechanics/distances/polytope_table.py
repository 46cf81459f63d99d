"""The distances of many pairs of convex solids by one search: the solids are entries of a table, and their numbers are
arguments of the search.

A search with the corners of both solids as constants is compiled anew for each pair. Here all pairs of a table share
one. The arrays of the solids are padded to equal lengths by copies of their first entries, which change neither the
farthest corner nor the face or the pair of edges of least depth.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...expr import Concat, Constant, Expr, Reshaped
from ...expr.functions.function import Function
from ...expr.lie import Inverse
from ...scalar.fast import searched
from .gjk import at
from .polytope import ConvexPolytope, NearestFeatures, core_of, distance_of, features_of, hull_of, size_key, size_of
from .separating_axes import Hull
from .solids import Core, Rounded

#: The most entries of an array of a table, because kernels have no larger arrays.
_LARGEST = 4096


class PolytopeTable:
    """Tables of polytopes, boxes, capsules and balls."""

    def __init__(self, solids: Iterable[Rounded | ConvexPolytope]) -> None:
        self._cores = {size_key(solid): core_of(solid) for solid in solids}
        self._places = dict[Hashable, tuple[_Table, int]]()
        by_size = sorted(self._cores, key=lambda key: len(self._cores[key].edges))
        for has_faces in (False, True):
            keys = [key for key in by_size if bool(len(self._cores[key].normals)) is has_faces]
            for some in _parted(keys, [_width(self._cores[key]) for key in keys]):
                table = _Table([self._cores[key] for key in some])
                self._places |= {key: (table, number) for number, key in enumerate(some)}
        self._functions = dict[tuple[_Table, _Table], Function]()

    def distance(self, a: Rounded | ConvexPolytope, b: Rounded | ConvexPolytope, T: Expr) -> Expr:
        """The signed distance () of two solids of the tables, if T is the pose of b in the frame of a. One of them has
        faces.
        """
        if not len(self._cores[size_key(a)].normals):
            a, b, T = b, a, Inverse(T)
        (first, i), (second, j) = self._places[size_key(a)], self._places[size_key(b)]
        if (first, second) not in self._functions:
            self._functions[first, second] = Function(_distance(first, second), (), name="signed_distance")
        radius = self._cores[size_key(a)].radius + self._cores[size_key(b)].radius
        numbers = Constant(np.array([i, j], float))
        return self._functions[first, second](Concat(Reshaped(T[:3], (12,)), numbers)) - radius


def _width(core: Core) -> int:
    """The most entries of an array of a core."""
    return 3 * max(len(core.corners), len(core.edges), len(core.normals))


def _parted(keys: Sequence[Hashable], widths: Sequence[int]) -> list[list[Hashable]]:
    """Successive keys together whose padded arrays are small enough."""
    parts: list[list[Hashable]] = []
    for key, width in zip(keys, widths):
        if not parts or (len(parts[-1]) + 1) * width > _LARGEST:
            parts.append([])
        parts[-1].append(key)
    return parts


class _Table:
    """The arrays of some cores, padded to the largest of each kind."""

    def __init__(self, cores: Sequence[Core]) -> None:
        hulls = [jax.tree.map(np.asarray, hull_of(core)) for core in cores]
        leaves, structure = zip(*map(jax.tree.flatten, hulls))
        self._arrays: Hull = jax.tree.unflatten(structure[0], [_padded(arrays) for arrays in zip(*leaves)])
        self._sizes = np.array([size_of(core) for core in cores])

    def corners(self, number: jax.Array, dtype: Any) -> jax.Array:
        return at(jnp.asarray(self._arrays.corners, dtype), number)

    def hull(self, number: jax.Array, dtype: Any) -> Hull:
        hull: Hull = jax.tree.map(
            lambda x: at(jnp.asarray(x, dtype), number) if x.size else jnp.zeros(x.shape[1:], dtype), self._arrays
        )
        return hull

    def size(self, number: jax.Array, dtype: Any) -> jax.Array:
        return at(jnp.asarray(self._sizes, dtype), number)


def _padded(arrays: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Arrays of several lengths as one, padded with copies of the first entry; an empty array is padded with zeros."""
    length = max(map(len, arrays))
    first = [a[:1] if len(a) else np.zeros((1, *a.shape[1:])) for a in arrays]
    copies = [np.repeat(row, length - len(a), axis=0) for row, a in zip(first, arrays)]
    return np.stack([np.concatenate(pair) for pair in zip(arrays, copies)])


def _distance(first: _Table, second: _Table) -> Any:
    """The distance () of cores of two tables, of x (14,): the first three rows of the pose of the second core in the
    frame of the first, and their numbers.
    """

    def search(x: jax.Array) -> NearestFeatures:
        i, j = (x[k].astype(np.int32) for k in (12, 13))
        return features_of(
            lambda: (first.hull(i, x.dtype), second.hull(j, x.dtype)),
            first.corners(i, x.dtype),
            second.corners(j, x.dtype),
            x[:12].reshape(3, 4),
            first.size(i, x.dtype) + second.size(j, x.dtype),
        )

    return searched(search, lambda x, features: distance_of(features, x[:12].reshape(3, 4)))
