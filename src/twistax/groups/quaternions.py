"""Unit quaternions (w, x, y, z), to read, build and repair rotation matrices. R(q) v = q v q*."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from twistax.groups.arrays import (
    Components,
    add,
    compiled,
    cross,
    dot,
    matrix,
    multiply,
    scale,
    turn_rows,
    unpack,
    vector,
)
from twistax.groups.series import exp_coefficients


def _squares(R: Array) -> list[list[Array]]:
    """The symmetric matrix 4 q q^T, whose sixteen entries are sums of entries of R."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = unpack(R)
    wx, wy, wz = zy - yz, xz - zx, yx - xy
    sxy, sxz, syz = yx + xy, xz + zx, zy + yz
    plus, minus = 1.0 + xx, 1.0 - xx
    up, down = yy + zz, yy - zz
    return [
        [plus + up, wx, wy, wz],
        [wx, plus - up, sxy, sxz],
        [wy, sxy, minus + down, syz],
        [wz, sxz, syz, minus - down],
    ]


def unscaled(R: Array) -> Array:
    """A positive multiple of the quaternion of R, the first non-zero component positive.

    Every column of 4 q q^T is a multiple of q; the one with the largest diagonal entry is used, which is at least 1.
    Another product with 4 q q^T turns it towards the dominant eigenvector, the quaternion of the rotation nearest to R,
    so that a drift of size e in R leaves an error of size e^2. A symmetric R keeps w = 0 exactly.
    Sources: Shepperd, Quaternion from rotation matrix (1978); Horn, Closed-form solution of absolute orientation
    using unit quaternions (1987).
    """
    rows = _squares(R)
    square = matrix(rows)
    w, x, y, z = (rows[i][i] for i in range(4))
    upper, lower = jnp.where(w >= x, square[0], square[1]), jnp.where(y >= z, square[2], square[3])
    column = jnp.where(jnp.maximum(w, x) >= jnp.maximum(y, z), upper, lower)
    q = multiply(square, column)
    first = unpack(q)
    leading = first[3]
    for component in first[2::-1]:
        leading = jnp.where(component == 0.0, leading, component)
    return jnp.where(leading < 0.0, -q, q)


@compiled
def from_rotation(R: Array) -> Array:
    """The unit quaternion of the rotation nearest to R, w >= 0; at w = 0 the first non-zero component > 0."""
    q = unscaled(R)
    return q / jnp.sqrt(jnp.sum(q * q))


@compiled
def to_rotation(q: Array) -> Array:
    """The rotation matrix of a quaternion of any nonzero length."""
    q_ = unpack(q)
    return matrix(rotation_rows(q_, 2.0 / (q_[0] * q_[0] + dot(q_[1:], q_[1:]))))


def rotation_rows(q: Components, double: Array | float = 2.0) -> list[list[Array]]:
    """The rows of the rotation matrix of a unit quaternion, or of another quaternion with double = 2 / |q|^2."""
    w, x, y, z = q
    ax, ay, az = double * x, double * y, double * z
    wx, wy, wz, xx, xy, xz = w * ax, w * ay, w * az, x * ax, x * ay, x * az
    yy, yz, zz = y * ay, y * az, z * az
    return turn_rows((wx, wy, wz), (xx, yy, zz, xy, xz, yz))


def rotate(q: Components, v: Components) -> Components:
    """R(q) v for a unit quaternion, by two cross products."""
    twice = scale(2.0, cross(q[1:], v))
    return add(v, scale(q[0], twice), cross(q[1:], twice))


@compiled
def hamilton(p: Array, q: Array) -> Array:
    """The product p q; R(p q) = R(p) R(q)."""
    return vector(product(unpack(p), unpack(q)))


def product(a: Components, b: Components) -> Components:
    """The product a b of two quaternions."""
    u, v = a[1:], b[1:]
    return (a[0] * b[0] - dot(u, v), *add(scale(a[0], v), scale(b[0], u), cross(u, v)))


def rate(q: Components, w: Components) -> Components:
    """q' = q (0, w) / 2 with the body angular velocity w."""
    u = q[1:]
    return scale(0.5, (-dot(u, w), *add(scale(q[0], w), cross(u, w))))


def exp(w: Components) -> Components:
    """(cos(t/2), sin(t/2)/t w) with t = |w|: the unit quaternion of Exp(w), for any number of turns."""
    x = 0.25 * dot(w, w)
    # sin(t/2) / (t/2) and (1 - cos(t/2)) / (t/2)^2.
    first, second, _ = exp_coefficients(x)
    return (1.0 - x * second, *scale(0.5 * first, w))
