"""The search for the nearest features of a solid cylinder and a ball, a capsule, a box or a polytope.

Outside, the distance to the cylinder is a convex function on the other solid. Its least value is at a corner, on an
edge along which it falls from both ends, or above a face at the support point of the cylinder. Tangents at both ends
bound it on an edge from below, so that most edges are left out. Inside, the gap is greatest in a direction that is
normal to a smooth part of the boundary of the Minkowski difference; a direction across an edge is one only on the arc
between the normals of both faces (Gauss map).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .gjk import at, farthest, place_of
from .polytope import hull_of, root
from .rim import RimIntervals, rim_intervals, rim_normal, sign_change, unit
from .separating_axes import Hull
from .solids import Core

#: A distance that is zero by rounding, relative to the radius.
_TOUCHING = 1e-12
#: The overlap of triangles of one face, in coordinates of a triangle.
_SEAM = 1e-13
#: The gap and the height of features that do not exist.
_FAR = 1e12


class Feature(NamedTuple):
    """The nearest features; vectors of the other solid are in its frame.

    Attributes:
        corner: (3,) a point of it where the gap is measured.
        edge: (3,) the direction of its edge.
        normal: (3,) the outward normal of its face.
        n: (3,) the direction of the gap in the frame of the cylinder.
        kind: (6,) one at the kind: 0 a point or an edge outside of the cylinder; 1 a face; 2 an end of the cylinder;
            3 an edge across its side; 4 a corner at its side; 5 an edge at a rim.
    """

    corner: jax.Array
    edge: jax.Array
    normal: jax.Array
    n: jax.Array
    kind: jax.Array


class _Candidate(NamedTuple):
    """A feature with its gap; vectors are in the frame of the cylinder."""

    gap: jax.Array
    corner: jax.Array
    edge: jax.Array
    normal: jax.Array
    n: jax.Array
    kind: jax.Array


class Facets(NamedTuple):
    """Arrays of a `Core`: its hull, and of triangles the first corners, normals (f, 3), offsets (f,) and duals (f, 3).

    A segment or a point has no triangles.
    """

    hull: Hull
    faces: Any
    face_normals: Any
    face_offsets: Any
    face_duals: tuple[Any, Any]


def facets_of(core: Core) -> Facets:
    duals = core.face_duals
    return Facets(hull_of(core), core.faces[:, 0], core.face_normals, core.face_offsets, (duals[:, 0], duals[:, 1]))


def nearest_feature(radius: Any, height: Any, core: Facets, T: jax.Array) -> Feature:
    """The feature for the pose T of a core in the frame of a cylinder of half the length `height`."""
    R, p = T[:3, :3], T[:3, 3]
    placed = _Placed(radius, height, core, R, p)
    outside = _apart(placed)
    n = outside.n
    gap = jnp.min(placed.corners @ n) - reach(radius, height, n[None])[0]
    best = jax.lax.cond(gap > _TOUCHING * radius, lambda: outside, lambda: _deepest(placed))
    flags = (jnp.arange(6) == best.kind).astype(T.dtype)
    return Feature((best.corner - p) @ R, best.edge @ R, best.normal @ R, best.n, flags)


class _Placed:
    """The arrays of a core in the frame of the cylinder."""

    def __init__(self, radius: Any, height: Any, core: Facets, R: jax.Array, p: jax.Array) -> None:
        self.radius, self.height, self.core, self.R, self.p = radius, height, core, R, p
        self.constant = functools.partial(jnp.asarray, dtype=R.dtype)
        hull = core.hull
        self.corners = self.moved(hull.corners)
        self.normals = self.turned(hull.normals)
        self.starts, self.ends = self.moved(hull.edges[0]), self.moved(hull.edges[1])
        self.edges = self.turned(hull.directions)
        self.z = self.constant([0.0, 0.0, 1.0])

    def turned(self, vectors: Any) -> jax.Array:
        return self.constant(vectors) @ self.R.T

    def moved(self, points: Any) -> jax.Array:
        return self.turned(points) + self.p[None]

    def candidate(self, gap: jax.Array, kind: int, n: jax.Array, **features: jax.Array) -> _Candidate:
        vectors = {"corner": self.corners[0], "edge": self.z, "normal": self.z} | features
        return _Candidate(gap, n=n, kind=jnp.asarray(kind), **vectors)


def reach(radius: Any, height: Any, n: jax.Array) -> jax.Array:
    """The support (k,) of a cylinder in its frame along directions n (k, 3)."""
    return height * jnp.abs(n[:, 2]) + radius * root(n[:, 0] ** 2 + n[:, 1] ** 2)


def to_points(radius: Any, height: Any, p: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The signed distances (k,) of points (k, 3), and their gradients (k, 3)."""
    flat = root(p[:, 0] ** 2 + p[:, 1] ** 2)
    across, up = flat - radius, jnp.abs(p[:, 2]) - height
    outside = root(jnp.maximum(across, 0.0) ** 2 + jnp.maximum(up, 0.0) ** 2)
    is_outside, is_side = outside > 0.0, across > up
    length = jnp.where(is_outside, outside, 1.0)
    outward = jnp.where(is_outside, jnp.maximum(across, 0.0) / length, is_side.astype(p.dtype))
    upward = jnp.where(is_outside, jnp.maximum(up, 0.0) / length, 1.0 - is_side.astype(p.dtype))
    outward = outward / jnp.where(flat > 0.0, flat, 1.0)
    upward = jnp.where(p[:, 2] < 0.0, -upward, upward)
    gradients = jnp.stack([outward * p[:, 0], outward * p[:, 1], upward], axis=1)
    return outside + jnp.minimum(jnp.maximum(across, up), 0.0), gradients


def best_of(candidates: list[Any], better: Callable[[jax.Array, jax.Array], jax.Array]) -> Any:
    best = candidates[0]
    for other in candidates[1:]:
        chosen = better(other[0], best[0])
        best = jax.tree.map(lambda new, old, chosen=chosen: jnp.where(chosen, new, old), other, best)
    return best


# ---- outside ---------------------------------------------------------------------------------------------------------


def _apart(placed: _Placed) -> _Candidate:
    """The nearest point of separate solids; its gap is the distance."""
    radius, height = placed.radius, placed.height
    distances, gradients = to_points(radius, height, placed.corners)
    i = place_of(distances == jnp.min(distances))
    corner = placed.candidate(
        jnp.min(distances), 0, at(gradients, i), corner=at(placed.corners, i), edge=jnp.zeros_like(placed.z)
    )
    nearest = [corner]
    if len(placed.core.faces):
        nearest.append(_above_faces(placed))
    best = best_of(nearest, jnp.less)
    if not len(placed.edges):
        return best
    e = placed.edges
    start, end = (
        jnp.where((jnp.sum((placed.ends - placed.starts) * e, axis=1) > 0.0)[:, None], *both)
        for both in ((placed.starts, placed.ends), (placed.ends, placed.starts))
    )
    (d_0, g_0), (d_1, g_1) = to_points(radius, height, start), to_points(radius, height, end)
    s_0, s_1 = jnp.sum(g_0 * e, axis=1), jnp.sum(g_1 * e, axis=1)
    length = jnp.sum((end - start) * e, axis=1)
    falls = (s_0 < 0.0) & (s_1 > 0.0)
    # Where the tangents at both ends meet.
    least = d_0 + s_0 * (d_1 - d_0 - s_1 * length) / jnp.where(falls, s_0 - s_1, 1.0)

    def edge(best: _Candidate, one: Any) -> tuple[_Candidate, None]:
        start, e, length, falls, least = one

        def searched() -> _Candidate:
            def slope(s: jax.Array) -> jax.Array:
                return to_points(radius, height, (start + s * e)[None])[1][0] @ e

            point = start + sign_change(slope, jnp.zeros_like(length), length) * e
            distance, gradient = to_points(radius, height, point[None])
            new = placed.candidate(distance[0], 0, gradient[0], corner=point, edge=e)
            return best_of([best, new], jnp.less)

        return jax.lax.cond(falls & (least < best.gap), searched, lambda: best), None

    nearest_point: _Candidate = jax.lax.scan(edge, best, (start, e, length, falls, least))[0]
    return nearest_point


def _above_faces(placed: _Placed) -> _Candidate:
    """The face above the support point of the cylinder."""
    radius, height, core = placed.radius, placed.height, placed.core
    n = placed.turned(core.face_normals)
    heights = -reach(radius, height, n) - placed.constant(core.face_offsets) - n @ placed.p
    flat = root(n[:, 0] ** 2 + n[:, 1] ** 2)
    scale = -radius / jnp.where(flat > 0.0, flat, 1.0)
    lowest = jnp.stack([scale * n[:, 0], scale * n[:, 1], -height * jnp.sign(n[:, 2])], axis=1)
    w = (lowest - placed.p[None]) @ placed.R - placed.constant(core.faces)
    # Coordinates within the triangle.
    s, t = (jnp.sum(w * placed.constant(core.face_duals[k]), axis=1) for k in (0, 1))
    over = (s >= -_SEAM) & (t >= -_SEAM) & (s + t <= 1.0 + _SEAM) & (heights > -_TOUCHING * radius)
    heights = jnp.where(over, heights, _FAR)
    i = place_of(heights == jnp.min(heights))
    normal = at(n, i)
    corner = placed.moved(at(placed.constant(core.faces), i)[None])[0]
    return placed.candidate(jnp.min(heights), 1, -normal, normal=normal, corner=corner)


# ---- inside ----------------------------------------------------------------------------------------------------------


def _deepest(placed: _Placed) -> _Candidate:
    """The direction of the greatest gap of solids that overlap."""
    candidates = [_end(placed, 1.0), _end(placed, -1.0), _of_corners(placed)]
    if len(placed.normals):
        candidates.append(_of_faces(placed))
    if len(placed.edges):
        candidates.append(_across_edges(placed))
    best = best_of(candidates, jnp.greater)
    return _at_rims(placed, best) if len(placed.edges) else best


def _end(placed: _Placed, sign: float) -> _Candidate:
    n = sign * placed.z
    heights = placed.corners @ n
    return placed.candidate(jnp.min(heights) - placed.height, 2, n, corner=farthest(placed.corners, -n))


def _of_faces(placed: _Placed) -> _Candidate:
    n, hull = -placed.normals, placed.core.hull
    gaps = n @ placed.p - placed.constant(hull.offsets) - reach(placed.radius, placed.height, n)
    i = place_of(gaps == jnp.max(gaps))
    corner = placed.moved(at(placed.constant(hull.planes[0]), i)[None])[0]
    return placed.candidate(jnp.max(gaps), 1, at(n, i), normal=-at(n, i), corner=corner)


def _of_corners(placed: _Placed) -> _Candidate:
    """From the axis to a corner."""
    flat = placed.corners * placed.constant([[1.0, 1.0, 0.0]])
    n = unit(flat, placed.z)

    def corner(_: None, n: jax.Array) -> tuple[None, jax.Array]:
        return None, jnp.min(flat @ n)

    # Of two corners on one line through the axis, only one is the nearest in its direction.
    heights, nearest = jnp.sum(flat * n, axis=1), jax.lax.scan(corner, None, n)[1]
    rounding = 64.0 * jnp.finfo(flat.dtype).eps * (placed.radius + jnp.max(jnp.abs(flat)))
    is_nearest = (heights <= nearest + rounding) & (jnp.abs(n[:, 2]) < 0.5)
    gaps = jnp.where(is_nearest, nearest - placed.radius, -_FAR)
    i = place_of(gaps == jnp.max(gaps))
    return placed.candidate(jnp.max(gaps), 4, at(n, i), corner=at(placed.corners, i))


def _sides(placed: _Placed) -> tuple[jax.Array, jax.Array] | None:
    """The directions between which an edge is nearest; None: any across it."""
    if not len(placed.normals):
        return None
    first, second = placed.core.hull.sides
    return -placed.turned(first), -placed.turned(second)


def _across_edges(placed: _Placed) -> _Candidate:
    """Across an edge and the axis."""
    e, sides = placed.edges, _sides(placed)
    n = jnp.stack([e[:, 1], -e[:, 0], jnp.zeros_like(e[:, 0])], axis=1)
    square = jnp.sum(n * n, axis=1)
    long = square > 1e-18
    towards = placed.starts if sides is None else sides[0] + sides[1]
    n = (
        jnp.where((jnp.sum(n * towards, axis=1) < 0.0)[:, None], -n, n)
        / jnp.sqrt(jnp.where(long, square, 1.0))[:, None]
    )
    gaps = jnp.sum(n * placed.starts, axis=1) - placed.radius
    within = long if sides is None else long & (sides[0][:, 2] * sides[1][:, 2] <= 0.0)
    gaps = jnp.where(within, gaps, -_FAR)
    i = place_of(gaps == jnp.max(gaps))
    return placed.candidate(jnp.max(gaps), 3, at(n, i), corner=at(placed.starts, i), edge=at(e, i))


def _at_rims(placed: _Placed, best: _Candidate) -> _Candidate:
    """The better of a candidate and the directions in which edges touch rims."""
    radius, height, z = placed.radius, placed.height, placed.z
    for sign in (1.0, -1.0):
        q = placed.starts - sign * height * z[None]
        intervals = rim_intervals(q, placed.edges, _sides(placed), sign * z, radius)

        def edge(best: _Candidate, one: Any) -> tuple[_Candidate, None]:
            interval, q, start, e = one

            def searched() -> _Candidate:
                n = rim_normal(RimIntervals(*interval))
                gap = n @ q - radius * root(n[0] ** 2 + n[1] ** 2)
                return best_of([best, placed.candidate(gap, 5, n, corner=start, edge=e)], jnp.greater)

            return jax.lax.cond(interval[-1], searched, lambda: best), None

        best = jax.lax.scan(edge, best, (tuple(intervals), q, placed.starts, placed.edges))[0]
    return best
