"""Charts: the coordinates of rotations and poses around the start of a step."""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from math import pi
from typing import Any

import jax
import jax.numpy as jnp

from ...checks import instance
from ...errors import ModelError
from ...groups import Group, Order, Product, SpecialEuclidean, quaternions
from ...groups.arrays import Components, add, dot, matrix, pose_rate, rotation_rate, scale, swept, unpack, vector
from ...groups.series import inverse_coefficients, inverse_polynomial, stumpff, stumpff_polynomial
from ...scalar.small_call import stored_once
from .coordinates import Compensated, Coordinates, FlatCoordinates, GroupCoordinates, StateCoordinates

__all__ = ["Ambient", "Chart", "Coordinates", "Exponential", "SplitExponential"]

# ---- rotations and poses: unit quaternions (and positions) between steps ----------------------------------------- One
# scalar normalises a quaternion, so that its rotation stays orthonormal to round-off; a product of two quaternions
# costs 16 multiplications, one of matrices 27.


def conjugate(q: Components) -> Components:
    """The unit quaternion of the inverse rotation."""
    return (q[0], *scale(-1.0, q[1:]))


def tightened(q: Components) -> Components:
    """A quaternion whose length is close to one, normalised by one Newton step."""
    return scale(1.5 - 0.5 * _square(q), q)


def _square(q: Components) -> jax.Array:
    return q[0] * q[0] + dot(q[1:], q[1:])


class _Stored(Coordinates):
    """A rotation as its quaternion, a pose as (quaternion, position); rates as w, of poses as [v; w].

    A rotation is treated as a pose with the position (), so one implementation serves both.
    """

    def __init__(self, group: SpecialEuclidean | None) -> None:
        self.order: Order | None = None if group is None else group.order
        self.numbers = 4 if group is None else 7

    def enter(self, g: jax.Array) -> Components:
        if self.order is None:
            return unpack(quaternions.from_rotation(g))
        return (*unpack(quaternions.from_rotation(g[:3, :3])), *unpack(g[:3, 3]))

    def value(self, y: Components) -> jax.Array:
        rows = quaternions.rotation_rows(y[:4])
        if self.order is None:
            return matrix(rows)
        zero = jnp.zeros_like(y[0])
        return matrix([*([*row, p] for row, p in zip(rows, y[4:], strict=True)), [zero, zero, zero, zero + 1.0]])

    def rate(self, omega: jax.Array) -> Components:
        return unpack(omega if self.order is None or self.order.linear_leads else self.order.to_linear_first(omega))

    def velocity(self, omega: Components) -> jax.Array:
        velocity = vector(omega)
        return velocity if self.order is None or self.order.linear_leads else self.order.from_linear_first(velocity)

    def sizes(self, before: Components, after: Components) -> Components:
        one = jnp.ones_like(after[0])
        if self.order is None:
            return (one, one, one)
        length = jnp.sqrt(jnp.maximum(dot(before[4:], before[4:]), dot(after[4:], after[4:])))
        return (length, length, length, one, one, one)

    def settle(self, moved: Components) -> Components:
        return (*tightened(moved[:4]), *moved[4:])

    def settling(self, moved: Components) -> Components:
        q, still = moved[:4], tuple(map(jnp.zeros_like, moved[4:]))
        return (*scale(0.5 - 0.5 * _square(q), q), *still)


def _in_world(q: Components, v: Components) -> Components:
    """R(q) v of a velocity; empty for a rotation."""
    return quaternions.rotate(q, v) if v else ()


class _Plain(_Stored):
    def first_slope(self, y: Components, omega: Components) -> Components:
        return (*quaternions.rate(y[:4], omega[-3:]), *_in_world(y[:4], omega[:-3]))

    def deviation(self, e: Components, after: Components) -> Components:
        # The rotation vector of a small difference e of quaternions near q is 2 Im(q^-1 e).
        return (*e[4:], *scale(2.0, quaternions.product(conjugate(after[:4]), e[:4])[1:]))

    def settle(self, moved: Components) -> Components:
        return (*scale(self._to_one(moved), moved[:4]), *moved[4:])

    def settling(self, moved: Components) -> Components:
        still = tuple(map(jnp.zeros_like, moved[4:]))
        return (*scale(self._to_one(moved) - 1.0, moved[:4]), *still)

    @staticmethod
    def _to_one(moved: Components) -> jax.Array:
        """The factor that normalises the quaternion; NaN where its square overflows."""
        square = _square(moved[:4])
        return jnp.where(jnp.isfinite(square), jax.lax.rsqrt(square), jnp.nan)


class _Split(_Stored):
    """z = [position; rotation vector]: the pose (R_0 Exp(z_w), p_0 + z_p), so that z_p' = R v; of a rotation Exp."""

    def __init__(self, maps: _Maps, group: SpecialEuclidean | None = None) -> None:
        super().__init__(group)
        self.maps = maps

    def move(self, y: Components, z: Components) -> Components:
        w = z[-3:]
        return (*_turned(y[:4], w, *stored_once(self.maps.half_turn(dot(w, w)))), *add(y[4:], z[:-3]))

    def shift(self, y: Components, z: Components) -> Components:
        w = z[-3:]
        return (*_turning(y[:4], w, *stored_once(self.maps.half_turn(dot(w, w)))), *z[:-3])

    def slope(self, z: Components, moved: Components, omega: Components) -> Components:
        w = z[-3:]
        turn = rotation_rate(w, omega[-3:], self.maps.inverse(dot(w, w))[0])
        return (*_in_world(moved[:4], omega[:-3]), *turn)

    def first_slope(self, y: Components, omega: Components) -> Components:
        return (*_in_world(y[:4], omega[:-3]), *omega[-3:])

    def tangent(self, z: Components) -> jax.Array:
        return vector(z) if self.order is None else super().tangent(z)


class _Pose(_Stored):
    """z = [v; w], the pose g_0 Exp(z)."""

    def __init__(self, maps: _Maps, group: SpecialEuclidean) -> None:
        super().__init__(group)
        self.maps, self.group = maps, group

    def move(self, y: Components, z: Components) -> Components:
        cosine, sine, shift = self._turn_and_shift(y, z)
        return (*_turned(y[:4], z[3:], cosine, sine), *add(y[4:], shift))

    def shift(self, y: Components, z: Components) -> Components:
        cosine, sine, shift = self._turn_and_shift(y, z)
        return (*_turning(y[:4], z[3:], cosine, sine), *shift)

    def _turn_and_shift(self, y: Components, z: Components) -> tuple[jax.Array, jax.Array, Components]:
        """cos(t/2), sin(t/2)/t, and the displacement of the position."""
        v, w = z[:3], z[3:]
        x = dot(w, w)
        cosine, sine, third = stored_once((*self.maps.half_turn(x), self.maps.third(x)))
        # (1 - cos t)/t^2 = 2 (sin(t/2)/t)^2, which reuses the sine of the quaternion.
        shift = stored_once(swept(w, v, 2.0 * sine * sine, third))
        return cosine, sine, quaternions.rotate(y[:4], shift)

    def slope(self, z: Components, moved: Components, omega: Components) -> Components:
        return pose_rate(z, omega, *self.maps.inverse(dot(z[3:], z[3:])))

    def tangent(self, z: Components) -> jax.Array:
        return self.group.order.from_linear_first(vector(z))


def _turned(q: Components, w: Components, cosine: jax.Array, sine: jax.Array) -> Components:
    """The quaternion of R(q) Exp(w), from cos(t/2) and sin(t/2)/t."""
    return quaternions.product(q, (cosine, *scale(sine, w)))


def _turning(q: Components, w: Components, cosine: jax.Array, sine: jax.Array) -> Components:
    """The change of the quaternion, to round-off of its own size: cos(t/2) - 1 = -sin(t/2)^2 / (1 + cos(t/2))."""
    near = cosine > 0.0
    less = jnp.where(near, -sine * sine * dot(w, w) / jnp.where(near, 1.0 + cosine, 1.0), cosine - 1.0)
    return quaternions.product(q, (less, *scale(sine, w)))


@dataclasses.dataclass(frozen=True)
class _Maps:
    """The scalar functions of x = |w|^2 in Exp and in the inverse right Jacobian.

    Closed forms with a series near zero; NaN beyond a full turn, where J_r is singular. With a number of commutators
    they are polynomials: Exp is exact to round-off up to a half turn, and NaN beyond it.
    """

    commutators: int | None

    def _stumpff(self, k: int, x: jax.Array, turn: float) -> jax.Array:
        """The Stumpff function of order k of x, equal to `turn` at the end of the polynomial's range."""
        return stumpff(k, x) if self.commutators is None else stumpff_polynomial(k, x, turn)

    def half_turn(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """cos(t/2) and sin(t/2)/t: the quaternion of Exp(w) is (cos(t/2), sin(t/2)/t w)."""
        quarter, limit = 0.25 * x, 0.25 * pi**2
        cosine, sine = (self._stumpff(k, quarter, limit) for k in (0, 1))
        return jnp.where(x < (4.0 * pi**2 if self.commutators is None else pi**2), cosine, jnp.nan), 0.5 * sine

    def third(self, x: jax.Array) -> jax.Array:
        """(t - sin t)/t^3."""
        return self._stumpff(3, x, pi**2)

    def inverse(self, x: jax.Array) -> tuple[jax.Array | float, jax.Array | float]:
        """d and d' with J_r^-1 = I + W/2 + d W^2."""
        if self.commutators is None:
            return stored_once(inverse_coefficients(x))
        terms = self.commutators // 2
        coefficients = inverse_polynomial(0, x, terms), inverse_polynomial(1, x, terms)
        return stored_once(coefficients) if terms > 2 else (stored_once(coefficients[0]), coefficients[1])


class Chart(ABC):
    """The coordinates of a step around its start. Charts with equal fields are equal.

    To define a chart, subclass it and define coordinates for rotations and poses. Increments are added to states
    without a group; states on other groups use exponential coordinates.
    """

    def coordinates(self, group: Group) -> Coordinates:
        """The coordinates for one part of the state; exponential ones for groups that are neither SO(3) nor SE(3)."""
        if group.flat:
            return FlatCoordinates(group)
        if not group.rigid:
            return GroupCoordinates(group)
        pose: Any = group
        return self.for_rotation() if group.dimension == 3 else self.for_pose(pose)

    @abstractmethod
    def for_rotation(self) -> Coordinates:
        """Coordinates around a rotation."""

    @abstractmethod
    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        """Coordinates around a pose whose twists have the order of `group`."""


@dataclasses.dataclass(frozen=True)
class Ambient(Chart):
    """Quaternion and position as plain numbers, $q' = q (0, w) / 2$, $p' = R(q) v$; q is normalised once in each step.

    It is the cheapest chart, and as accurate as the others for non-stiff problems. Within a step the quaternion
    deviates from the unit sphere by the error of the stages. Rotations within a step are not limited: the error of a
    long step is that of the tableau.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section IV.4 (projection methods).
    """

    def for_rotation(self) -> Coordinates:
        return _Plain(None)

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _Plain(group)


@dataclasses.dataclass(frozen=True)
class Exponential(Chart):
    """Exponential coordinates: $g = g_0 Exp(eta)$ with $eta' = J_r(eta)^-1 Omega$, on SO(3) and on SE(3).

    Attributes:
        commutators: the number of powers of ad in $J_r(eta)^-1 = I + ad/2 + ad^2/12 - ad^4/720 + ...$. All operations
            are then polynomials, and a step that rotates by more than half a turn fails. With None they are closed
            forms, and a step that rotates by more than a full turn fails.
    A method of order p needs p - 2 commutators; `RKMK` without a chart uses this number.

    Raises:
        ModelError: `commutators` is not a positive whole number.

    Source: Munthe-Kaas, High order Runge-Kutta methods on manifolds (1999); Hairer, Lubich, Wanner, Geometric Numerical
    Integration (2006), section IV.8, for the number of terms.
    """

    commutators: int | None = None

    def __post_init__(self) -> None:
        if self.commutators is not None and (not isinstance(self.commutators, int) or self.commutators < 1):
            raise ModelError(
                f"commutators must be a positive whole number, or None for the closed form, got {self.commutators!r}"
            )

    def for_rotation(self) -> Coordinates:
        return _Split(_Maps(self.commutators))

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _Pose(_Maps(self.commutators), group)


@dataclasses.dataclass(frozen=True)
class SplitExponential(Exponential):
    """Exponential coordinates of the rotation; increments are added to the position: $SO(3) x R^3$ in place of SE(3).

    Attributes and errors as for `Exponential`.
    """

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _Split(_Maps(self.commutators), group)


def chart_of(owner: str, chart: Any, default: Chart) -> Chart:
    """The chart of a method, or the default one. Raises ModelError for an object that is not a chart."""
    if chart is None:
        return default
    instance(owner, chart, Chart, "a chart like tx.charts.Exponential()", ModelError)
    return chart


@functools.lru_cache(maxsize=256)
def coordinates_of(chart: Chart, group: Product) -> StateCoordinates:
    """The coordinates of a state in a chart; the same object for equal arguments."""
    return StateCoordinates({name: chart.coordinates(factor) for name, factor in group.factors.items()})


@functools.lru_cache(maxsize=256)
def compensated(chart: Chart, group: Product) -> StateCoordinates:
    """The coordinates of a state in a chart, with compensated summation over successive steps; the same object for
    equal arguments.

    States on groups without formulas in the chart use the exponential map of the group.
    """
    parts: dict[str, Any] = {}
    for name, part in coordinates_of(chart, group).parts.items():
        count = part.numbers
        parts[name] = part if count is None else Compensated(part, count)
    return StateCoordinates(parts)
