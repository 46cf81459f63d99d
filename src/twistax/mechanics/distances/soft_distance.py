"""A smooth distance of two solids, with a bound of its difference from the exact distance.

The distance of two convex solids is the maximum, over unit vectors n, of the gap between their projections on n. Let
$u_i$ be the corners of one solid and $v_j$ those of the other. With soft maxima and minima (logarithms of sums of
exponentials) over the corners, the gap is

    f(n) = -w log sum_j exp(-n . v_j / w) - w log sum_i exp(n . u_i / w),

a concave function of n that is at most w log k below the exact gap, where k is the product of the numbers of corners.
Newton's method on the sphere maximises f, starting from a normal of a face; one more step provides the derivatives of
n.

Source: Nesterov, Smooth minimization of non-smooth functions, Mathematical Programming 103 (2005), section 4.1.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp

from ...checks import number, short
from ...errors import ModelError
from ...expr import Expr
from ...expr.fields import ExprLike
from ...expr.functions.function import Function
from ...expr.lie import Compose, Inverse
from ...view import Box, Capsule, Cylinder, Sphere
from .polytope import ConvexPolytope, core_of, root
from .signed_distance import Solid, placed_pair
from .solids import Core

#: The number of Newton steps; of halvings of the width before them; and of halvings of each step.
_STEPS, _WIDER, _HALVINGS = 20, 5, 6
#: The smallest curvature, relative to the gradient.
_LEAST = 1e-6


def soft_distance(a: Solid, b: Solid, width: float, T_a: ExprLike | None = None, T_b: ExprLike | None = None) -> Expr:
    """A smooth signed distance () of two solids, m, for constraints in optimisation.

    With k the product of the numbers of corners, it is between the `signed_distance` minus $w log k$ and the
    `signed_distance`; for two boxes $k = 64$ and $w log k = 4.2 w$. Outside, it has first and second derivatives
    everywhere, also where the nearest corners, edges and faces change. If the solids overlap, it is lower by more if
    the direction of least depth is not that of a face, and it has a kink where that direction changes.

    Source: Nesterov, Smooth minimization of non-smooth functions, Mathematical Programming 103 (2005), section 4.1.

    Args:
        a, b: `tx.view.Sphere`, `Capsule` or `Box`, or `ConvexPolytope`. A sphere counts as one corner, a capsule as
            two.
        width: w, m. Second derivatives grow with 1 / w.
        T_a, T_b: as for `signed_distance`.
    Raises:
        InputError: a width that is not positive.
        ModelError: a solid of another type; numbers that are not a pose.
        ShapeError: a pose of the wrong shape.

    Example:
        `soft_distance(box, shelf, 0.002, arm.pose("hand")) >= 0.02`
    """
    number("soft_distance: width", width, "a positive number", lambda size: 0.0 < size < math.inf)
    for solid in (a, b):
        if not isinstance(solid, (Sphere, Capsule, Box, ConvexPolytope)):
            raise ModelError(
                f"soft_distance expects a Sphere, Capsule or Box of tx.view or a ConvexPolytope, got {short(solid)}"
            )
    pair, A, B = placed_pair("soft_distance", a, b, T_a, T_b)
    one, two = (core_of(core) for core in (pair.a, pair.b) if not isinstance(core, Cylinder))
    value = functools.partial(_greatest_gap, one, two, float(width))
    return Function(value, (), name="soft_distance")(Compose(Inverse(A), B))


def _greatest_gap(a: Core, b: Core, width: float, T: Any) -> jax.Array:
    """The soft distance for the pose T of the core b in that of a."""
    T = jnp.asarray(T)
    U = jnp.asarray(a.corners, T.dtype)
    V = jnp.asarray(b.corners, T.dtype) @ T[:3, :3].T + T[None, :3, 3]
    fixed = jax.lax.stop_gradient(V)
    n = _first(a, b, U, fixed, width, jax.lax.stop_gradient(T[:3, :3]))
    # If the solids are separate, larger widths, which smooth the edges, lead to the largest gap; if they overlap,
    # larger widths may lead to another direction.
    climbs = [_climb(U, fixed, width, n, wider) for wider in (_WIDER, 0)]
    gaps = [jax.lax.stop_gradient(_gap(U, fixed, width, climbed)) for climbed in climbs]
    n = jnp.where(gaps[0] > gaps[1], climbs[0], climbs[1])
    across, slope, curvature = _slopes(U, fixed, width, n)
    regular = curvature[0, 0] * curvature[1, 1] - curvature[0, 1] ** 2 > (_LEAST * (slope @ n)) ** 2
    curvature = jnp.where(regular, curvature, -jnp.eye(2, dtype=T.dtype))
    step = -_solved(curvature, across.T @ _gradient(U, V, width, n))
    n = n + across @ jnp.where(regular, step, 0.0)
    return _gap(U, V, width, n / jnp.sqrt(n @ n)) - (a.radius + b.radius)


def _first(a: Core, b: Core, U: jax.Array, V: jax.Array, width: float, R: jax.Array) -> jax.Array:
    """The direction with the largest gap, among that between the centres and the normals of faces."""
    between = jnp.mean(V, axis=0) - jnp.mean(U, axis=0)
    size = root(between @ between)
    middle = jnp.where(size > 0.0, between / jnp.where(size > 0.0, size, 1.0), jnp.asarray([0.0, 0.0, 1.0], R.dtype))
    normals = [jnp.asarray(a.normals, R.dtype), -jnp.asarray(b.normals, R.dtype) @ R.T]
    tried = jnp.concatenate([middle[None], *normals])
    return tried[jnp.argmax(jax.vmap(functools.partial(_gap, U, V, width))(tried))]


def _gap(U: jax.Array, V: jax.Array, width: Any, n: jax.Array) -> jax.Array:
    low, high = -(V @ n) / width, (U @ n) / width
    return -width * (jax.nn.logsumexp(low) + jax.nn.logsumexp(high))


def _gradient(U: jax.Array, V: jax.Array, width: Any, n: jax.Array) -> jax.Array:
    return jax.nn.softmax(-(V @ n) / width) @ V - jax.nn.softmax((U @ n) / width) @ U


def _slopes(U: jax.Array, V: jax.Array, width: Any, n: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Two directions (3, 2) perpendicular to n, the gradient (3,) of the gap, and its curvature
    (2, 2) on the sphere.
    """
    axis = jnp.eye(3, dtype=n.dtype)[jnp.argmin(jnp.abs(n))]
    first = jnp.cross(n, axis)
    first = first / jnp.sqrt(first @ first)
    across = jnp.stack([first, jnp.cross(n, first)], axis=1)
    slope = _gradient(U, V, width, n)
    spread = jnp.zeros((2, 2), n.dtype)
    for points, sign in ((V @ across, -1.0), (U @ across, 1.0)):
        weights = jax.nn.softmax(sign * ((V if sign < 0.0 else U) @ n) / width)
        points = points - (weights @ points)[None]
        spread = spread + points.T @ (weights[:, None] * points)
    return across, slope, -spread / width - (slope @ n) * jnp.eye(2, dtype=n.dtype)


def _climb(U: jax.Array, V: jax.Array, width: float, n: jax.Array, wider: int) -> jax.Array:
    """A direction that maximises the gap: steps with decreasing widths, the last of which is the stated one."""

    def step(k: Any, n: jax.Array) -> jax.Array:
        return _climbed(U, V, width * jnp.maximum(2.0 ** (wider - jnp.asarray(k, n.dtype)), 1.0), n)

    return jax.lax.fori_loop(0, _STEPS, step, n)


def _climbed(U: jax.Array, V: jax.Array, width: Any, n: jax.Array) -> jax.Array:
    """A direction with a gap that is not smaller: by a Newton step, or by the best fraction of it."""
    across, slope, curvature = _slopes(U, V, width, n)
    # At large depths the curvature may be positive; it is then replaced by that of a concave function.
    floor = jnp.maximum(-(slope @ n), 0.0) + _LEAST * (width + jnp.sqrt(slope @ slope))
    step = across @ -_solved(curvature - floor * jnp.eye(2, dtype=n.dtype), across.T @ slope)
    sizes = jnp.asarray([0.0, *(0.5**k for k in range(_HALVINGS + 1))], n.dtype)
    tried = n[None] + sizes[:, None] * step[None]
    tried = tried / jnp.sqrt(jnp.sum(tried**2, axis=1))[:, None]
    return tried[jnp.argmax(jax.vmap(functools.partial(_gap, U, V, width))(tried))]


def _solved(A: jax.Array, b: jax.Array) -> jax.Array:
    """A^-1 b for a symmetric A (2, 2)."""
    size = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
    return jnp.stack([A[1, 1] * b[0] - A[0, 1] * b[1], A[0, 0] * b[1] - A[0, 1] * b[0]]) / size
