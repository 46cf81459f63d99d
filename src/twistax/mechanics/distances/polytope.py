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
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...checks import reals, short
from ...errors import InputError
from ...view import Mesh
from ..arguments import pose
from .gjk import nearest_features
from .search import Distance, searched
from .separating_axes import least_depth
from .solids import Rounded

#: Of differences of unit vectors that count as zero.
_SMALL = 1e-10


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
            to_point = distance(self.core, Core.point(np.zeros(3)))
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
        sides: (e, 2, 3): the outward normals of the two faces that meet there; zero if there are none.
        faces: (f, 3, 3): corners of triangles.
        normals, offsets, planes: outward normals (g, 3) of faces, each direction once; (g,) with $n . p = offset$ on
            the face; (g, 3, 3) the corners of one of its triangles.
        radius: m.
    """

    at: NDArray[np.float64]
    corners: NDArray[np.float64]
    edges: NDArray[np.float64]
    sides: NDArray[np.float64]
    faces: NDArray[np.float64]
    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    planes: NDArray[np.float64]
    radius: float

    @classmethod
    def point(cls, p: NDArray[np.float64], at: Any = None, radius: float = 0.0) -> Core:
        """A point."""
        at, vectors, pairs, triangles = (
            np.eye(4) if at is None else at,
            *(np.zeros((0, *n, 3)) for n in ((), (2,), (3,))),
        )
        return cls(at, p[None], pairs, pairs, triangles, vectors, np.zeros(0), triangles, radius)

    @classmethod
    def of_hull(cls, hull: Any, at: NDArray[np.float64], radius: float) -> Core:
        """The core of a `scipy.spatial.ConvexHull`, without edges within a face."""
        points, triangles, planes = hull.points, hull.simplices, hull.equations
        edges, sides = [], []
        for i, near in enumerate(hull.neighbors):
            for k, j in enumerate(near):  # the neighbour opposite to corner k
                if i < j and np.abs(planes[i] - planes[j])[:3].max() > _SMALL:
                    edges.append(points[np.delete(triangles[i], k)])
                    sides.append(planes[[i, j], :3])
        kept: list[int] = []
        for i, plane in enumerate(planes):
            if not any(np.abs(plane[:3] - planes[j, :3]).max() < _SMALL for j in kept):
                kept.append(i)
        corners = points[np.sort(hull.vertices)]
        faces = points[triangles]
        normals, offsets = planes[kept, :3], -planes[kept, 3]
        return cls(at, corners, np.array(edges), np.array(sides), faces, normals, offsets, faces[kept], radius)

    @functools.cached_property
    def directions(self) -> NDArray[np.float64]:
        """The unit vectors (e, 3) along edges, in the sense of the product of the second and the first side."""
        d = self.edges[:, 1] - self.edges[:, 0]
        d = d / np.linalg.norm(d, axis=1)[:, None]
        turn = np.sum(d * np.cross(self.sides[:, 1], self.sides[:, 0]), axis=1)
        return np.asarray(d * np.where(turn < 0.0, -1.0, 1.0)[:, None])

    @functools.cached_property
    def face_normals(self) -> NDArray[np.float64]:
        """The outward normals (f, 3) of the triangles."""
        corner, u, v = self.faces[:, 0], *(self.faces[:, k] - self.faces[:, 0] for k in (1, 2))
        n = np.cross(u, v)
        # Corners of triangles are in any order: outward is away from the mean of all.
        n = n * np.sign(np.sum(n * (corner - self.corners.mean(axis=0)), axis=1))[:, None]
        return np.asarray(n / np.linalg.norm(n, axis=1)[:, None])

    @functools.cached_property
    def face_offsets(self) -> NDArray[np.float64]:
        """(f,) with $n . p = offset$ on each triangle."""
        return np.asarray(np.sum(self.face_normals * self.faces[:, 0], axis=1))

    @functools.cached_property
    def face_duals(self) -> NDArray[np.float64]:
        """Vectors (f, 2, 3) whose products with p - c_0 are s and t of p = c_0 + s (c_1 - c_0) + t (c_2 - c_0), for
        the corners c of each triangle.
        """
        u, v = (self.faces[:, k] - self.faces[:, 0] for k in (1, 2))
        n = np.cross(u, v)
        size = np.sum(n**2, axis=1)[:, None]
        return np.stack([np.cross(v, n) / size, np.cross(n, u) / size], axis=1)

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
        return dataclasses.replace(point, corners=ends, edges=ends[None], sides=0.0 * ends[None]) if count else point


def distance(a: Core, b: Core) -> Distance:
    """The signed distance () of the core b from the core a, as a function of the pose T (4, 4) of b in the frame of a.

    One of them has faces.
    """
    if not len(a.normals):
        of_inverse = distance(b, a)
        return lambda T: of_inverse(_inverse(jnp.asarray(T)))

    def formula(T: jax.Array, features: _Features) -> jax.Array:
        of_a, of_b, is_line, side = features
        w = of_a - (of_b @ T[:3, :3].T + T[None, :3, 3])
        e, f = w[1] - w[0], w[2] - w[0]
        n = jnp.cross(e, f)
        plane = jnp.where(side == 0.0, 1.0, n @ n)
        line = jnp.where(is_line, e @ e, 1.0)
        to_line = w[0] - jnp.where(is_line, (w[0] @ e) / line, 0.0) * e
        return jnp.where(side == 0.0, root(to_line @ to_line), side * (n @ w[0]) / jnp.sqrt(plane)) - (
            a.radius + b.radius
        )

    return searched(functools.partial(_features, a, b), formula)


def _inverse(T: jax.Array) -> jax.Array:
    R, p = T[:3, :3], T[:3, 3]
    return jnp.concatenate([jnp.concatenate([R.T, -(p @ R)[:, None]], axis=1), T[3:]])


class _Features(NamedTuple):
    """The nearest features of two cores.

    Attributes:
        a, b: corners (3, 3) of both, each in its frame.
        is_line: whether the nearest point of the Minkowski difference is on the line through the first two differences.
        side: of a point on the plane of all three, the side on which the origin is, -1 or 1; else 0.
    """

    a: jax.Array
    b: jax.Array
    is_line: jax.Array
    side: jax.Array


def _features(a: Core, b: Core, T: jax.Array) -> _Features:
    R, p = T[:3, :3], T[:3, 3]
    size = float(np.abs(a.corners).max() + np.abs(b.corners).max())
    points = jnp.asarray(a.corners, T.dtype), jnp.asarray(b.corners, T.dtype) @ R.T + p[None]
    apart, count, overlap = nearest_features(*points, size)
    contact = jax.lax.cond(overlap, lambda: least_depth(a, b, R, p), lambda: apart)
    count = jnp.where(overlap, 3, count)
    w = contact.a - contact.b
    normal = jnp.cross(w[1] - w[0], w[2] - w[0])
    side = jnp.where(count == 3, jnp.where(normal @ contact.n > 0.0, -1.0, 1.0), 0.0).astype(T.dtype)
    return _Features(contact.a, (contact.b - p[None]) @ R, count == 2, side)


def root(square: jax.Array) -> jax.Array:
    """The square root, with a derivative of zero at zero."""
    positive = square > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


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
