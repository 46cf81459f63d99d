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
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...checks import reals, short
from ...errors import InputError
from ...scalar.fast import searched
from ...view import Mesh
from ..arguments import pose
from .gjk import nearest_features
from .separating_axes import Hull, least_depth
from .solids import Core, Rounded


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
        kept, missed = (hull, 0.0) if self.most is None or len(hull) <= self.most else _fewer(hull, int(self.most))
        object.__setattr__(self, "corners", kept)
        object.__setattr__(self, "radius", float(self.radius) + missed)

    @functools.cached_property
    def core(self) -> Core:
        """The hull's corners, edges and faces."""
        from scipy.spatial import ConvexHull

        return Core.of_hull(ConvexHull(self.corners), self.at, float(self.radius))


def size_key(solid: Rounded | ConvexPolytope) -> Hashable:
    """Equal for solids of the same kind and size, which differ at most in their poses; polytopes by identity."""
    return id(solid) if isinstance(solid, ConvexPolytope) else (solid.half.tobytes(), solid.radius)


def core_of(solid: Rounded | ConvexPolytope) -> Core:
    """The core of a box, a capsule, a ball or a polytope."""
    if isinstance(solid, ConvexPolytope):
        return solid.core
    count = len(solid.directions)
    if count == 3:
        return ConvexPolytope(solid.corners, solid.radius, solid.at).core
    point = Core.point(np.zeros(3), solid.at, solid.radius)
    ends = solid.corners
    return dataclasses.replace(point, corners=ends, edges=ends[None], sides=0.0 * ends[None]) if count else point


def distance(a: Core, b: Core) -> Callable[[Any], jax.Array]:
    """The signed distance () of the core b from the core a, as a function of the pose T (4, 4) of b in the frame of a.

    One of them has faces.
    """
    if not len(a.normals):
        of_inverse = distance(b, a)
        return lambda T: of_inverse(_inverse(jnp.asarray(T)))

    def search(T: jax.Array) -> NearestFeatures:
        hulls = [jax.tree.map(lambda x: jnp.asarray(x, T.dtype), hull_of(core)) for core in (a, b)]
        return features_of(lambda: (hulls[0], hulls[1]), hulls[0].corners, hulls[1].corners, T, size_of(a) + size_of(b))

    return searched(search, lambda T, features: distance_of(features, T) - (a.radius + b.radius))


def _inverse(T: jax.Array) -> jax.Array:
    R, p = T[:3, :3], T[:3, 3]
    return jnp.concatenate([jnp.concatenate([R.T, -(p @ R)[:, None]], axis=1), T[3:]])


class NearestFeatures(NamedTuple):
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


def hull_of(core: Core) -> Hull:
    """The arrays of a core. Edges of a segment have no sides: their normals are zero."""
    both, directions = core.edges, core.directions if len(core.edges) else np.zeros((0, 3))
    return Hull(
        core.corners,
        (both[:, 0], both[:, 1]),
        directions,
        (core.sides[:, 0], core.sides[:, 1]),
        core.normals,
        core.offsets,
        (core.planes[:, 0], core.planes[:, 1], core.planes[:, 2]),
    )


def size_of(core: Core) -> float:
    """The largest coordinate of a corner."""
    return float(np.abs(core.corners).max())


def features_of(
    hulls: Callable[[], tuple[Hull, Hull]], A: jax.Array, B: jax.Array, T: jax.Array, size: Any
) -> NearestFeatures:
    """The nearest features of two hulls, the second one at the pose T (3, 4) or (4, 4).

    Args:
        hulls: gives all arrays of both, which are read if they overlap.
        A, B: their corners.
        size: a length of the order of both.
    """
    R, p = T[:3, :3], T[:3, 3]
    nearest, count, overlap = nearest_features(A, B @ R.T + p[None], size)
    contact = jax.lax.cond(overlap, lambda: least_depth(*hulls(), R, p), lambda: nearest)
    count = jnp.where(overlap, 3, count)
    w = contact.a - contact.b
    normal = jnp.cross(w[1] - w[0], w[2] - w[0])
    side = jnp.where(count == 3, jnp.where(normal @ contact.n > 0.0, -1.0, 1.0), 0.0).astype(T.dtype)
    return NearestFeatures(contact.a, (contact.b - p[None]) @ R, count == 2, side)


def distance_of(features: NearestFeatures, T: jax.Array) -> jax.Array:
    """The signed distance () of cores with these features, the second core at the pose T (3, 4) or (4, 4)."""
    of_a, of_b, is_line, side = features
    w = of_a - (of_b @ T[:3, :3].T + T[None, :3, 3])
    e, f = w[1] - w[0], w[2] - w[0]
    n = jnp.cross(e, f)
    plane = jnp.where(side == 0.0, 1.0, n @ n)
    line = jnp.where(is_line, e @ e, 1.0)
    to_line = w[0] - jnp.where(is_line, (w[0] @ e) / line, 0.0) * e
    return jnp.where(side == 0.0, root(to_line @ to_line), side * (n @ w[0]) / jnp.sqrt(plane))


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


def _fewer(hull: NDArray[np.float64], most: int) -> tuple[NDArray[np.float64], float]:
    """At most this number of corners, and the largest distance of the others from their hull. Each corner is the
    farthest from the hull of the previous ones. Raises InputError for fewer than four.
    """
    if most < 4:
        raise InputError(f"ConvexPolytope expects most to be 4 or more, got {most}")
    first = int(np.argmax(np.linalg.norm(hull - hull.mean(axis=0), axis=1)))
    second = int(np.argmax(np.linalg.norm(hull - hull[first], axis=1)))
    kept = [first, second]
    axis = np.cross(hull - hull[first], hull[second] - hull[first])
    kept.append(int(np.argmax(np.linalg.norm(axis, axis=1))))
    kept.append(int(np.argmax(np.abs((hull - hull[first]) @ axis[kept[-1]]))))
    while True:
        corners = _hull(hull[kept])
        away = _distances(corners, hull)
        if len(kept) == most or away.max() == 0.0:
            return corners, float(away.max())
        kept.append(int(np.argmax(away)))


def _distances(corners: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The distances (k,) of points (k, 3) from a hull; zero inside."""
    from scipy.spatial import ConvexHull

    core = Core.of_hull(ConvexHull(corners), np.eye(4), 0.0)
    heights = points @ core.face_normals.T - core.face_offsets
    places = np.einsum("fij,kfj->kfi", core.face_duals, points[:, None] - core.faces[:, 0])
    above = (places >= 0.0).all(axis=2) & (places.sum(axis=2) <= 1.0)
    start, edges = core.edges[:, 0], core.edges[:, 1] - core.edges[:, 0]
    w = points[:, None] - start
    s = np.clip(np.sum(w * edges, axis=2) / np.sum(edges**2, axis=1), 0.0, 1.0)
    to_edges = np.linalg.norm(w - s[..., None] * edges, axis=2).min(axis=1)
    to_faces = np.where(above, np.abs(heights), np.inf).min(axis=1)
    is_corner = (points[:, None] == corners).all(axis=2).any(axis=1)
    return np.where((heights.max(axis=1) <= 0.0) | is_corner, 0.0, np.minimum(to_edges, to_faces))
