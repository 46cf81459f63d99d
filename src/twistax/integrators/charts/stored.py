"""Rotations and poses as unit quaternions (and positions) between steps.

A quaternion is put back to length one by one scalar, so that its rotation stays orthonormal to round-off for ever; and
a product of two costs 16 multiplications where one of matrices costs 27.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ...groups import SpecialEuclidean, quaternions
from ...groups.components import Components, dot, matrix, scale, unpack
from .coordinates import Coordinates

__all__ = ["StoredPose", "StoredRotation", "tightened", "unit"]


def tightened(q: Components) -> Components:
    """A quaternion whose length is off by round-off, put back to one: one Newton step."""
    return scale(1.5 - 0.5 * dot_four(q), q)


def unit(q: Components) -> Components:
    """A quaternion of any length but zero, put to length one; not a number where its square overflows."""
    square = dot_four(q)
    return scale(jnp.where(jnp.isfinite(square), jax.lax.rsqrt(square), jnp.nan), q)


def dot_four(q: Components) -> jax.Array:
    """|q|^2."""
    return q[0] * q[0] + dot(q[1:], q[1:])


class StoredRotation(Coordinates):
    """(q,): a rotation as a quaternion."""

    def enter(self, g: jax.Array) -> Components:
        return unpack(quaternions.from_rotation(g))

    def value(self, y: Components) -> jax.Array:
        return matrix(quaternions.rotation_rows(y))

    def rate(self, omega: jax.Array) -> Components:
        return unpack(omega)

    def sizes(self, before: Components, after: Components) -> Components:
        return _radians(after)


class StoredPose(Coordinates):
    """(q, p): a pose as a quaternion and a position; rates as [v; w] whatever their order."""

    def __init__(self, group: SpecialEuclidean) -> None:
        self.order = group.order

    def enter(self, g: jax.Array) -> Components:
        return (*unpack(quaternions.from_rotation(g[:3, :3])), *unpack(g[:3, 3]))

    def value(self, y: Components) -> jax.Array:
        rows = [[*row, p] for row, p in zip(quaternions.rotation_rows(y[:4]), y[4:], strict=True)]
        zero = jnp.zeros_like(y[0])
        return matrix([*rows, [zero, zero, zero, zero + 1.0]])

    def rate(self, omega: jax.Array) -> Components:
        return unpack(self.order.to_linear_first(omega))

    def sizes(self, before: Components, after: Components) -> Components:
        length = jnp.sqrt(jnp.maximum(dot(before[4:], before[4:]), dot(after[4:], after[4:])))
        return (length, length, length, *_radians(after))


def _radians(y: Components) -> Components:
    one = jnp.ones_like(y[0])
    return (one, one, one)
