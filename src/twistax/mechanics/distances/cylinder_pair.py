"""The signed distance of two solid cylinders.

It is the greatest gap over unit vectors n, outside and inside,

    n . p - l_1 |n . z_1| - r_1 |n x z_1| - l_2 |n . z_2| - r_2 |n x z_2|,

for the centres p apart, the axes z, the radii r and the half lengths l. The gap is greatest in one of these directions:
both axes, their product, the directions across one axis in which a side touches a rim (`rim.py`), or the normal of two
rims at their nearest points. For these the square of the distance from a point of the smaller rim to the circle of the
other one is a function of one angle, whose least values are searched in 32 intervals.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...scalar.fast import searched
from ...view import Cylinder
from .cylinder_search import best_of, reach
from .polytope import root
from .rim import RimIntervals, rim_intervals, rim_normal, sign_change, turned, unit

#: Intervals of a rim.
_INTERVALS = 32
#: Of sines and curvatures that count as zero, and the longest step of Newton's method.
_SMALL, _LONG = 1e-9, 1e-3
#: The kinds of directions: along the first or the second axis, along their product, where the side of the first touches
#: a rim of the second or the reverse, where two rims are nearest.
_FIRST, _SECOND, _PRODUCT, _SIDE, _REVERSE, _RIMS = range(6)


class _Direction(NamedTuple):
    gap: jax.Array
    n: jax.Array
    kind: jax.Array


_Search: TypeAlias = tuple[Callable[[jax.Array], _Direction], Callable[[jax.Array, _Direction], jax.Array]]


@dataclasses.dataclass(frozen=True)
class _Cylinders:
    """Two cylinders, the first one in its frame, with radii r and s and half lengths h and k; the second one has the
    axis y and the centre p.
    """

    r: Any
    s: Any
    h: Any
    k: Any
    z: jax.Array
    y: jax.Array
    p: jax.Array

    def gap(self, n: jax.Array) -> jax.Array:
        """The gaps (k,) along directions n (k, 3)."""
        across = jnp.cross(n, jnp.broadcast_to(self.y[None], n.shape))
        of_second = self.k * jnp.abs(n @ self.y) + self.s * root(jnp.sum(across**2, axis=1))
        return n @ self.p - reach(self.r, self.h, n) - of_second

    def direction(self, n: jax.Array, kind: int) -> _Direction:
        return _Direction(self.gap(n[None])[0], n, jnp.asarray(kind))

    @property
    def product(self) -> jax.Array:
        return unit(jnp.cross(self.z, self.y), self.z)


def cylinder_to_cylinder(a: Cylinder, b: Cylinder) -> Callable[[Any], jax.Array]:
    """The signed distance () as a function of the pose T (4, 4) of b in the frame of a, whose radius is not larger."""
    sizes = float(a.radius), float(b.radius), 0.5 * float(a.length), 0.5 * float(b.length)
    return searched(*_search(lambda T: (sizes, T)))


def search_of_cylinders() -> _Search:
    """The search for the direction of the greatest gap of two cylinders, and the formula of their signed distance (),
    of x: the first three rows of the pose of the second one in the frame of the first, both radii, of which the first
    is not larger, and both half lengths.
    """
    return _search(lambda x: (x[12:16], x[:12].reshape(3, 4)))


def _search(sizes_and_pose: Callable[[jax.Array], tuple[Any, jax.Array]]) -> _Search:
    def placed(x: jax.Array) -> _Cylinders:
        (r, s, h, k), T = sizes_and_pose(x)
        return _Cylinders(r, s, h, k, jnp.asarray([0.0, 0.0, 1.0], x.dtype), T[:3, 2], T[:3, 3])

    def formula(x: jax.Array, best: _Direction) -> jax.Array:
        pair, near, kind = placed(x), best.n, best.kind
        y, z, p = pair.y, pair.z, pair.p
        up, second_sign = (jnp.where(axis @ near < 0.0, -1.0, 1.0) for axis in (z, jax.lax.stop_gradient(y)))
        of_first, of_second = p - up * pair.h * z, p - second_sign * pair.k * y
        corner = of_first - second_sign * pair.k * y
        product = pair.product
        directions = [
            up * z,
            second_sign * y,
            product * jnp.where(product @ near < 0.0, -1.0, 1.0),
            turned(near, z, of_second, y, pair.s),
            turned(near, y, of_first, z, pair.r),
            _climbed(near, corner, ((pair.r, z), (pair.s, y))),
        ]
        weights = (jnp.arange(len(directions)) == kind).astype(near.dtype)
        return pair.gap((weights @ jnp.stack(directions))[None])[0]

    return lambda x: _best(placed(x)), formula


def _best(pair: _Cylinders) -> _Direction:
    """The direction with the greatest gap."""
    z, y, across = pair.z, pair.y, pair.product
    directions = [(z, _FIRST), (-z, _FIRST), (y, _SECOND), (-y, _SECOND), (across, _PRODUCT), (-across, _PRODUCT)]
    best: _Direction = best_of([pair.direction(n, kind) for n, kind in directions], jnp.greater)
    best = _at_side(pair, best, _SIDE)
    best = _at_side(pair, best, _REVERSE)
    corners = [(i, j) for i in (-1.0, 1.0) for j in (-1.0, 1.0)]
    q = jnp.stack([pair.p - i * pair.h * z - j * pair.k * y for i, j in corners])

    def corner(best: _Direction, q: jax.Array) -> tuple[_Direction, None]:
        return _at_rims(pair, q, best), None

    result: _Direction = jax.lax.scan(corner, best, q)[0]
    return result


def _at_side(pair: _Cylinders, best: _Direction, kind: int) -> _Direction:
    """The better of a direction and those in which the side of one cylinder touches the rims of the other one."""
    if kind == _SIDE:
        e, axis, radius, half, centre = pair.z, pair.y, pair.s, pair.k, -pair.p
    else:
        e, axis, radius, half, centre = pair.y, pair.z, pair.r, pair.h, pair.p
    for sign in (-1.0, 1.0):
        intervals = rim_intervals((centre - sign * half * axis)[None], e[None], None, sign * axis, radius)

        def searched(best: _Direction, intervals: RimIntervals) -> _Direction:
            n = rim_normal(jax.tree.map(lambda a: a[0], intervals))
            return best_of([best, pair.direction(-n if kind == _SIDE else n, kind)], jnp.greater)

        def kept(best: _Direction, intervals: RimIntervals) -> _Direction:
            return best

        best = jax.lax.cond(intervals.inside[0], searched, kept, best, intervals)
    return best


def _at_rims(pair: _Cylinders, q: jax.Array, best: _Direction) -> _Direction:
    """The better of a direction and the normals at points of two rims whose distance is least.

    The first rim has the radius r around z, the second one the radius s around y, with its centre at q (3,).
    """
    r, s, y = pair.r, pair.s, pair.y
    angles = np.linspace(0.0, 2.0 * np.pi, _INTERVALS + 1)
    circle = jnp.asarray(np.stack([np.cos(angles), np.sin(angles)], axis=1), q.dtype)

    def at(c: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Points (k, 3) of the first rim and its tangents, from (k, 2) cosines and sines; the directions (k, 3) to them
        from the centre of the second rim.
        """
        zero = jnp.zeros_like(c[:, 0])
        x, tangent = jnp.stack([r * c[:, 0], r * c[:, 1], zero], axis=1), jnp.stack([-c[:, 1], c[:, 0], zero], axis=1)
        w = x - q[None]
        return x, tangent, unit(w - (w @ y)[:, None] * y[None], y)

    def slope(c: jax.Array) -> jax.Array:
        x, tangent, u = at(c)
        return jnp.sum((x - q[None] - s * u) * tangent, axis=1)

    slopes = slope(circle)

    def interval(best: _Direction, ends: Any) -> tuple[_Direction, None]:
        low, high, before, after = ends

        def searched() -> _Direction:
            def point(t: jax.Array) -> jax.Array:
                c = low + t * (high - low)
                return (c / jnp.sqrt(c @ c))[None]

            zero = jnp.zeros_like(before)
            x, tangent, u = at(point(sign_change(lambda t: slope(point(t))[0], zero, zero + 1.0)))
            between = unit(q + s * u[0] - x[0], y)  # ill-conditioned at contact, where the product of tangents is not
            product = unit(jnp.cross(tangent[0], jnp.cross(y, u[0])), y)
            candidates = [pair.direction(n, _RIMS) for n in (between, -between, product, -product)]
            return best_of([best, *candidates], jnp.greater)

        return jax.lax.cond((before <= 0.0) & (after >= 0.0), searched, lambda: best), None

    result: _Direction = jax.lax.scan(interval, best, (circle[:-1], circle[1:], slopes[:-1], slopes[1:]))[0]
    return result


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
