"""The distances of many pairs of convex solids by one search: the solids are entries of a table, and their numbers are
arguments of the search. The sizes of cylinders are arguments, too.

A search with the corners of both solids as constants is compiled anew for each pair. Here all pairs of a table share
one. The arrays of the solids are padded to equal lengths by copies of their first entries, which change neither the
farthest corner nor the face or the pair of edges of least depth.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...expr import Concat, Constant, Expr, Reshaped
from ...expr.functions.function import Function
from ...expr.lie import Inverse
from ...scalar.fast import searched
from ...view import Cylinder
from .cylinder import CylinderPose, cylinder_distance
from .cylinder_pair import cylinders_of_sizes
from .cylinder_search import Facets, facets_of
from .gjk import at
from .polytope import ConvexPolytope, NearestFeatures, core_of, distance_of, features_of, size_key, size_of
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
        self._functions = dict[tuple[Any, Any], Function]()

    def distance(self, a: Rounded | ConvexPolytope, b: Rounded | ConvexPolytope, T: Expr) -> Expr:
        """The signed distance () of two solids of the tables, if T is the pose of b in the frame of a. One of them has
        faces.
        """
        if not len(self._cores[size_key(a)].normals):
            a, b, T = b, a, Inverse(T)
        (first, i), (second, j) = self._places[size_key(a)], self._places[size_key(b)]
        radius = self._cores[size_key(a)].radius + self._cores[size_key(b)].radius
        return self._of((first, second), lambda: _distance(first, second), T, [i, j]) - radius

    def distance_of_cylinder(self, a: Cylinder, b: Rounded | ConvexPolytope | Cylinder, T: Expr) -> Expr:
        """The signed distance () of a cylinder and a solid of the tables that is no ball, or a cylinder whose radius is
        not smaller, if T is the pose of b in the frame of a.
        """
        radius, height = float(a.radius), 0.5 * float(a.length)
        if isinstance(b, Cylinder):
            sizes = [radius, float(b.radius), height, 0.5 * float(b.length)]
            return self._of((Cylinder, Cylinder), cylinders_of_sizes, T, sizes)
        table, i = self._places[size_key(b)]
        d = self._of((Cylinder, table), lambda: _distance_of_cylinder(table), T, [radius, height, i])
        return d - self._cores[size_key(b)].radius

    def _of(self, key: tuple[Any, Any], distance: Callable[[], Any], T: Expr, numbers: Sequence[float | int]) -> Expr:
        """The value () of the function of a pair of tables."""
        if key not in self._functions:
            self._functions[key] = Function(distance(), (), name="signed_distance")
        return self._functions[key](Concat(Reshaped(T[:3], (12,)), Constant(np.array(numbers, float))))


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
        every = [jax.tree.map(np.asarray, facets_of(core)) for core in cores]
        leaves, structure = zip(*map(jax.tree.flatten, every))
        self._arrays: Facets = jax.tree.unflatten(structure[0], [_padded(arrays) for arrays in zip(*leaves)])
        self._sizes = np.array([size_of(core) for core in cores])

    def corners(self, number: jax.Array, dtype: Any) -> jax.Array:
        return at(jnp.asarray(self._arrays.hull.corners, dtype), number)

    def hull(self, number: jax.Array, dtype: Any) -> Hull:
        return self._entry(self._arrays.hull, number, dtype)

    def facets(self, number: jax.Array, dtype: Any) -> Facets:
        return self._entry(self._arrays, number, dtype)

    def _entry(self, arrays: Any, number: jax.Array, dtype: Any) -> Any:
        return jax.tree.map(
            lambda x: at(jnp.asarray(x, dtype), number) if x.size else jnp.zeros(x.shape[1:], dtype), arrays
        )

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


def _distance_of_cylinder(table: _Table) -> Any:
    """The distance () of a cylinder and a core of a table, of x (15,): the first three rows of the pose of the core in
    the frame of the cylinder, the radius and half the length of the cylinder, and the number of the core.
    """
    return cylinder_distance(
        lambda x: CylinderPose(x[12], x[13], x[:12].reshape(3, 4)),
        lambda x: table.facets(x[14].astype(np.int32), x.dtype),
    )
