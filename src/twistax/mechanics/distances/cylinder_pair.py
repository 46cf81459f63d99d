"""The signed distance of two solid cylinders.

It is the greatest gap over unit vectors n, outside and inside,

    n . p - l_1 |n . z_1| - r_1 |n x z_1| - l_2 |n . z_2| - r_2 |n x z_2|,

for the centres p apart, the axes z, the radii r and the half lengths l. The gap is greatest in one of these directions:
both axes, their product, the directions across one axis in which a side touches a rim (`rim.py`), or the normal of two
rims at their nearest points. For these the square of the distance from a point of the smaller rim to the circle of the
other one is a function of one angle, with 32 intervals in which bisection finds its least values.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...view import Cylinder
from .cylinder import reach
from .polytope import root
from .rim import rim_normals, turned, unit

#: Intervals of a rim; halvings of one.
_INTERVALS, _HALVINGS = 32, 24
#: Of sines and curvatures that count as zero, and the longest step of Newton's method.
_SMALL, _LONG = 1e-9, 1e-3


def cylinder_to_cylinder(a: Cylinder, b: Cylinder, T: Any) -> jax.Array:
    """The signed distance () for the pose T of b in the frame of a, whose radius is not larger."""
    T = jnp.asarray(T)
    r, s = (float(one.radius) for one in (a, b))
    h, k = (0.5 * float(one.length) for one in (a, b))
    z, y, p = jnp.asarray([0.0, 0.0, 1.0], T.dtype), T[:3, 2], T[:3, 3]

    def gap(n: jax.Array) -> jax.Array:
        of_b = k * jnp.abs(n @ y) + s * root(jnp.sum(jnp.cross(n, y[None]) ** 2, axis=1))
        return n @ p - reach(r, h, n) - of_b

    def best(tried: jax.Array) -> jax.Array:
        return jnp.argmax(gap(jax.lax.stop_gradient(tried)))

    across = unit(jnp.cross(z, y), z)
    flat = jnp.stack([z, -z, y, -y, across, -across])
    sides = (z, y, p - k * y, s), (z, y, p + k * y, s), (y, z, p - h * z, r), (y, z, p + h * z, r)
    e, axis, q = (jnp.stack([side[i] for side in sides]) for i in range(3))
    radii = jnp.asarray([side[3] for side in sides], T.dtype)
    fixed_q, fixed_e, fixed_axis = (jax.lax.stop_gradient(a) for a in (q, e, axis))
    swept = rim_normals(fixed_q, fixed_e, fixed_axis, radii).reshape(-1, 3)
    i = best(swept)
    side = turned(swept[i], e[i // 2], q[i // 2], axis[i // 2], radii[i // 2])
    corners = jnp.stack([p - i * h * z - j * k * y for i in (-1.0, 1.0) for j in (-1.0, 1.0)])
    rims, of_corner = _rims(r, s, jax.lax.stop_gradient(corners), jax.lax.stop_gradient(y))
    i = best(rims)
    n, q = rims[i], corners[of_corner[i]]
    n = jax.lax.stop_gradient(_climbed(n, q, ((r, z), (s, y))))
    tops = gap(jnp.stack([flat[best(flat)], side, _climbed(n, q, ((r, z), (s, y)))]))
    return tops[jnp.argmax(tops)]


def _rims(r: float, s: float, q: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Directions (k, 3) between two rims at distances that are least, or ends of intervals; the q (4, 3) of each.

    The first rim has the radius r around z, the second one the radius s around y, with its centre at q.
    """
    edges = jnp.linspace(0.0, 2.0 * np.pi, _INTERVALS + 1, dtype=q.dtype)
    low, high = (jnp.tile(ends, (len(q), 1)) for ends in (edges[:-1], edges[1:]))
    y = jnp.broadcast_to(y, (*low.shape, 3))
    q = jnp.broadcast_to(q[:, None], y.shape)

    def at(t: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """A point of the first rim and its tangent; the direction (..., 3) from the centre of the second rim to it."""
        c, d, zero = jnp.cos(t), jnp.sin(t), jnp.zeros_like(t)
        x, tangent = jnp.stack([r * c, r * d, zero], axis=-1), jnp.stack([-d, c, zero], axis=-1)
        w = x - q
        u = w - jnp.sum(w * y, axis=-1, keepdims=True) * y
        return x, tangent, unit(u, y)

    def halve(_: Any, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = ends
        t = 0.5 * (low + high)
        x, tangent, u = at(t)
        rises = jnp.sum((x - q - s * u) * tangent, axis=-1) > 0.0
        return jnp.where(rises, low, t), jnp.where(rises, t, high)

    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (low, high))
    x, tangent, u = at(0.5 * (low + high))
    between = unit(q + s * u - x, y)  # ill-conditioned at contact, where the product of tangents is not
    product = unit(jnp.cross(tangent, jnp.cross(y, u)), y)
    rims = jnp.stack([between, -between, product, -product], axis=2)
    of_corner = np.repeat(np.arange(len(q)), rims.shape[1] * rims.shape[2])
    return rims.reshape(-1, 3), jnp.asarray(of_corner)


def _climbed(n: jax.Array, q: jax.Array, discs: tuple[tuple[float, jax.Array], ...]) -> jax.Array:
    """The unit vector (3,) next to n with the greatest gap of two discs, by a step of Newton's method on the sphere."""
    n = jax.lax.stop_gradient(n)
    first = jnp.cross(n, jnp.eye(3, dtype=n.dtype)[jnp.argmin(jnp.abs(n))])
    first = first / jnp.sqrt(first @ first)
    across = jnp.stack([first, jnp.cross(n, first)], axis=1)
    slope, curvature, smooth = q, jnp.zeros((2, 2), n.dtype), jnp.asarray(True)
    for radius, axis in discs:
        height = n @ axis
        h = root(jnp.maximum(1.0 - height * height, 0.0))
        smooth, h = smooth & (h > _SMALL), jnp.where(h > _SMALL, h, 1.0)
        slope = slope + radius * height / h * axis
        parts = axis @ across
        curvature = curvature + radius / h**3 * parts[:, None] * parts[None]
    curvature = curvature - (slope @ n) * jnp.eye(2, dtype=n.dtype)
    size = curvature[0, 0] * curvature[1, 1] - curvature[0, 1] ** 2
    curved = smooth & (curvature[0, 0] < 0.0) & (size > (_SMALL * discs[0][0]) ** 2)
    g = slope @ across
    step = jnp.stack(
        [curvature[0, 1] * g[1] - curvature[1, 1] * g[0], curvature[0, 1] * g[0] - curvature[0, 0] * g[1]]
    ) / jnp.where(curved, size, 1.0)
    near = curved & (jax.lax.stop_gradient(step @ step) < _LONG**2)
    return unit(n + across @ jnp.where(near, step, 0.0), n)
