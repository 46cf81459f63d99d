"""Spheres and capsules that enclose a mesh, whose distances are cheaper than those of its convex hull."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import whole
from ...errors import ModelError
from ...view import Capsule, Mesh, Sphere
from .polytope import ConvexPolytope

#: Steps towards the farthest point, for the centre of a ball. The radius is exact for that centre, and at most 5 %
#: larger than the smallest one: M. Badoiu, K. Clarkson, Smaller core-sets for balls, SODA (2003).
_STEPS = 400


def fitted_capsule(mesh: Any) -> Capsule:
    r"""A capsule of small volume $\pi r^2 (l + 4 r / 3)$ with radius r and length l that contains a mesh.

    The initial axis is a principal axis of the corners; a simplex search over its direction minimises the volume. For
    each direction, the radius is that of the smallest circle around the projections, and the length is the shortest
    that contains the corners.

    Args:
        mesh: a `tx.view.Mesh`, a `ConvexPolytope`, or points (k, 3), m.
    Raises: InputError for points that span no volume, or are not finite.

    Example:
        `signed_distance(fitted_capsule(Mesh("forearm.stl")), HalfSpace(), arm.pose("forearm"))`
    """
    from scipy.optimize import minimize  # imported here because the package is large

    points = _corners(mesh)

    def volume(direction: NDArray[np.float64]) -> float:
        _, radius, low, high = _around(points, direction)
        return float(np.pi * radius**2 * (high - low + 4.0 / 3.0 * radius))

    axes = _axes(points)
    start, u, v = sorted(axes, key=volume)
    turned = minimize(lambda s: volume(start + s[0] * u + s[1] * v), np.zeros(2), method="Nelder-Mead")
    direction = start + turned.x[0] * u + turned.x[1] * v
    frame, radius, low, high = _around(points, direction)
    at = np.eye(4)
    at[:3, :3], at[:3, 3] = frame[:, :3], frame[:, 3] + 0.5 * (low + high) * frame[:, 2]
    return Capsule(radius, max(high - low, 1e-9 * radius), at=at)


def fitted_spheres(mesh: Any, count: int) -> list[Sphere]:
    """A list of at most `count` spheres whose union contains the convex hull of a mesh.

    Each point p of the hull satisfies $|p - c_i| <= r_i$ for one of the centres and radii, m. The largest part of the
    hull is repeatedly divided in two across its longest axis, and each part is enclosed in a small ball.

    Args:
        mesh: as for `fitted_capsule`.
        count: the largest number of spheres, 1 or more.
    Raises: InputError as for `fitted_capsule`; ModelError for an invalid count.

    Example:
        `clearances(arm, {"forearm": fitted_spheres(Mesh("forearm.stl"), 6)})`
    """
    whole("fitted_spheres: count", count, 1, ModelError)
    parts = [_corners(mesh)]
    while len(parts) < count:
        largest = max(range(len(parts)), key=lambda k: _ball(parts[k])[1])
        points = parts.pop(largest)
        axis = _axes(points)[0]
        heights = points @ axis
        parts += _halves(points, heights - 0.5 * (heights.min() + heights.max()))
    return [Sphere(radius, at=centre) for centre, radius in map(_ball, parts)]


def _corners(mesh: Any) -> NDArray[np.float64]:
    """The corners of the convex hull, in the frame of the body."""
    hull = (
        mesh if isinstance(mesh, ConvexPolytope) else ConvexPolytope(mesh.corners() if isinstance(mesh, Mesh) else mesh)
    )
    return np.asarray(hull.core.corners @ hull.at[:3, :3].T + hull.at[:3, 3])


def _halves(points: NDArray[np.float64], heights: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Two sets of points, whose hulls are the parts of the points' hull below and above height zero."""
    from scipy.spatial import ConvexHull

    below, above = points[heights <= 0.0], points[heights > 0.0]
    low, high = heights[heights <= 0.0], heights[heights > 0.0]
    share = (-low[:, None] / (high[None] - low[:, None]))[..., None]
    cut = (below[:, None] + share * (above[None] - below[:, None])).reshape(-1, 3)
    # Only the corners of both hulls: the number of all pairs would be squared with each division.
    both = [np.concatenate([half, cut]) for half in (below, above)]
    return [half[ConvexHull(half).vertices] for half in both]


def _axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The principal axes (3, 3) of points, as rows, the longest first."""
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2])


def _ball(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The centre and the radius of a nearly minimal ball around points of any dimension."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    best, least = centre, np.inf
    for k in range(1, _STEPS):
        away = np.linalg.norm(points - centre, axis=1)
        if away.max() < least:
            best, least = centre, float(away.max())
        centre = centre + (points[int(away.argmax())] - centre) / (k + 1)
    return best, least


def _around(
    points: NDArray[np.float64], direction: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, float, float]:
    """The frame (3, 4) of a capsule around points, whose z is the capsule's axis, its radius, and both ends along z."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(z, np.eye(3)[int(np.abs(z).argmin())])
    R = np.column_stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z])
    local = points @ R
    middle, radius = _ball(local[:, :2])
    reach = np.sqrt(np.maximum(radius**2 - np.sum((local[:, :2] - middle) ** 2, axis=1), 0.0))
    low, high = float((local[:, 2] + reach).min()), float((local[:, 2] - reach).max())
    if high < low:  # a single ball suffices
        low = high = 0.5 * (low + high)
        radius = float(np.linalg.norm(local - [*middle, low], axis=1).max())
    return np.column_stack([R, R @ [*middle, 0.0]]), radius, low, high
