"""Convex polytopes, and the distance of two polytopes as a JAX function.

If two polytopes are separate, their nearest points are a corner and its projection onto a face, a corner and a point of
an edge, or points of two edges: the distance is the minimum over all of these. If they overlap, the depth follows from
the separating axes, which are the normals of faces and the cross products of edges: it is the largest gap between the
projections of both on an axis.

Source: C. Ericson, Real-Time Collision Detection (2005), sections 5.1.2, 5.1.5, 5.1.9 and 5.2.1.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...checks import reals, short
from ...errors import InputError
from ...view import Mesh
from ..arguments import pose
from .solids import Rounded

#: Of lengths that count as zero, relative to the size of the polytope; of sines squared of parallel edges.
_SMALL, _PARALLEL = 1e-10, 1e-14
#: By which triangles overlap, relative to their sides.
_SEAM = 1e-13
#: Stands for features whose nearest points lie beyond their ends, m2.
FAR = 1e12


@dataclasses.dataclass(frozen=True, eq=False)
class ConvexPolytope:
    """The convex hull of points $p_i$, and all points within a radius r of it: $|p - sum w_i p_i| <= r$ with weights
    $w_i >= 0$ whose sum is 1.

    Attributes:
        corners: (k, 3), m: points, or a `tx.view.Mesh`, whose `at` counts too.
        radius: m.
        at: T (4, 4) in the frame of the body; the identity by default.
        most: None, or the number of corners that are kept. The radius then grows by the distance of what is left out,
            so that the solid contains the hull: `radius` says by how much.
    Raises: InputError for points that are not finite or span no volume; ModelError for numbers that are not a pose.

    Example:
        `signed_distance(ConvexPolytope(Mesh("hand.stl"), most=24), HalfSpace(), arm.pose("hand"))`
    """

    corners: Any
    radius: float = 0.0
    at: Any = dataclasses.field(default_factory=lambda: np.eye(4))
    most: int | None = None

    def __post_init__(self) -> None:
        T = pose("ConvexPolytope", "at", self.at)
        object.__setattr__(self, "at", np.asarray(getattr(T, "value", self.at)))
        points = self.corners
        if isinstance(points, Mesh):
            points = points.mesh()[0] @ np.asarray(points.at)[:3, :3].T + np.asarray(points.at)[:3, 3]
        points = reals("ConvexPolytope: corners", points, InputError)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"ConvexPolytope expects finite corners of shape (k, 3), got {short(self.corners)}")
        if not 0.0 <= float(self.radius) < np.inf:
            raise InputError(f"ConvexPolytope expects a radius of 0 or more, got {self.radius!r}")
        hull = _hull(points)
        kept = hull if self.most is None or len(hull) <= self.most else _fewer(hull, int(self.most))
        if kept is not hull:
            object.__setattr__(self, "corners", kept)
            to_point = functools.partial(distance, self.core, Core.point(np.zeros(3)))
            places = np.tile(np.eye(4), (len(hull), 1, 1))
            places[:, :3, 3] = hull
            missed = float(jnp.max(jax.vmap(to_point)(places)))
            object.__setattr__(self, "radius", float(self.radius) + max(missed, 0.0))
            del self.__dict__["core"]
        object.__setattr__(self, "corners", kept)

    @functools.cached_property
    def core(self) -> Core:
        """The hull's corners, edges and faces."""
        from scipy.spatial import ConvexHull

        return Core.of_hull(ConvexHull(self.corners), self.at, float(self.radius))


@dataclasses.dataclass(frozen=True, eq=False)
class Core:
    """A point, a segment or a polytope with a radius, as arrays.

    Attributes:
        at: pose T (4, 4) in the frame of the body.
        corners: (v, 3).
        edges: (e, 2, 3): both ends of each.
        faces: (f, 3, 3): corners of triangles.
        normals, offsets: outward normals (g, 3) of faces, each direction once, and (g,) with $n . p = offset$ on the
            face.
        radius: m.
    """

    at: NDArray[np.float64]
    corners: NDArray[np.float64]
    edges: NDArray[np.float64]
    faces: NDArray[np.float64]
    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    radius: float

    @classmethod
    def point(cls, p: NDArray[np.float64], at: Any = None, radius: float = 0.0) -> Core:
        """A point."""
        none = np.zeros((0, 3))
        at = np.eye(4) if at is None else at
        return cls(at, p[None], np.zeros((0, 2, 3)), np.zeros((0, 3, 3)), none, np.zeros(0), radius)

    @classmethod
    def of_hull(cls, hull: Any, at: NDArray[np.float64], radius: float) -> Core:
        """The core of a `scipy.spatial.ConvexHull`, without edges within a face."""
        points, triangles, planes = hull.points, hull.simplices, hull.equations
        edges = []
        for i, near in enumerate(hull.neighbors):
            for k, j in enumerate(near):  # the neighbour opposite to corner k
                if i < j and np.abs(planes[i] - planes[j])[:3].max() > _SMALL:
                    edges.append(points[np.delete(triangles[i], k)])
        kept: list[int] = []
        for i, plane in enumerate(planes):
            if not any(np.abs(plane[:3] - planes[j, :3]).max() < _SMALL for j in kept):
                kept.append(i)
        corners = points[np.sort(hull.vertices)]
        return cls(at, corners, np.array(edges), points[triangles], planes[kept, :3], -planes[kept, 3], radius)

    @classmethod
    def of(cls, solid: Rounded | ConvexPolytope) -> Core:
        """The core of a box, a capsule, a ball or a polytope."""
        if isinstance(solid, ConvexPolytope):
            return solid.core
        count = len(solid.directions)
        if count == 3:
            return ConvexPolytope(solid.corners, solid.radius, solid.at).core
        point = cls.point(np.zeros(3), solid.at, solid.radius)
        ends = solid.corners
        return dataclasses.replace(point, corners=ends, edges=ends[None]) if count else point


def distance(a: Core, b: Core, T: Any) -> jax.Array:
    """The signed distance () of the core b, at the pose T in the frame of the core a, from a."""
    T = jnp.asarray(T)
    R, p = T[:3, :3], T[:3, 3]
    constant = functools.partial(jnp.asarray, dtype=T.dtype)
    placed = lambda points: constant(points) @ R.T + p.reshape((1,) * (points.ndim - 1) + (3,))  # noqa: E731
    Va, Vb, Ea, Eb = constant(a.corners), placed(b.corners), constant(a.edges), placed(b.edges)
    squares = [jnp.ravel(jnp.sum((Va[:, None] - Vb[None]) ** 2, axis=2))]
    for points, edges in ((Vb, Ea), (Va, Eb)):
        if len(edges):
            squares.append(_to_edges(points, edges))
    for points, faces in ((Vb, constant(a.faces)), (Va, placed(b.faces))):
        if len(faces):
            squares.append(_to_faces(points, faces))
    if len(Ea) and len(Eb):
        squares.append(_between(Ea, Eb))
    square = jnp.min(jnp.concatenate(squares))
    if not len(a.normals) and not len(b.normals):
        return root(square) - (a.radius + b.radius)
    depth = _separation(a, b, Va, Vb, R, p)
    outside = depth > 0.0
    return jnp.where(outside, root(jnp.where(outside, square, 1.0)), depth) - (a.radius + b.radius)


def root(square: jax.Array) -> jax.Array:
    """The square root, with a derivative of zero at zero."""
    positive = square > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _to_edges(points: jax.Array, edges: jax.Array) -> jax.Array:
    """The squared distances of points (k, 3) to edges (e, 2, 3)."""
    start, direction = edges[:, 0], edges[:, 1] - edges[:, 0]
    w = points[:, None] - start[None]
    s = jnp.clip(jnp.sum(w * direction[None], axis=2) / jnp.sum(direction**2, axis=1)[None], 0.0, 1.0)
    return jnp.ravel(jnp.sum((w - s[..., None] * direction[None]) ** 2, axis=2))


def _to_faces(points: jax.Array, faces: jax.Array) -> jax.Array:
    """The squared distances of points (k, 3) to triangles (f, 3, 3) within which they project."""
    corner = faces[:, 0]
    n = jnp.cross(faces[:, 1] - corner, faces[:, 2] - corner)
    points = jnp.broadcast_to(points[:, None], (len(points), *n.shape))
    height = jnp.sum((points - corner[None]) * n[None], axis=2)
    return jnp.ravel(jnp.where(within_triangles(points, faces), height**2 / jnp.sum(n**2, axis=1)[None], FAR))


def within_triangles(points: jax.Array, faces: jax.Array) -> jax.Array:
    """Whether points (..., f, 3) project into triangles (f, 3, 3), or by rounding beside them."""
    corner, u, v = faces[:, 0], faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]
    n, corner, u, v = (jnp.broadcast_to(x, points.shape) for x in (jnp.cross(u, v), corner, u, v))
    size, w = jnp.sum(n**2, axis=-1), points - corner
    s = jnp.sum(jnp.cross(w, v) * n, axis=-1) / size
    t = jnp.sum(jnp.cross(u, w) * n, axis=-1) / size
    # Two triangles of one face leave no gap on the line between them.
    return (s >= -_SEAM) & (t >= -_SEAM) & (s + t <= 1.0 + _SEAM)


def _between(one: jax.Array, two: jax.Array) -> jax.Array:
    """The squared distances of lines of edges (e, 2, 3) and (f, 2, 3), where the nearest points lie within both."""
    d, e = one[:, 1] - one[:, 0], two[:, 1] - two[:, 0]
    wide = (len(d), len(e), 3)
    n = jnp.cross(jnp.broadcast_to(d[:, None], wide), jnp.broadcast_to(e[None], wide))
    size, w = jnp.sum(n**2, axis=2), two[None, :, 0] - one[:, None, 0]
    skew = size > _PARALLEL * jnp.sum(d**2, axis=1)[:, None] * jnp.sum(e**2, axis=1)[None]
    safe = jnp.where(skew, size, 1.0)
    s = jnp.sum(jnp.cross(w, jnp.broadcast_to(e[None], wide)) * n, axis=2) / safe
    t = jnp.sum(jnp.cross(w, jnp.broadcast_to(d[:, None], wide)) * n, axis=2) / safe
    within = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    return jnp.ravel(jnp.where(within, jnp.sum(w * n, axis=2) ** 2 / safe, FAR))


def _separation(a: Core, b: Core, Va: jax.Array, Vb: jax.Array, R: jax.Array, p: jax.Array) -> jax.Array:
    """The largest gap along a separating axis; if negative, minus the smallest depth of an overlap."""
    constant = functools.partial(jnp.asarray, dtype=R.dtype)
    gaps = []
    if len(a.normals):
        gaps.append(jnp.min(constant(a.normals) @ Vb.T, axis=1) - constant(a.offsets))
    if len(b.normals):
        normals = constant(b.normals) @ R.T
        gaps.append(jnp.min(normals @ Va.T, axis=1) - normals @ p - constant(b.offsets))
    d, e = (constant(directions(core.edges)) for core in (a, b))
    if len(d) and len(e):
        wide = (len(d), len(e), 3)
        n = jnp.cross(jnp.broadcast_to(d[:, None], wide), jnp.broadcast_to((e @ R.T)[None], wide)).reshape(-1, 3)
        size = jnp.sum(n**2, axis=1)
        skew = size > _PARALLEL
        n = n / jnp.sqrt(jnp.where(skew, size, 1.0))[:, None]
        of_a, of_b = n @ Va.T, n @ Vb.T
        gap_of_b = jnp.min(of_b, axis=1) - jnp.max(of_a, axis=1)
        gap_of_a = jnp.min(of_a, axis=1) - jnp.max(of_b, axis=1)
        gaps.append(jnp.where(skew, jnp.maximum(gap_of_b, gap_of_a), -FAR))
    every = jnp.concatenate(gaps)
    return every[jnp.argmax(every)]  # of equal gaps the slope of one, for their mean may be zero


def directions(edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """The unit vectors (k, 3) of edges, each direction once."""
    kept: list[Any] = []
    for start, end in edges:
        unit = (end - start) / np.linalg.norm(end - start)
        if not any(min(np.abs(unit - d).max(), np.abs(unit + d).max()) < _SMALL for d in kept):
            kept.append(unit)
    return np.array(kept).reshape(-1, 3)


def _hull(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The corners of the convex hull. Raises InputError if it has no volume."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[np.sort(ConvexHull(points).vertices)], float)
    except (QhullError, ValueError) as error:
        raise InputError(
            f"ConvexPolytope expects points that span a volume, got {len(points)} points that do not.\n"
            "  fix: use a Sphere, a Capsule or a Box of tx.view"
        ) from error


def _fewer(hull: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """At most this number of corners, each the farthest from the previous ones. Raises
    InputError for fewer than four.
    """
    if most < 4:
        raise InputError(f"ConvexPolytope expects most to be 4 or more, got {most}")
    kept = [int(np.argmax(np.linalg.norm(hull - hull.mean(axis=0), axis=1)))]
    distances = np.linalg.norm(hull - hull[kept[0]], axis=1)
    while len(kept) < most:
        kept.append(int(np.argmax(distances)))
        distances = np.minimum(distances, np.linalg.norm(hull - hull[kept[-1]], axis=1))
    return _hull(hull[kept])
