"""The direction of least depth of two convex polytopes that overlap, by separating axes.

The depth is minus the greatest gap between the projections of both on an axis. This axis is the normal of a face of the
Minkowski difference: the normal of a face of one polytope, or the product of an edge of each. An edge of A and an edge
of B form a face if the arcs between the normals of their faces cross on the unit sphere (Gauss map), those of B with
opposite sign.

Source: D. Gregorius, The Separating Axis Test between Convex Polyhedra, Game Developers Conference (2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .gjk import ClosestFeatures, at, farthest, place_of

#: Of the squared sine of edges that count as parallel.
_PARALLEL = 1e-14
#: Smaller than all gaps.
_NONE = -1e30


class Hull(NamedTuple):
    """Arrays of a `Core`: corners (v, 3), of edges the ends, directions and normals of both sides (e, 3), of faces the
    normals (g, 3), offsets (g,) and three corners (g, 3).
    """

    corners: Any
    edges: tuple[Any, Any]
    directions: Any
    sides: tuple[Any, Any]
    normals: Any
    offsets: Any
    planes: tuple[Any, Any, Any]


class _Gap(NamedTuple):
    gap: jax.Array
    contact: ClosestFeatures


def least_depth(a: Hull, b: Hull, R: jax.Array, p: jax.Array) -> ClosestFeatures:
    """The features with the greatest gap; a has faces, and b, at the pose (R, p), may be a point or a segment."""
    A, B = a.corners, b.corners @ R.T + p[None]
    contacts = [_of_faces(a.normals, a.offsets, a.planes, B)]
    if len(b.normals):
        normals = b.normals @ R.T
        planes = [corners @ R.T + p[None] for corners in b.planes]
        gap, reverse = _of_faces(normals, b.offsets + normals @ p, planes, A)
        contacts.append(_Gap(gap, ClosestFeatures(reverse.b, reverse.a, -reverse.n)))
    if len(b.directions):
        contacts.append(_of_edges(a, b, R, p))
    best = contacts[0]
    for other in contacts[1:]:
        better = other.gap > best.gap
        best = jax.tree.map(lambda new, old, better=better: jnp.where(better, new, old), other, best)
    return best.contact


def _of_faces(normals: jax.Array, offsets: jax.Array, planes: Sequence[jax.Array], points: jax.Array) -> _Gap:
    """The face of A with the greatest gap to the points of B."""

    def face(_: None, plane: tuple[jax.Array, jax.Array]) -> tuple[None, jax.Array]:
        return None, jnp.min(points @ plane[0]) - plane[1]

    gaps = jax.lax.scan(face, None, (normals, offsets))[1]
    place = place_of(gaps == jnp.max(gaps))
    n, *corners = (at(x, place) for x in (normals, *planes))
    return _Gap(
        jnp.max(gaps), ClosestFeatures(jnp.stack(corners), jnp.broadcast_to(farthest(points, -n)[None], (3, 3)), n)
    )


def _of_edges(a: Hull, b: Hull, R: jax.Array, p: jax.Array) -> _Gap:
    """The pair of edges with the greatest gap, among those that form a face of the Minkowski difference."""
    of_a = (a.edges[0], a.directions, *a.sides)
    start, end = (points @ R.T + p[None] for points in b.edges)
    e = b.directions @ R.T
    C, D = (-normals @ R.T for normals in b.sides)

    def edge(_: None, one: Any) -> tuple[None, tuple[jax.Array, jax.Array]]:
        q, d, A, B = one
        of_A, of_B = e @ A, e @ B
        crosses = of_A * of_B < 0.0
        if len(b.normals):
            of_C, of_D = C @ d, D @ d
            crosses = crosses & (of_C * of_D < 0.0) & (of_C * of_B > 0.0)
        n = jnp.cross(jnp.broadcast_to(d[None], e.shape), e)
        size = jnp.sum(n * n, axis=1)
        outward = jnp.where(n @ (A + B) < 0.0, -1.0, 1.0).astype(R.dtype)
        skew = crosses & (size > _PARALLEL)
        gap = outward * jnp.sum(n * (start - q[None]), axis=1) / jnp.sqrt(jnp.where(skew, size, 1.0))
        gap = jnp.where(skew, gap, _NONE)
        return None, (jnp.max(gap), place_of(gap == jnp.max(gap)))

    gaps, places = jax.lax.scan(edge, None, of_a)[1]
    i = place_of(gaps == jnp.max(gaps))
    q, d, A, B = (at(x, i) for x in of_a)
    other = at(a.edges[1], i)
    j = at(places, i)
    of_b = at(start, j), at(end, j)
    n = jnp.cross(d, at(e, j))
    n = jnp.where(n @ (A + B) < 0.0, -n, n)
    n = n / jnp.sqrt(jnp.where(n @ n > 0.0, n @ n, 1.0))
    contact = ClosestFeatures(jnp.stack([q, other, q]), jnp.stack([of_b[0], of_b[0], of_b[1]]), n)
    return _Gap(jnp.max(gaps), contact)
