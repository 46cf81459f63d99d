"""The signed distance of a solid cylinder and a ball, a capsule, a box or a polytope.

The signed distance of two convex solids is the greatest gap between their projections on a direction n,

    d = max over |n| = 1 of  min_j n . v_j - l |n . z| - r sqrt(1 - (n . z)^2),

for a cylinder of radius r and half length l around the axis z, and the corners $v_j$ of the other solid. Inside, the
greatest gap is in a direction that is normal to a smooth part of the boundary of the Minkowski difference. These are
the normals of faces, those of the ends, the products of edges and the axis, the directions from the axis to corners,
and for each edge the directions across it in which it touches a rim (`rim.py`). Outside, the distance is the least over
the edges, on which the distance to the cylinder is a convex function, and over the faces above which the cylinder's
nearest point lies. Both are exact, so that the signed distance is continuous through contact.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp

from ...expr import Abs, Expr, Norm
from ...view import Cylinder
from .polytope import FAR, Core, directions, root, within_triangles
from .rim import rim_normals, turned, unit

#: Halvings of an edge; a step of Newton's method that is longer, relative to the edge, is at a kink.
_HALVINGS, _KINK = 50, 1e-6
#: A height above a face that is zero by rounding, relative to the radius.
_TOUCHING = 1e-12


def over_plane(cylinder: Cylinder, n: Expr) -> Expr:
    """How far a cylinder reaches along the direction -n from its centre, in its own axes."""
    return 0.5 * float(cylinder.length) * Abs(n[2]) + float(cylinder.radius) * Norm(n[:2])


def cylinder_to_core(cylinder: Cylinder, core: Core, T: Any) -> jax.Array:
    """The signed distance () for the pose T of a core in the frame of a cylinder."""
    T = jnp.asarray(T)
    radius, height = float(cylinder.radius), 0.5 * float(cylinder.length)
    if not len(core.edges):
        return _to_point(radius, height, T[:3, 3]) - core.radius
    depth = _depth(radius, height, core, T)
    return jnp.where(depth > 0.0, _apart(radius, height, core, T), depth) - core.radius


def reach(radius: float, height: float, n: jax.Array) -> jax.Array:
    """The support (k,) of a cylinder in its frame along directions n (k, 3)."""
    return height * jnp.abs(n[:, 2]) + radius * root(n[:, 0] ** 2 + n[:, 1] ** 2)


def _depth(radius: float, height: float, core: Core, T: jax.Array) -> jax.Array:
    """The greatest gap over the directions of the smooth parts; it is exact where the solids overlap."""
    R, z = T[:3, :3], jnp.asarray([0.0, 0.0, 1.0], T.dtype)
    constant = functools.partial(jnp.asarray, dtype=T.dtype)
    V = constant(core.corners) @ R.T + T[None, :3, 3]

    def gap(n: jax.Array) -> jax.Array:
        return jnp.min(n @ V.T, axis=1) - reach(radius, height, n)

    across = unit(jnp.cross(constant(directions(core.edges)) @ R.T, z[None]), z)
    out = unit(V.at[:, 2].set(0.0), z)
    normals = jnp.concatenate([-constant(core.normals) @ R.T, z[None], -z[None], across, -across, out])
    of_faces = gap(normals[jnp.argmax(gap(jax.lax.stop_gradient(normals)))][None])
    start, end = (constant(core.edges[:, k]) @ R.T + T[None, :3, 3] for k in (0, 1))
    e = (end - start) / jnp.sqrt(jnp.sum((end - start) ** 2, axis=1))[:, None]
    e = jnp.concatenate([e, e])
    q = jnp.concatenate([start - height * z[None], start + height * z[None]])
    tried = rim_normals(jax.lax.stop_gradient(q), jax.lax.stop_gradient(e), z[None], constant(radius))
    best = jnp.argmax(jax.lax.stop_gradient(gap(tried.reshape(-1, 3))))
    n = turned(tried.reshape(-1, 3)[best], e[best // 2], q[best // 2], z, radius)
    return jnp.maximum(of_faces, gap(n[None]))[0]


def _apart(radius: float, height: float, core: Core, T: jax.Array) -> jax.Array:
    """The distance of separate solids."""
    R, p = T[:3, :3], T[:3, 3]
    constant = functools.partial(jnp.asarray, dtype=T.dtype)
    middle = constant(core.edges.mean(axis=1)) @ R.T + p[None]
    half = constant(0.5 * (core.edges[:, 1] - core.edges[:, 0])) @ R.T
    nearest = jax.vmap(functools.partial(_nearest, radius, height))
    s = nearest(*map(jax.lax.stop_gradient, (middle, half)))
    there = jax.lax.stop_gradient(middle + s[:, None] * half)
    i = jnp.argmin(jax.vmap(functools.partial(_to_point, radius, height))(there))
    distance = _along(radius, height, s[i], middle[i], half[i])
    if not len(core.faces):
        return distance
    faces = constant(core.faces)
    n = jnp.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    # Corners of triangles are in any order: outward is away from the mean of all.
    n = n * jnp.sign(jnp.sum(n * (faces[:, 0] - constant(core.corners).mean(axis=0)[None]), axis=1))[:, None]
    n = n / jnp.sqrt(jnp.sum(n**2, axis=1))[:, None]
    turned_n = n @ R.T
    heights = -reach(radius, height, turned_n) - jnp.sum(n * faces[:, 0], axis=1) - turned_n @ p
    flat = unit(turned_n.at[:, 2].set(0.0), jnp.zeros(3, T.dtype))
    lowest = -radius * flat - height * jnp.sign(turned_n[:, 2:]) * jnp.asarray([[0.0, 0.0, 1.0]], T.dtype)
    over = within_triangles((jax.lax.stop_gradient(lowest) - p[None]) @ R, faces)
    return jnp.minimum(distance, jnp.min(jnp.where(over & (heights > -_TOUCHING * radius), heights, FAR)))


def _nearest(radius: float, height: float, middle: jax.Array, axis: jax.Array) -> jax.Array:
    """The s, |s| <= 1, of the point middle + s axis with the least signed distance, a convex function of s."""
    slope = jax.grad(lambda s: _to_point(radius, height, middle + s * axis))

    def halve(_: Any, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = ends
        s = 0.5 * (low + high)
        rises = slope(s) > 0.0
        return jnp.where(rises, low, s), jnp.where(rises, s, high)

    one = jnp.ones((), middle.dtype)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (-one, one))
    return 0.5 * (low + high)


def _along(radius: float, height: float, s: jax.Array, middle: jax.Array, axis: jax.Array) -> jax.Array:
    """The signed distance of the nearest point of an edge, at s; a step of Newton's method gives s its derivatives."""

    def at(s: jax.Array, middle: jax.Array, axis: jax.Array) -> jax.Array:
        return _to_point(radius, height, middle + s * axis)

    slope = jax.grad(at)
    fixed = jax.lax.stop_gradient((middle, axis))
    curvature = jax.grad(slope)(s, *fixed)
    curved = curvature > _KINK * jnp.sum(fixed[1] ** 2)
    step = slope(s, middle, axis) / jnp.where(curved, curvature, 1.0)
    smooth = curved & (jnp.abs(jax.lax.stop_gradient(step)) < _KINK)
    return at(jnp.where(smooth, s - jnp.where(smooth, step, 0.0), s), middle, axis)


def _to_point(radius: float, height: float, p: jax.Array) -> jax.Array:
    """The signed distance of a point (3,), in the frame of the cylinder."""
    across = root(p[0] ** 2 + p[1] ** 2) - radius
    up = jnp.abs(p[2]) - height
    outside = root(jnp.maximum(across, 0.0) ** 2 + jnp.maximum(up, 0.0) ** 2)
    return outside + jnp.minimum(jnp.maximum(across, up), 0.0)
