"""The nearest points of two solids (witness points).

Let the second solid make a small motion, a translation v and a rotation w about the origin of the first one. The
distance d of convex solids changes by n . v + m . w, where n is the normal from the first solid to the second, and m =
p x n for a witness point p on either. So n and m follow from the gradient of d. The component of p along n is the
support function of the first solid: $p_a = n \\times m + h_a(n) n$ and $p_b = p_a + d n$.

If faces or edges are parallel, several planes are tangent to both solids, and p may be beyond the end of a face. Then
alternating projections move p to a point that is on both solids if they are moved along n until they touch.

Source: Bauschke, Borwein, On projection algorithms for solving convex feasibility problems, SIAM Review 38 (1996).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ...expr import Expr
from ...expr.fields import ExprLike
from ...expr.functions.function import Function
from ...expr.lie import Act, Compose, Inverse
from ...scalar.fast import searched
from ...view import Cylinder
from .distance_grid import DistanceGrid
from .gjk import at, place_of
from .polytope import ConvexPolytope, root
from .signed_distance import Pair, Solid, placed_pair
from .solids import HalfSpace

#: The accuracy of the projections, in units of rounding, and the most of them.
_ROUNDING, _MOST = 64.0, 200


@dataclasses.dataclass(frozen=True)
class WitnessPoints:
    """The nearest points of two solids, as expressions. Made by `witness_points`.

    They satisfy $p_b = p_a + d n$ with the distance d and the normal n. Where the solids overlap, moving the second one
    by $-d n$ makes them touch.

    Attributes:
        on_a, on_b: points (3,), m, on the first and on the second solid, in the frame of the poses.
        normal: (3,), of unit length, from the first to the second solid.
        distance: (), m, the signed distance.
    """

    on_a: Expr
    on_b: Expr
    normal: Expr
    distance: Expr


def witness_points(a: Solid, b: Solid, T_a: ExprLike | None = None, T_b: ExprLike | None = None) -> WitnessPoints:
    r"""The nearest points of two solids and the normal between them, with derivatives.

    With the gradient of the signed distance with respect to translations of b, n, and to rotations, m, the points are
    $p_a = n \times m + h_a(n)\, n$ and $p_b = p_a + d n$, where $h_a$ is the support function of a. If several pairs of
    points are nearest, as for parallel faces, the result is one of these pairs. Derivatives are
    exact away from changes of the nearest features. Points and normal are not determined where a point or a segment
    meets the core of the other solid, such as the centres of two spheres: there the normal may be zero, but nothing is
    NaN.

    Source: Boyd, Vandenberghe, Convex Optimization (2004), section 8.2.2 (separating hyperplanes and support
    functions).

    Args:
        a, b, T_a, T_b: as for `signed_distance`.
    Raises: the errors of `signed_distance`.

    Example:
        >>> import twistax as tx
        >>> from twistax.mechanics import witness_points
        >>> near = witness_points(tx.view.Sphere(0.1), tx.view.Box((1.0, 1.0, 1.0), at=(0.0, 0.0, 2.0)))
        >>> tx.lower(near.on_b)(0.0, {})
        Array([0. , 0. , 1.5], dtype=float64)
    """
    pair, A, B = placed_pair("witness_points", a, b, T_a, T_b)
    T = Compose(Inverse(A), B)
    rows = Function(_points_of(pair), (10,), name="witness_points")(T)
    on_a, on_b, normal = Act(A, rows[:3]), Act(A, rows[3:6]), A[:3, :3] @ rows[6:9]
    if pair.swapped:
        on_a, on_b, normal = on_b, on_a, -normal
    return WitnessPoints(on_a, on_b, normal, rows[9])


def _points_of(pair: Pair) -> Callable[[Any], Any]:
    """The function from the pose of b in a to both points, the normal and the distance (10,), in the frame of a."""
    value_and_slope = jax.value_and_grad(pair.of_arrays())
    on_both = None if isinstance(pair.b, (HalfSpace, DistanceGrid)) else searched(_on_both(pair), jnp.add)

    def points(T: jax.Array) -> jax.Array:
        d, G = value_and_slope(T)
        size = root(jnp.sum(G[:3, 3] ** 2))
        G = G / jnp.where(size > 0.0, size, 1.0)
        n = G[:3, 3]
        m = jnp.sum(jnp.cross(T[:3, :].T, G[:3, :].T), axis=0)
        p = jnp.cross(n, m) + _support(pair.a, n) * n
        if on_both is not None:
            p = on_both(jnp.concatenate([T[:3].ravel(), p, n, d[None]]))[12:15]
        return jnp.concatenate([p, p + d * n, n, d[None]])

    return points


def _on_both(pair: Pair) -> Callable[[jax.Array], jax.Array]:
    """The function from the pose T (3, 4), p, n and d (19,) to the change of p (in an array of the same shape) to a
    point of both cores, if b is moved along n until they touch.

    A point of both does not change. From others, alternating projections onto convex sets lead to one.
    """
    (to_a, of_a), (to_b, of_b) = _onto(pair.a), _onto(pair.b)

    def search(x: jax.Array) -> jax.Array:
        T, p, n, d = x[:12].reshape(3, 4), x[12:15], x[15:18], x[18]
        R, start = T[:, :3], p - of_a * n
        origin = T[:, 3] - (d + of_a + of_b) * n
        exact = _ROUNDING * jnp.finfo(x.dtype).eps * (jnp.max(jnp.abs(origin)) + jnp.max(jnp.abs(p)))

        def step(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
            before, _, count = state
            on_a = to_a(before)
            on_b = R @ to_b((on_a - origin) @ R) + origin
            off = jnp.maximum(jnp.max(jnp.abs(on_a - before)), jnp.max(jnp.abs(on_b - on_a)))
            return on_b, off, count + 1

        end = jax.lax.while_loop(
            lambda state: (state[1] > exact) & (state[2] < _MOST), step, (start, exact + 1.0, jnp.asarray(0))
        )
        return jnp.zeros_like(x).at[12:15].set(end[0] - start)

    return search


def _onto(solid: Any) -> tuple[Callable[[jax.Array], jax.Array], float]:
    """A projection onto the core of a solid, of a polytope onto one violated face, and the radius around the core."""
    if isinstance(solid, Cylinder):
        end = 0.5 * solid.length

        def onto(x: jax.Array) -> jax.Array:
            flat = root(x[0] ** 2 + x[1] ** 2)
            scale = jnp.where(flat > solid.radius, solid.radius / jnp.where(flat > 0.0, flat, 1.0), 1.0)
            return jnp.stack([scale * x[0], scale * x[1], jnp.clip(x[2], -end, end)])

        return onto, 0.0
    if isinstance(solid, ConvexPolytope):
        normals, offsets = solid.core.normals, solid.core.offsets

        def below(x: jax.Array) -> jax.Array:
            n, o = jnp.asarray(normals, x.dtype), jnp.asarray(offsets, x.dtype)
            heights = n @ x - o
            return x - jnp.maximum(jnp.max(heights), 0.0) * at(n, place_of(heights == jnp.max(heights)))

        return below, solid.radius
    return lambda x: jnp.clip(x, -jnp.asarray(solid.half, x.dtype), jnp.asarray(solid.half, x.dtype)), solid.radius


def _support(solid: Any, n: jax.Array) -> jax.Array:
    """The support function of a solid, the largest n . p, in its frame."""
    if isinstance(solid, Cylinder):
        return 0.5 * solid.length * jnp.abs(n[2]) + solid.radius * root(n[0] ** 2 + n[1] ** 2)
    if isinstance(solid, ConvexPolytope):
        return jnp.max(jnp.asarray(solid.core.corners, n.dtype) @ n) + solid.radius
    return jnp.sum(jnp.asarray(solid.half, n.dtype) * jnp.abs(n)) + solid.radius
