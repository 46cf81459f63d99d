"""Exponential coordinates: g = g_0 Exp(eta), on SE(3) or on SO(3) x R^3."""

from __future__ import annotations

import dataclasses
from math import pi
from typing import TypeAlias

import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...groups import SpecialEuclidean, quaternions, se3, so3
from ...groups.arrays import Components, add, dot, scale, vector
from ...groups.series import inverse_coefficients, inverse_polynomial, stumpff, stumpff_polynomial
from ...lowering.small_call import held
from .coordinates import Chart, Coordinates, StoredPose, StoredRotation

__all__ = ["Exponential", "SplitExponential"]


@dataclasses.dataclass(frozen=True)
class _Closed:
    """The scalar functions of x = |w|^2 in Exp and in the inverse right Jacobian, in closed form, guarded near zero.

    Beyond a full turn, where J_r is singular, the result is NaN.
    """

    def half_turn(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """cos(t/2) and sin(t/2)/t: the quaternion of Exp(w) is (cos(t/2), sin(t/2)/t w)."""
        return jnp.where(x < 4.0 * pi**2, stumpff(0, 0.25 * x), jnp.nan), 0.5 * stumpff(1, 0.25 * x)

    def third(self, x: jax.Array) -> jax.Array:
        """(t - sin t)/t^3."""
        return stumpff(3, x)

    def inverse(self, x: jax.Array) -> tuple[jax.Array | float, jax.Array | float]:
        """d and d' with J_r^-1 = I + W/2 + d W^2."""
        return held(inverse_coefficients(x))


@dataclasses.dataclass(frozen=True)
class _Series:
    """The same as polynomials. Exp is exact to round-off up to a half turn; beyond it the result is NaN."""

    commutators: int

    def half_turn(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        quarter, limit = 0.25 * x, 0.25 * pi**2
        cosine = stumpff_polynomial(0, quarter, limit)
        return jnp.where(x < pi**2, cosine, jnp.nan), 0.5 * stumpff_polynomial(1, quarter, limit)

    def third(self, x: jax.Array) -> jax.Array:
        return stumpff_polynomial(3, x, pi**2)

    def inverse(self, x: jax.Array) -> tuple[jax.Array | float, jax.Array | float]:
        terms = self.commutators // 2
        found = inverse_polynomial(0, x, terms), inverse_polynomial(1, x, terms)
        return held(found) if terms > 2 else (held(found[0]), found[1])


_Maps: TypeAlias = _Closed | _Series


def _maps(commutators: int | None) -> _Maps:
    if commutators is None:
        return _Closed()
    if not isinstance(commutators, int) or commutators < 1:
        raise ModelError(
            f"commutators must be a whole number from 1 on, or None for the closed form, got {commutators!r}"
        )
    return _Series(commutators)


def _turned(q: Components, w: Components, cosine: jax.Array, sine: jax.Array) -> Components:
    """The quaternion of R(q) Exp(w), from cos(t/2) and sin(t/2)/t."""
    return quaternions.product(q, (cosine, *scale(sine, w)))


class _Rotation(StoredRotation):
    def __init__(self, maps: _Maps) -> None:
        self.maps = maps

    def move(self, y: Components, z: Components) -> Components:
        return _turned(y, z, *held(self.maps.half_turn(dot(z, z))))

    def slope(self, z: Components, moved: Components, omega: Components) -> Components:
        return so3.pulled_back(z, omega, self.maps.inverse(dot(z, z))[0])

    def tangent(self, z: Components) -> jax.Array:
        return vector(z)


class _Pose(StoredPose):
    """z = [v; w], the pose g_0 Exp(z)."""

    def __init__(self, group: SpecialEuclidean, maps: _Maps) -> None:
        super().__init__(group)
        self.maps = maps

    def move(self, y: Components, z: Components) -> Components:
        v, w = z[:3], z[3:]
        x = dot(w, w)
        cosine, sine, third = held((*self.maps.half_turn(x), self.maps.third(x)))
        # (1 - cos t)/t^2 = 2 (sin(t/2)/t)^2: the sine of the quaternion serves again.
        shift = held(se3.swept(w, v, 2.0 * sine * sine, third))
        return (*_turned(y[:4], w, cosine, sine), *add(y[4:], quaternions.rotate(y[:4], shift)))

    def slope(self, z: Components, moved: Components, omega: Components) -> Components:
        return se3.pulled_back(z, omega, *self.maps.inverse(dot(z[3:], z[3:])))

    def tangent(self, z: Components) -> jax.Array:
        return self.order.from_linear_first(vector(z))


class _SplitPose(StoredPose):
    """z = [position; rotation vector]: the pose (R_0 Exp(z_w), p_0 + z_p), so that z_p' = R v."""

    def __init__(self, group: SpecialEuclidean, maps: _Maps) -> None:
        super().__init__(group)
        self.maps = maps

    def move(self, y: Components, z: Components) -> Components:
        w = z[3:]
        return (*_turned(y[:4], w, *held(self.maps.half_turn(dot(w, w)))), *add(y[4:], z[:3]))

    def slope(self, z: Components, moved: Components, omega: Components) -> Components:
        w = z[3:]
        turn = so3.pulled_back(w, omega[3:], self.maps.inverse(dot(w, w))[0])
        return (*quaternions.rotate(moved[:4], omega[:3]), *turn)

    def first_slope(self, y: Components, omega: Components) -> Components:
        return (*quaternions.rotate(y[:4], omega[:3]), *omega[3:])


@dataclasses.dataclass(frozen=True)
class Exponential(Chart):
    """Exponential coordinates: g = g_0 Exp(eta) with eta' = J_r(eta)^-1 Omega, on SO(3) and on SE(3).

    Attributes:
        commutators: the powers of ad kept in J_r(eta)^-1 = I + ad/2 + ad^2/12 - ad^4/720 + ...; then everything is a
            polynomial, and a step that turns by more than half a turn fails. None: closed forms, and a step fails that
            turns by more than a full turn.
    A method of order p needs p - 2 commutators; `RKMK` asks for that many unless it is given a chart.

    Raises:
        ModelError: commutators that is no whole number from 1 on.

    Source: Munthe-Kaas, High order Runge-Kutta methods on manifolds (1999); Hairer, Lubich, Wanner, Geometric Numerical
    Integration (2006), section IV.8, for the number of terms.
    """

    commutators: int | None = None

    def __post_init__(self) -> None:
        _maps(self.commutators)

    def for_rotation(self) -> Coordinates:
        return _Rotation(_maps(self.commutators))

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _Pose(group, _maps(self.commutators))


@dataclasses.dataclass(frozen=True)
class SplitExponential(Exponential):
    """Exponential coordinates of the rotation alone; positions are added to: SO(3) x R^3 in place of SE(3).

    Attributes and errors as for `Exponential`.
    """

    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        return _SplitPose(group, _maps(self.commutators))
