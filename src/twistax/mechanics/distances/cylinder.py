"""Distances of a solid cylinder to points and segments, and a prism that encloses it for other solids.

The signed distance of a point to a convex solid is a convex function. Along a segment, its minimum is where the slope
changes sign: bisection finds the minimum, and one Newton step provides its derivatives.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...expr import Abs, Expr, Norm
from ...expr.functions.function import Function
from ...view import Cylinder
from .polytope import ConvexPolytope, root

#: The number of bisections of a segment; a Newton step that is longer, relative to the segment, indicates a kink.
_HALVINGS, _KINK = 55, 1e-6
#: The number of sides of the prism around a cylinder.
_SIDES = 24


def to_segment(cylinder: Cylinder, half: float, T: Expr) -> Expr:
    """The signed distance () to a segment along z with this half length, at the pose T in the frame of the cylinder.

    A negative value is the depth of the deepest point of the segment.
    """
    radius, height = float(cylinder.radius), 0.5 * float(cylinder.length)

    def distance(T: jax.Array) -> jax.Array:
        middle, axis = T[:3, 3], half * T[:3, 2]
        if not half:
            return _to_point(radius, height, middle)
        return _least(radius, height, middle, axis)

    return Function(distance, (), name="signed_distance")(T)


def over_plane(cylinder: Cylinder, n: Expr) -> Expr:
    """The extent of a cylinder along the direction -n from its centre, in its own axes."""
    return 0.5 * float(cylinder.length) * Abs(n[2]) + float(cylinder.radius) * Norm(n[:2])


def prism_around(cylinder: Cylinder) -> ConvexPolytope:
    """A prism with 24 sides that contains the cylinder, and extends beyond it by at most 0.9 % of its radius."""
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) * (float(cylinder.radius) / np.cos(np.pi / _SIDES))
    ends = [np.column_stack([ring, np.full(_SIDES, side * 0.5 * float(cylinder.length))]) for side in (-1.0, 1.0)]
    return ConvexPolytope(np.concatenate(ends), at=cylinder.at)


def _least(radius: float, height: float, middle: jax.Array, axis: jax.Array) -> jax.Array:
    """The smallest signed distance of the points middle + s axis, |s| <= 1."""

    def at(s: jax.Array, middle: jax.Array, axis: jax.Array) -> jax.Array:
        return _to_point(radius, height, middle + s * axis)

    slope = jax.grad(at)
    fixed = jax.lax.stop_gradient(middle), jax.lax.stop_gradient(axis)

    def halve(_: Any, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = ends
        s = 0.5 * (low + high)
        rises = slope(s, *fixed) > 0.0
        return jnp.where(rises, low, s), jnp.where(rises, s, high)

    one = jnp.ones((), middle.dtype)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (-one, one))
    s = 0.5 * (low + high)
    curvature = jax.grad(slope)(s, *fixed)
    curved = curvature > _KINK * jnp.sum(fixed[1] ** 2)
    step = slope(s, middle, axis) / jnp.where(curved, curvature, 1.0)
    smooth = curved & (jnp.abs(jax.lax.stop_gradient(step)) < _KINK)
    s = jnp.where(smooth, s - jnp.where(smooth, step, 0.0), s)
    return at(s, middle, axis)


def _to_point(radius: float, height: float, p: jax.Array) -> jax.Array:
    """The signed distance of a point (3,), in the frame of the cylinder."""
    across = root(p[0] ** 2 + p[1] ** 2) - radius
    up = jnp.abs(p[2]) - height
    outside = root(jnp.maximum(across, 0.0) ** 2 + jnp.maximum(up, 0.0) ** 2)
    return outside + jnp.minimum(jnp.maximum(across, up), 0.0)
