r"""The directions in which an edge touches the rim of a disc.

Across an edge e the rim, of radius r around the axis z, is an ellipse with the half axes r and $r |e \cdot z|$. The gap
of the edge and the rim along a unit vector n across e,

    f(n) = n . q - r sqrt(1 - (n . z)^2),

is the signed distance from q to a tangent of the ellipse. Each nearest point of an ellipse is in the quadrant of q or
in its mirror image across the major axis. With the half axes 1 and b and the angle t of n from the major axis, the
slope of f changes its sign from plus to minus once in the first quadrant, and at most once in the second one beyond
$\tan t = (b q_2 / q_1)^{1/3} / b$. So each half of the circle has at most one greatest f, and an interval around it.

Source: D. Eberly, Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid, section 2 (2013).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .polytope import root

#: Of sines and curvatures that count as zero, and the longest step of Newton's method.
_SMALL, _LONG = 1e-9, 1e-3
#: The most iterations for a root, and the length of an interval that is one, relative to the first.
_MOST, _EXACT = 60, 1e-13


def unit(vectors: jax.Array, otherwise: jax.Array) -> jax.Array:
    """Vectors (..., 3) of unit length; those of a length below 1e-9 are replaced."""
    square = jnp.sum(vectors**2, axis=-1, keepdims=True)
    long = square > _SMALL**2
    otherwise = jnp.broadcast_to(otherwise, vectors.shape)
    return jnp.where(long, vectors / jnp.sqrt(jnp.where(long, square, 1.0)), otherwise)


def sign_change(function: Callable[[jax.Array], jax.Array], low: jax.Array, high: jax.Array) -> jax.Array:
    """The place () between `low` and `high` where a function changes its sign, by the Illinois method.

    Source: M. Dowell, P. Jarratt, A modified regula falsi method, BIT 11 (1971).
    """
    length = jnp.abs(high - low)

    def step(now: Any) -> Any:
        (a, of_a), (b, of_b), k, phase = now
        # Every third step halves the interval, in which a kink may be.
        s = jnp.where(phase == 2, 0.5 * (a + b), (a * of_b - b * of_a) / jnp.where(of_b == of_a, 1.0, of_b - of_a))
        s = jnp.where((s - a) * (s - b) < 0.0, s, 0.5 * (a + b))
        value = function(s)
        changes = value * of_b < 0.0
        a, of_a = jnp.where(changes, b, a), jnp.where(changes, of_b, 0.5 * of_a)
        return (a, of_a), (s, value), k + 1, jnp.where(phase == 2, 0, phase + 1)

    def goes_on(now: Any) -> jax.Array:
        (a, _), (b, value), k, _ = now
        return (k < _MOST) & (jnp.abs(a - b) > _EXACT * length) & (value != 0.0)

    start = (low, function(low)), (high, function(high)), jnp.asarray(0), jnp.asarray(0)
    return jax.lax.while_loop(goes_on, step, start)[1][0]


class RimIntervals(NamedTuple):
    """For edges, the intervals with a greatest f in one half of the circle across each.

    A direction is n = x u + y w, with the point (x, y) on the line from `low` to `high`.

    Attributes:
        u, w: (k, 3) unit vectors across the edge along the major and the minor axis.
        low, high: (k, 2), of unit length.
        b: (k,) the ratio of both half axes.
        q: (k, 2) coordinates of q, relative to the radius.
        inside: (k,) whether there is a greatest f in the interval.
    """

    u: jax.Array
    w: jax.Array
    low: jax.Array
    high: jax.Array
    b: jax.Array
    q: jax.Array
    inside: jax.Array


def rim_intervals(
    q: jax.Array, e: jax.Array, sides: tuple[jax.Array, jax.Array] | None, z: jax.Array, radius: Any
) -> RimIntervals:
    """The intervals of directions n with n . z >= 0.

    Args:
        q: (k, 3) from the centre of the rim to each edge.
        e: (k, 3) unit vectors along the edges.
        sides: (k, 3) the unit vectors between which n is; None: anywhere across the edge.
        z: (3,) the axis.
    """
    # Across an edge along z the ellipse is a circle: any axis is a major one, and the half is that of q.
    third = (jnp.abs(e[:, 2:]) < 0.9).astype(e.dtype)
    other = jnp.cross(e, jnp.concatenate([1.0 - third, jnp.zeros_like(third), third], axis=1))
    of_z = jnp.cross(e, jnp.broadcast_to(z[None], e.shape))
    is_circle = jnp.sum(of_z * of_z, axis=1) <= _SMALL**2
    u = unit(of_z, unit(other, z))
    w = jnp.cross(e, u)
    upward = jnp.where(jnp.where(is_circle, jnp.sum(q * w, axis=1), w @ z) < 0.0, -1.0, 1.0).astype(e.dtype)
    w, b = w * upward[:, None], jnp.where(is_circle, 1.0, jnp.abs(e @ z))
    q_u, q_w = jnp.sum(q * u, axis=1) / radius, jnp.sum(q * w, axis=1) / radius
    turn = jnp.where(q_u < 0.0, -1.0, 1.0).astype(e.dtype)
    u, q_u = u * turn[:, None], jnp.abs(q_u)
    # Angles from u to w: of the quadrant of q, or of its part beyond the least one.
    least = jnp.stack([b * jnp.cbrt(q_u), jnp.cbrt(b * jnp.maximum(-q_w, 0.0))], axis=1)
    right = jnp.broadcast_to(jnp.asarray([[1.0, 0.0]], e.dtype), least.shape)
    low = _unit(least, right)
    high = jnp.broadcast_to(jnp.asarray([[0.0, 1.0]], e.dtype), low.shape)
    within = b >= 0.0
    if sides is not None:
        ends = [jnp.stack([jnp.sum(n * u, axis=1), jnp.sum(n * w, axis=1)], axis=1) for n in sides]
        swap = (_cross(*ends) < 0.0)[:, None]
        first, last = jnp.where(swap, ends[1], ends[0]), jnp.where(swap, ends[0], ends[1])
        # The arc is shorter than half of the circle, and so is the interval: their common part is one arc.
        begins, stops = _between(first, low, last), _between(first, high, last)
        holds_first, holds_last = _between(low, first, high), _between(low, last, high)
        within = within & (begins | holds_first) & (stops | holds_last)
        low, high = jnp.where(begins[:, None], low, first), jnp.where(stops[:, None], high, last)
    inside = within & (_slope(low, q_u, q_w, b) >= 0.0) & (_slope(high, q_u, q_w, b) <= 0.0)
    return RimIntervals(u, w, low, high, b, jnp.stack([q_u, q_w], axis=1), inside)


def rim_normal(one: RimIntervals) -> jax.Array:
    """The direction (3,) of the greatest f of one interval: of arrays without their first axis."""

    def at(s: jax.Array) -> jax.Array:
        return one.low + s * (one.high - one.low)

    def slope(s: jax.Array) -> jax.Array:
        return _slope(_unit(at(s)[None], one.low[None]), one.q[None, 0], one.q[None, 1], one.b[None])[0]

    zero = jnp.zeros((), one.b.dtype)
    n = at(sign_change(slope, zero, zero + 1.0))
    return unit(n[0] * one.u + n[1] * one.w, one.u)


def _slope(n: jax.Array, q_u: jax.Array, q_w: jax.Array, b: jax.Array) -> jax.Array:
    """The derivative (k,) of f by the angle of n (k, 2), for the radius one."""
    c, s = n[:, 0], n[:, 1]
    height = root(c * c + b * b * s * s)
    return q_w * c - q_u * s + (1.0 - b * b) * s * c / jnp.where(height > 0.0, height, 1.0)


def _cross(a: jax.Array, b: jax.Array) -> jax.Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _between(first: jax.Array, n: jax.Array, last: jax.Array) -> jax.Array:
    """Whether n (k, 2) is on the arc from `first` to `last`, which is shorter than half of the circle."""
    return (_cross(first, n) >= 0.0) & (_cross(n, last) >= 0.0)


def _unit(vectors: jax.Array, otherwise: jax.Array) -> jax.Array:
    square = jnp.sum(vectors**2, axis=1, keepdims=True)
    return jnp.where(square > 0.0, vectors / jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), otherwise)


def turned(n: jax.Array, e: jax.Array, q: jax.Array, z: jax.Array, radius: Any) -> jax.Array:
    """The unit vector (3,) across the edge e (3,) next to n with the greatest f, with its first derivatives."""
    n = jax.lax.stop_gradient(n)
    n = unit(n - e * (e @ n), n)
    t = jnp.cross(e, n)
    n_z, t_z = n @ z, t @ z
    h = root(jnp.maximum(1.0 - n_z * n_z, 0.0))
    high = h > _SMALL
    h = jnp.where(high, h, 1.0)
    slope = t @ q + radius * n_z * t_z / h
    curvature = -(n @ q) + radius * ((t_z**2 - n_z**2) / h + (n_z * t_z) ** 2 / h**3)
    curved = high & (curvature < -_SMALL * radius)
    step = -slope / jnp.where(curved, curvature, 1.0)
    near = curved & (jnp.abs(jax.lax.stop_gradient(step)) < _LONG)
    return unit(n + jnp.where(near, step, 0.0) * t, n)
