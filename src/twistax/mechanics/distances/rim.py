r"""The directions in which an edge touches the rim of a disc.

Across an edge e the rim, of radius r around the axis z, is an ellipse with the half axes r and $r |e \cdot z|$. The gap
of the edge and the rim along a unit vector n across e,

    f(n) = n . q - r sqrt(1 - (n . z)^2),

is the signed distance from q to a tangent of the ellipse. Each nearest point of an ellipse is in the quadrant of q or
in its mirror image across the major axis. With the half axes 1 and b and the angle t of n from the major axis, the
slope of f changes its sign from plus to minus once in the first quadrant, and at most once in the second one beyond
$\tan t = (b q_2 / q_1)^{1/3} / b$. So bisection finds all greatest f.

Source: D. Eberly, Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid, section 2 (2013).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from .polytope import root

#: Halvings of a quadrant: half of the digits, which a step of Newton's method doubles.
_HALVINGS = 32
#: Of sines and curvatures that count as zero, and the longest step of Newton's method.
_SMALL, _LONG = 1e-9, 1e-3


def unit(vectors: jax.Array, otherwise: jax.Array) -> jax.Array:
    """Vectors (..., 3) of unit length; those of a length below 1e-9 are replaced."""
    square = jnp.sum(vectors**2, axis=-1, keepdims=True)
    long = square > _SMALL**2
    otherwise = jnp.broadcast_to(otherwise, vectors.shape)
    return jnp.where(long, vectors / jnp.sqrt(jnp.where(long, square, 1.0)), otherwise)


def rim_normals(q: jax.Array, e: jax.Array, z: jax.Array, radius: jax.Array) -> jax.Array:
    """The unit vectors (k, 2, 3) across edges e (k, 3) in which f is greatest among its neighbours."""
    # u is along the major axis; across an edge parallel to z the ellipse is a circle, and any axis is one.
    other = jnp.eye(3, dtype=e.dtype)[jnp.argmin(jnp.abs(e), axis=1)]
    u = unit(jnp.cross(e, z), unit(jnp.cross(e, other), e))
    w = jnp.cross(e, u)
    b = jnp.abs(jnp.sum(e * z, axis=1))
    q_u, q_w = jnp.sum(q * u, axis=1) / radius, jnp.sum(q * w, axis=1) / radius
    image = jnp.asarray([[False, True]])  # in the mirror image of the quadrant of q
    major, minor = jnp.abs(q_u)[:, None], jnp.where(image, -jnp.abs(q_w)[:, None], jnp.abs(q_w)[:, None])
    b = b[:, None]
    least = jnp.arctan2(jnp.cbrt(b * jnp.abs(minor)), b * jnp.cbrt(major))

    def halve(_: Any, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = ends
        t = 0.5 * (low + high)
        c, s = jnp.cos(t), jnp.sin(t)
        rises = minor * c - major * s + (1.0 - b * b) * s * c / jnp.sqrt(c * c + b * b * s * s) > 0.0
        return jnp.where(rises, t, low), jnp.where(rises, high, t)

    low = jnp.where(image, least, 0.0)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (low, jnp.full_like(low, 0.5 * jnp.pi)))
    t = 0.5 * (low + high)
    sign_u, sign_w = jnp.where(q_u < 0.0, -1.0, 1.0)[:, None], jnp.where(q_w < 0.0, -1.0, 1.0)[:, None]
    mirrored = jnp.where(image, -sign_w, sign_w)
    return (sign_u * jnp.cos(t))[..., None] * u[:, None] + (mirrored * jnp.sin(t))[..., None] * w[:, None]


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
