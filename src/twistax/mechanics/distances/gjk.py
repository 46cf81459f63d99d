"""The nearest features of two convex polytopes: the Gilbert-Johnson-Keerthi (GJK) algorithm.

The distance of two convex sets A and B is the norm of the point of least norm of their Minkowski difference
$A - B = \\{a - b\\}$. GJK computes this point v on a simplex of at most three differences of corners: in each iteration
the corner of $A - B$ that is farthest along -v joins the simplex, v becomes the point of least norm of the larger
simplex, and corners on which v does not depend leave it. For polytopes this ends after finitely many iterations. If v
is in the interior of a tetrahedron, it is zero and the polytopes overlap.

Sources: E. Gilbert, D. Johnson, S. Keerthi, A fast procedure for computing the distance between complex objects in
three-dimensional space, IEEE Journal on Robotics and Automation 4 (1988); C. Ericson, Real-Time Collision Detection
(2005), sections 5.1 and 9.5.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

#: The most iterations; fewer than ten are typical.
_MOST = 64
#: Of the squared distance: what v may exceed the distance by, and of the squares of lengths of flat simplices.
_EXACT, _FLAT = 1e-13, 1e-24
#: The distance that counts as zero, relative to the size of the solids.
_TOUCHING = 1e-13
#: Larger than all squared distances.
_FAR = 1e30


class ClosestFeatures(NamedTuple):
    """Features of two polytopes.

    Attributes:
        a, b: (3, 3) corners of A, and of B in the frame of A. The differences of the first one, two or three of each
            span the nearest corner, edge or face of A - B. If fewer than three are needed, others are repeated.
        n: (3,) the direction from A to B, not of unit length.
    """

    a: jax.Array
    b: jax.Array
    n: jax.Array


class _Simplex(NamedTuple):
    """Differences of corners; `used` (4,) tells which of them count."""

    a: jax.Array
    b: jax.Array
    used: jax.Array
    v: jax.Array
    square: jax.Array
    iteration: jax.Array
    ended: jax.Array


def nearest_features(A: jax.Array, B: jax.Array, size: Any) -> tuple[ClosestFeatures, jax.Array, jax.Array]:
    """The nearest corners, edges or faces of the convex hulls of points A (k, 3) and B (l, 3).

    Args:
        size: a length of the order of both.
    Returns:
        The features, how many differences they need, 1 to 3, and whether the polytopes overlap.
    """
    start = A[0] - B[0]
    simplex = _Simplex(
        jnp.broadcast_to(A[0], (4, 3)),
        jnp.broadcast_to(B[0], (4, 3)),
        jnp.asarray([True, False, False, False]),
        start,
        start @ start,
        jnp.asarray(0),
        jnp.asarray(False),
    )
    touching = (_TOUCHING * size) ** 2

    def step(now: _Simplex) -> _Simplex:
        a, b = farthest(A, -now.v), farthest(B, now.v)
        w = a - b
        # A lower bound of the distance, times |v|, is v . w.
        ended = now.square - now.v @ w <= _EXACT * (now.square + size * jnp.sqrt(now.square))
        free = first_of(~now.used)[:, None]
        grown = _reduced(jnp.where(free, a, now.a), jnp.where(free, b, now.b), now.used | free[:, 0])
        ended = ended | (grown.square >= now.square)
        kept = jax.tree.map(lambda new, old: jnp.where(ended, old, new), grown, now)
        return kept._replace(iteration=now.iteration + 1, ended=ended | (grown.square <= touching))

    def goes_on(now: _Simplex) -> jax.Array:
        return ~now.ended & (now.iteration < _MOST)

    end = jax.lax.while_loop(goes_on, step, simplex)
    order, left = [first_of(end.used)], end.used
    for _ in range(2):
        left = left & ~order[-1]
        order.append(jnp.where(left.any(), first_of(left), order[0]))
    rows = jnp.stack(order).astype(A.dtype)
    return ClosestFeatures(rows @ end.a, rows @ end.b, -end.v), jnp.sum(end.used), end.square <= touching


def first_of(flags: jax.Array) -> jax.Array:
    """The first of some flags alone."""
    places = jnp.arange(len(flags))
    return places == jnp.min(jnp.where(flags, places, len(flags)))


def farthest(points: jax.Array, n: jax.Array) -> jax.Array:
    """The point (3,) of points (k, 3) that is farthest along n."""
    heights = points @ n
    return at(points, place_of(heights == jnp.max(heights)))


def place_of(flags: jax.Array) -> jax.Array:
    """The place of the first of some flags, one of which is set."""
    return jnp.min(jnp.where(flags, jnp.arange(len(flags)), len(flags) - 1))


def at(rows: jax.Array, place: jax.Array) -> jax.Array:
    """The row at a place."""
    return jax.lax.dynamic_index_in_dim(rows, place, keepdims=False)


def _reduced(a: jax.Array, b: jax.Array, used: jax.Array) -> _Simplex:
    """The point of least norm of a simplex, and the corners on which it depends."""
    w = a - b
    squares, points, subsets = [], [], []

    def add(subset: tuple[int, ...], point: jax.Array, inside: jax.Array | bool = True) -> None:
        there = jnp.stack([used[k] for k in subset]).all() & inside
        squares.append(jnp.where(there, point @ point, _FAR))
        points.append(point)
        subsets.append([k in subset for k in range(4)])

    for k in range(4):
        add((k,), w[k])
    for i, j in itertools.combinations(range(4), 2):
        e = w[j] - w[i]
        length = e @ e
        s = -(w[i] @ e)
        inside = (s > 0.0) & (s < length)
        add((i, j), w[i] + s / jnp.where(inside, length, 1.0) * e, inside)
    normals = {}
    for i, j, k in itertools.combinations(range(4), 3):
        e, f = w[j] - w[i], w[k] - w[i]
        n = normals[i, j, k] = jnp.cross(e, f)
        area = n @ n
        sides = [jnp.cross(w[p], w[q]) @ n for p, q in ((j, k), (k, i), (i, j))]
        inside = (sides[0] > 0.0) & (sides[1] > 0.0) & (sides[2] > 0.0) & (area > _FLAT * (e @ e) * (f @ f))
        add((i, j, k), n * ((w[i] @ n) / jnp.where(inside, area, 1.0)), inside)
    # The origin is in a tetrahedron that is on the same side of each face as the opposite corner.
    around = jnp.asarray(True)
    for triple, k in (((0, 1, 2), 3), ((0, 1, 3), 2), ((0, 2, 3), 1), ((1, 2, 3), 0)):
        n = normals[triple]
        around = around & ((n @ (w[k] - w[triple[0]])) * -(n @ w[triple[0]]) > 0.0)
    add((0, 1, 2, 3), jnp.zeros_like(w[0]), around)
    every = jnp.stack(squares)
    least = first_of(every == jnp.min(every)).astype(w.dtype)
    v = least @ jnp.stack(points)
    chosen = least @ jnp.asarray(subsets, w.dtype) > 0.5
    return _Simplex(a, b, chosen, v, jnp.min(every), jnp.asarray(0), jnp.asarray(False))
