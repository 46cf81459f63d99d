"""The signed distance of two solids, as an expression with derivatives of all orders.

If two cores are separate, their nearest points are a corner of one and its projection onto the other, or points of two
edges. So the square of the distance is the minimum of

    |c - clip(c, -h, h)|^2        |w|^2 - [d e] [1 -b; -b 1]^-1 [d e]^T

over the corners c of one core in the frame of the other, whose half lengths are h, and over pairs of edges whose
nearest points lie within both. Here w is the vector between the edges' centres, b the cosine of the angle between them,
and d and e are the components of w along them. If a core has a volume, the depth follows from the separating axes: it
is the maximum, over the faces' normals and the cross products of edges n, of

    |n . p| - sum_i h_i |n . a_i| - sum_j h_j |n . b_j|,

which is negative if the cores overlap.

Source: C. Ericson, Real-Time Collision Detection (2005), sections 4.4.1, 5.1.3 and 5.1.9.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Hashable
from typing import Any, TypeAlias

import numpy as np

from ...checks import short
from ...errors import ModelError
from ...expr import Abs, Constant, Cross, Dot, Expr, Max, Min, Sqrt, State, Where
from ...expr.fields import ExprLike
from ...expr.functions.function import Function
from ...expr.lie import Compose, Inverse
from ...system.lower import lower
from ...view import Cylinder, Shape, Sphere
from ..arguments import pose
from .cylinder import cylinder_to_core, over_plane
from .cylinder_pair import cylinder_to_cylinder
from .distance_grid import DistanceGrid
from .polytope import ConvexPolytope, core_of, distance, size_key
from .polytope_table import PolytopeTable
from .solids import HalfSpace, Rounded, rounded

#: For edges whose squared sine is smaller, corners are as near as the edges.
_PARALLEL = 1e-14
#: The squared distance in m2 of pairs of edges whose nearest points lie beyond their ends.
_FAR = Constant(1e12)
_UNIT = np.eye(3)


#: Solids with a distance function.
Solid: TypeAlias = Shape | HalfSpace | ConvexPolytope | DistanceGrid


def signed_distance(a: Solid, b: Solid, T_a: ExprLike | None = None, T_b: ExprLike | None = None) -> Expr:
    """The distance () of two solids, m; a negative value is the depth of penetration.

    For separate cores with half lengths h the distance is the minimum over corners and pairs of edges. If they overlap
    and one is a box, it is the maximum over the separating axes n of $|n . p| - sum h |n . a|$. The radii are
    subtracted. For two capsules or balls the depth is at most the sum of the radii. The depth of a cylinder is the
    length of the shortest translation that separates the solids. The distance is continuous, and smooth except where
    the nearest features change.

    Sources: C. Ericson, Real-Time Collision Detection (2005), sections 4.4.1, 5.1.3 and 5.1.9; of cylinders D. Eberly,
    Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid, section 2 (2013).

    Args:
        a, b: `tx.view.Sphere`, `Capsule`, `Box` or `Cylinder`, `ConvexPolytope`, or one `HalfSpace`; a `Sphere` and a
            `DistanceGrid`. Their `at` is in the frame of their bodies.
        T_a, T_b: poses (4, 4) of the bodies in one frame, such as `arm.pose("hand")`; the identity by default.
    Raises:
        ModelError: another shape; two half-spaces; numbers that are not a pose.
        ShapeError: a pose of another shape.

    Example:
        `signed_distance(tx.view.Sphere(0.1), HalfSpace(), arm.pose("hand")) >= 0.02` is a constraint of a `Problem`.
    """
    pair, A, B = placed_pair("signed_distance", a, b, T_a, T_b)
    return pair.distance(Compose(Inverse(A), B))


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two solids in the form that the distance functions require.

    Attributes:
        a: a core with half lengths, a polytope or a cylinder.
        b: the same, or a half-space or a grid; of two cylinders a is the one with the smaller radius.
        swapped: whether a is the second solid of the pair.
    """

    a: Rounded | ConvexPolytope | Cylinder
    b: Any
    swapped: bool

    def distance(
        self, T: Expr, table: PolytopeTable | None = None, functions: dict[Hashable, Function] | None = None
    ) -> Expr:
        """The signed distance () if T is the pose of b in the frame of a.

        Args:
            table: None, or has both solids if neither is a cylinder, a half-space or a grid.
            functions: None, or the functions of previous pairs, which pairs of equal solids share; a new one is added.
        """
        a, b = self.a, self.b
        if isinstance(b, DistanceGrid):
            return b.value(-(T[:3, :3].T @ T[:3, 3])) - a.radius
        if isinstance(b, HalfSpace):
            return -Dot(T[:3, 2], T[:3, 3]) - self._reach(T[:3, 2])
        if table is not None and isinstance(a, Cylinder):
            if isinstance(b, (Cylinder, ConvexPolytope)) or b.directions:
                return table.distance_of_cylinder(a, b, T)
        elif table is not None and not isinstance(a, Cylinder) and _prefers_search(a, b):
            return table.distance(a, b, T)
        if isinstance(a, Rounded) and isinstance(b, Rounded):
            return _apart(a, b, T)
        key = _key(a), _key(b)
        functions = {} if functions is None else functions
        if key not in functions:
            functions[key] = Function(self.of_arrays(), (), name="signed_distance")
        return functions[key](T)

    def of_arrays(self) -> Callable[[Any], Any]:
        """The signed distance () as a function of an array T (4, 4)."""
        a, b = self.a, self.b
        if isinstance(b, (HalfSpace, DistanceGrid)) or not (_has_volume(a) or _has_volume(b)):
            lowered = lower(self.distance(State("T", (4, 4))))
            return lambda T: lowered(0.0, {"T": T})
        if isinstance(a, Cylinder):
            return cylinder_to_cylinder(a, b) if isinstance(b, Cylinder) else cylinder_to_core(a, core_of(b))
        return distance(core_of(a), core_of(b))  # this compiles faster than the expression

    def _reach(self, n: Expr) -> Expr:
        """The extent of a along -n, a unit vector in its frame."""
        a = self.a
        if isinstance(a, Cylinder):
            return over_plane(a, n)
        if isinstance(a, ConvexPolytope):
            heights = Constant(a.core.corners) @ n
            return a.radius - functools.reduce(Min, [heights[i] for i in range(heights.shape[0])])
        reach: Expr = Constant(a.radius)
        for i in a.directions:
            reach = reach + float(a.half[i]) * Abs(n[i])
        return reach


def placed_pair(owner: str, a: Solid, b: Solid, T_a: ExprLike | None, T_b: ExprLike | None) -> tuple[Pair, Expr, Expr]:
    """A pair, and the poses of its solids in one frame. Raises the errors of `signed_distance`."""
    poses = [pose(owner, name, np.eye(4) if T is None else T) for name, T in (("T_a", T_a), ("T_b", T_b))]
    swapped = isinstance(a, (HalfSpace, DistanceGrid)) or (isinstance(b, Cylinder) and not isinstance(a, Cylinder))
    if isinstance(a, Cylinder) and isinstance(b, Cylinder):
        swapped = a.radius > b.radius
    if isinstance(a, HalfSpace) and isinstance(b, HalfSpace):
        raise ModelError(f"{owner} expects at most one HalfSpace, got two: half-spaces have no distance")
    first, second = (b, a) if swapped else (a, b)
    if isinstance(second, DistanceGrid):
        one: Any = rounded(owner, first) if isinstance(first, Sphere) else None
        if one is None:
            raise ModelError(
                f"{owner} expects a Sphere as the partner of a DistanceGrid, got {short(first)}.\n"
                "  fix: enclose the solid in several spheres"
            )
        two: Any = second
    else:
        one = _core(owner, first)
        two = second if isinstance(second, HalfSpace) else _core(owner, second)
    A, B = poses[::-1] if swapped else poses
    B = B if isinstance(two, DistanceGrid) else Compose(B, Constant(two.at))  # a grid includes its pose
    return Pair(one, two, swapped), Compose(A, Constant(one.at)), B


def _key(solid: Rounded | ConvexPolytope | Cylinder) -> Hashable:
    return (solid.radius, solid.length) if isinstance(solid, Cylinder) else size_key(solid)


def _has_volume(solid: Rounded | ConvexPolytope | Cylinder) -> bool:
    return not isinstance(solid, Rounded) or len(solid.directions) == 3


def _core(owner: str, solid: Solid) -> Rounded | ConvexPolytope | Cylinder:
    return solid if isinstance(solid, (ConvexPolytope, Cylinder)) else rounded(owner, solid)


def _prefers_search(a: Rounded | ConvexPolytope, b: Rounded | ConvexPolytope) -> bool:
    """Whether a pair uses the search of a table. Polytopes have no formula, and that of two boxes has a thousand
    operations; for a box and a capsule or a ball the formula is faster.
    """
    if isinstance(a, ConvexPolytope) or isinstance(b, ConvexPolytope):
        return True
    return len(a.directions) == len(b.directions) == 3


def _apart(a: Rounded, b: Rounded, T: Expr) -> Expr:
    """The distance of two cores, minus the radii; T is the pose of b in a."""
    R, p = T[:3, :3], T[:3, 3]
    squares = [_to_core(Constant(b.corners) @ R.T + p[None], a), _to_core((Constant(a.corners) - p[None]) @ R, b)]
    squares += [_between_edges(a, b, i, j, R, p) for i in a.directions for j in b.directions]
    distance = Sqrt(functools.reduce(Min, [_least(values) for values in squares]))
    if not (_has_volume(a) or _has_volume(b)):  # then they do not overlap
        return distance - (a.radius + b.radius)
    depth = _separation(a, b, R, p)
    return Where(depth > 0.0, distance, depth) - (a.radius + b.radius)


def _to_core(points: Expr, core: Rounded) -> Expr:
    """The squared distances (k,) of points (k, 3) to a core."""
    low, high = Constant(-core.half[None]), Constant(core.half[None])
    return _squares(points - Max(low, Min(points, high)) if core.half.any() else points)


def _between_edges(a: Rounded, b: Rounded, i: int, j: int, R: Expr, p: Expr) -> Expr:
    """The smallest squared distances (k,) between points of the edges of a along axis i and points of the edges of b
    along axis j.
    """
    direction, one, two = R[:, j], a.edges(i), b.edges(j)
    sine = 1.0 - direction[i] * direction[i]
    skew = sine > _PARALLEL
    safe = Where(skew, sine, 1.0)
    w = Constant(np.repeat(two, len(one), axis=0)) @ R.T + p[None] - Constant(np.tile(one, (len(two), 1)))
    d, e = w[:, i], w @ direction
    s, t = (d - direction[i] * e) / safe, (direction[i] * d - e) / safe
    r = w + t[:, None] * direction[None] - s[:, None] * Constant(_UNIT[i : i + 1])
    beyond = Max(Abs(s) - float(a.half[i]), Abs(t) - float(b.half[j]))
    return Where(skew, Where(beyond < 0.0, _squares(r), _FAR), _FAR)


def _squares(r: Expr) -> Expr:
    """The squares (k,) of the lengths of vectors (k, 3)."""
    return (r * r) @ Constant(np.ones(3))


def _least(values: Expr) -> Expr:
    """The minimum of 2^n values."""
    while values.shape[0] > 1:
        half = values.shape[0] // 2
        values = Min(values[:half], values[half:])
    return values[0]


def _separation(a: Rounded, b: Rounded, R: Expr, p: Expr) -> Expr:
    """The largest gap along a separating axis; if negative, minus the smallest depth of an overlap."""
    values: list[Expr] = []

    def along(n: Expr) -> Expr:
        """The gap along an axis n in the frame of a."""
        size: Expr = Abs(Dot(n, p))
        for i in a.directions:
            size = size - float(a.half[i]) * Abs(n[i])
        for j in b.directions:
            size = size - float(b.half[j]) * Abs(Dot(n, R[:, j]))
        return size

    if len(a.directions) == 3:
        values += [along(Constant(_UNIT[i])) for i in range(3)]
    if len(b.directions) == 3:
        values += [along(R[:, j]) for j in range(3)]
    for i in a.directions:
        for j in b.directions:
            n = Cross(Constant(_UNIT[i]), R[:, j])
            size = Dot(n, n)
            skew = size > _PARALLEL
            values.append(Where(skew, along(n) / Sqrt(Where(skew, size, 1.0)), -_FAR))
    return functools.reduce(Max, values)
