"""The distances of many pairs of convex solids by one search: the solids are entries of a table, and their numbers are
arguments of the search. The sizes of cylinders are arguments, too.

A search with the corners of both solids as constants is compiled anew for each pair. Here all pairs of a table share
one. The arrays of the solids are padded to equal lengths by copies of their first entries, which change neither the
farthest corner nor the face or the pair of edges of least depth.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...expr import Concat, Constant, Expr, Reshaped
from ...expr.functions.function import Function
from ...expr.lie import Inverse
from ...scalar.fast import searched
from ...view import Cylinder
from .cylinder import CylinderPose, cylinder_search
from .cylinder_pair import search_of_cylinders
from .cylinder_search import Facets, facets_of
from .gjk import at
from .polytope import ConvexPolytope, NearestFeatures, core_of, distance_of, features_of, root, size_key, size_of
from .separating_axes import Hull
from .solids import Core, Rounded

#: The most entries of an array of a table, because kernels have no larger arrays.
_LARGEST = 4096

_Search: TypeAlias = tuple[Callable[[jax.Array], Any], Callable[[jax.Array, Any], jax.Array]]


class PolytopeTable:
    """Tables of polytopes, boxes, capsules and balls.

    Args:
        far: None, or the distance, m, of the broad phase: if the spheres around two solids are farther apart, the
            search ends at once, and the distance is that of the spheres.
    """

    def __init__(self, solids: Iterable[Rounded | ConvexPolytope], far: float | None = None) -> None:
        self._far = far
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
        cores = self._cores[size_key(a)], self._cores[size_key(b)]
        radius, spheres = cores[0].radius + cores[1].radius, [_sphere(core) for core in cores]
        return self._of((first, second), lambda: _search(first, second), T, [i, j], spheres, radius)

    def distance_of_cylinder(self, a: Cylinder, b: Rounded | ConvexPolytope | Cylinder, T: Expr) -> Expr:
        """The signed distance () of a cylinder and a solid of the tables that is no ball, or a cylinder whose radius is
        not smaller, if T is the pose of b in the frame of a.
        """
        radius, height = float(a.radius), 0.5 * float(a.length)
        if isinstance(b, Cylinder):
            sizes = [radius, float(b.radius), height, 0.5 * float(b.length)]
            return self._of((Cylinder, Cylinder), search_of_cylinders, T, sizes, [_around(a), _around(b)], 0.0)
        (table, i), core = self._places[size_key(b)], self._cores[size_key(b)]
        spheres = [_around(a), _sphere(core)]
        search = functools.partial(_search_of_cylinder, table)
        return self._of((Cylinder, table), search, T, [radius, height, i], spheres, core.radius)

    def _of(
        self,
        key: tuple[Any, Any],
        search: Callable[[], _Search],
        T: Expr,
        numbers: Sequence[float | int],
        spheres: Sequence[tuple[NDArray[np.float64], float]],
        radius: float,
    ) -> Expr:
        """The signed distance () by the search of a pair of tables.

        Args:
            numbers: the arguments of the search after the pose.
            spheres: the centres and radii of spheres around both cores.
            radius: the sum of the radii that the cores do not have.
        """
        if key not in self._functions:
            function = searched(*(search() if self._far is None else _within(*search())))
            self._functions[key] = Function(function, (), name="signed_distance")
        if self._far is not None:
            (a, size_a), (b, size_b) = spheres
            numbers = [*numbers, *a, *b, size_a + size_b, self._far + radius]
        return self._functions[key](Concat(Reshaped(T[:3], (12,)), Constant(np.array(numbers, float)))) - radius


def _sphere(core: Core) -> tuple[NDArray[np.float64], float]:
    """The centre and the radius of a sphere around a core, in its frame."""
    middle = 0.5 * (core.corners.min(axis=0) + core.corners.max(axis=0))
    return middle, float(np.linalg.norm(core.corners - middle, axis=1).max())


def _around(cylinder: Cylinder) -> tuple[NDArray[np.float64], float]:
    return np.zeros(3), float(np.hypot(cylinder.radius, 0.5 * cylinder.length))


def _within(search: Callable[[jax.Array], Any], formula: Callable[[jax.Array, Any], jax.Array]) -> _Search:
    """A search that ends at once if the spheres around both cores are farther apart than a limit, and the formula,
    which then is the distance of the spheres.

    The last entries of their argument are both centres (3,), the sum of the radii and the limit.
    """

    def between(x: jax.Array) -> jax.Array:
        T, a, b = x[:12].reshape(3, 4), x[-8:-5], x[-5:-2]
        w = T[:, :3] @ b + T[:, 3] - a
        return root(w @ w) - x[-2]

    def or_none(x: jax.Array) -> tuple[jax.Array, Any]:
        none = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(search, x))
        is_far = between(x) > x[-1]
        return is_far, jax.lax.cond(is_far, lambda: none, lambda: search(x))

    def value(x: jax.Array, result: tuple[jax.Array, Any]) -> jax.Array:
        return jnp.where(result[0], between(x), formula(x, result[1]))

    return or_none, value


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


def _search(first: _Table, second: _Table) -> _Search:
    """The search for the nearest features of cores of two tables, and the formula of their distance (), of x: the first
    three rows of the pose of the second core in the frame of the first, and their numbers.
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

    return search, lambda x, features: distance_of(features, x[:12].reshape(3, 4))


def _search_of_cylinder(table: _Table) -> _Search:
    """The search for the nearest features of a cylinder and a core of a table, and the formula of their distance (), of
    x: the first three rows of the pose of the core in the frame of the cylinder, the radius and half the length of the
    cylinder, and the number of the core.
    """
    return cylinder_search(
        lambda x: CylinderPose(x[12], x[13], x[:12].reshape(3, 4)),
        lambda x: table.facets(x[14].astype(np.int32), x.dtype),
    )
