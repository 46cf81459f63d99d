"""The signed distance of a solid cylinder and a ball, a capsule, a box or a polytope.

The signed distance of two convex solids is the greatest gap between their projections on a direction n,

    d = max over |n| = 1 of  min_j n . v_j - l |n . z| - r sqrt(1 - (n . z)^2),

for a cylinder of radius r and half length l around the axis z, and the corners $v_j$ of the other solid. A search
without derivatives (`cylinder_search.py`) provides the nearest features. For these the distance is a formula; a step of
Newton's method gives the point on an edge or the direction at a rim its derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ...expr import Abs, Expr, Norm
from ...scalar.fast import searched
from ...view import Cylinder
from .cylinder_search import Facets, Feature, facets_of, nearest_feature, reach
from .polytope import root
from .rim import turned, unit
from .solids import Core

#: A step of Newton's method along an edge that is longer is at a kink; so is a curvature below this.
_KINK = 1e-6


def over_plane(cylinder: Cylinder, n: Expr) -> Expr:
    """How far a cylinder reaches along the direction -n from its centre, in its own axes."""
    return 0.5 * float(cylinder.length) * Abs(n[2]) + float(cylinder.radius) * Norm(n[:2])


class CylinderPose(NamedTuple):
    """A cylinder of a radius and half the length `height`, and the pose T (3, 4) or (4, 4) of a core in its frame."""

    radius: Any
    height: Any
    T: jax.Array


def cylinder_to_core(cylinder: Cylinder, core: Core) -> Callable[[Any], jax.Array]:
    """The signed distance () as a function of the pose T (4, 4) of a core in the frame of a cylinder."""
    radius, height = float(cylinder.radius), 0.5 * float(cylinder.length)
    if not len(core.edges):
        return lambda T: _to_point(radius, height, jnp.asarray(T)[:3, 3]) - core.radius
    facets = facets_of(core)
    distance = searched(*cylinder_search(lambda T: CylinderPose(radius, height, T), lambda T: facets))
    return lambda T: distance(T) - core.radius


def cylinder_search(
    placed: Callable[[jax.Array], CylinderPose], facets: Callable[[jax.Array], Facets]
) -> tuple[Callable[[jax.Array], Feature], Callable[[jax.Array, Feature], jax.Array]]:
    """The search of an array x for the nearest features of a cylinder and a core without its radius, and the formula of
    their signed distance ().

    Args:
        placed: of x the sizes of the cylinder and the pose of the core.
        facets: of x the arrays of the core, which has edges.
    """

    def search(x: jax.Array) -> Feature:
        radius, height, T = placed(x)
        return nearest_feature(radius, height, facets(x), T)

    def formula(x: jax.Array, feature: Feature) -> jax.Array:
        radius, height, T = placed(x)
        R, z = T[:3, :3], jnp.asarray([0.0, 0.0, 1.0], T.dtype)
        corner, e = R @ feature.corner + T[:3, 3], R @ feature.edge
        upward = jnp.where(feature.n[2] < 0.0, -1.0, 1.0).astype(T.dtype)
        across = jnp.stack([e[1], -e[0], jnp.zeros_like(e[0])])
        across = across * jnp.where(across @ feature.n < 0.0, -1.0, 1.0)
        directions = [
            -(R @ feature.normal),
            upward * z,
            unit(across, z),
            unit(corner * jnp.asarray([1.0, 1.0, 0.0], T.dtype), z),
            turned(feature.n, e, corner - upward * height * z, z, radius),
        ]
        n = feature.kind[1:] @ jnp.stack(directions)
        gap = n @ corner - reach(radius, height, n[None])[0]
        return jnp.where(feature.kind[0] > 0.5, _along(radius, height, corner, e), gap)

    return search, formula


def _along(radius: Any, height: Any, point: jax.Array, axis: jax.Array) -> jax.Array:
    """The signed distance of the nearest point of an edge along `axis`; a step of Newton's method gives the point its
    derivatives.
    """

    def to(s: jax.Array, point: jax.Array, axis: jax.Array) -> jax.Array:
        return _to_point(radius, height, point + s * axis)

    slope, s = jax.grad(to), jnp.zeros_like(point[0])
    curvature = jax.grad(slope)(s, *jax.lax.stop_gradient((point, axis)))
    curved = curvature > _KINK
    step = slope(s, point, axis) / jnp.where(curved, curvature, 1.0)
    smooth = curved & (jnp.abs(jax.lax.stop_gradient(step)) < _KINK)
    return to(jnp.where(smooth, -step, 0.0), point, axis)


def _to_point(radius: Any, height: Any, p: jax.Array) -> jax.Array:
    """The signed distance of a point (3,), in the frame of the cylinder."""
    across = root(p[0] ** 2 + p[1] ** 2) - radius
    up = jnp.abs(p[2]) - height
    outside = root(jnp.maximum(across, 0.0) ** 2 + jnp.maximum(up, 0.0) ** 2)
    return outside + jnp.minimum(jnp.maximum(across, up), 0.0)
