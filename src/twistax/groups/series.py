"""The coefficient functions of the rotation maps, guarded against cancellation. No other file in the package divides by
an angle.

Every function takes x = theta^2, because all of them are smooth in x, also at zero. Three rules keep them accurate:

* if the closed form cancels, a short series replaces it; the closed form then has a clipped argument, so that the
  branch that is not selected stays finite;
* each function defines its derivative, again a function of this file, so that derivatives of any order are as accurate
  as the values, and no square root is differentiated;
* the number of terms follows the precision of x. The switch points need not: cancellation costs the same number of
  units in the last place in every precision.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import cache, partial
from math import comb, factorial

import jax
import jax.numpy as jnp
from jax import Array


def _horner(x: Array, coefficients: tuple[float, ...]) -> Array:
    """sum_j coefficients[j] x^j for two or more coefficients."""
    value = x * coefficients[-1] + coefficients[-2]
    for coefficient in coefficients[-3::-1]:
        value = value * x + coefficient
    return value


def _enough(coefficient: Callable[[int], Fraction], switch: float, eps: float) -> tuple[float, ...]:
    """The first coefficients of a power series, as many as [0, switch] needs for a relative error below eps / 4."""
    limit = abs(coefficient(0)) * Fraction(eps) / 4
    count = 2
    while abs(coefficient(count)) * Fraction(switch) ** count > limit:
        count += 1
    return tuple(float(coefficient(j)) for j in range(count))


def _epsilon(x: Array) -> float:
    return float(jnp.finfo(x.dtype).eps)


def _angle(x: Array) -> Array:
    """sqrt(x), kept above zero so that it may divide; sin(h) / h is exactly 1 there."""
    return jnp.sqrt(jnp.maximum(x, float(jnp.finfo(x.dtype).tiny)))


# --- the exponential and the Jacobians -------------------------------------------------------------------------------


def _stumpff_switch(k: int) -> float:
    """Each division by x in the closed form costs digits, so the series reaches further for larger k."""
    return 1.0 if k <= 3 else 4.0 if k <= 5 else 16.0


@cache
def _stumpff_terms(k: int, limit: float, eps: float) -> tuple[float, ...]:
    return _enough(lambda j: Fraction((-1) ** j, factorial(2 * j + k)), limit, eps)


def stumpff_polynomial(k: int, x: Array, limit: float) -> Array:
    """c_k(x) by its power series alone, as many terms as [0, limit] needs for round-off; wrong far beyond it."""
    return _horner(x, _stumpff_terms(k, limit, _epsilon(x)))


def _stumpff_above(k: int, x: Array, below: Array) -> Array:
    """c_k from c_{k-2} = below: series for small x, (1/(k-2)! - c_{k-2}) / x beyond."""
    switch = _stumpff_switch(k)
    series = stumpff_polynomial(k, jnp.minimum(x, switch), switch)
    closed = (1.0 / factorial(k - 2) - below) / jnp.maximum(x, switch)
    return jnp.where(x < switch, series, closed)


def _stumpff_values(x: Array) -> tuple[Array, Array, Array]:
    """c_1, c_2 and c_3 from one sine and one cosine of the half angle; 1 - cos is 2 sin^2 of the half angle."""
    half = 0.5 * _angle(x)
    sine = jnp.sin(half) / half
    first = sine * jnp.cos(half)
    return first, 0.5 * sine * sine, _stumpff_above(3, x, first)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def stumpff(k: int, x: Array) -> Array:
    """The Stumpff function c_k(x) = sum_j (-x)^j / (2j + k)!, x = theta^2 >= 0.

    c_0 = cos t, c_1 = sin t / t, c_2 = (1 - cos t) / t^2, c_3 = (t - sin t) / t^3, and so on, with
    dc_k/dx = (k c_{k+2} - c_{k+1}) / 2. Source: Stiefel and Scheifele, Linear and Regular Celestial Mechanics (1971).
    """
    if k == 0:
        return jnp.cos(_angle(x))
    if k <= 3:
        return _stumpff_values(x)[k - 1]
    return _stumpff_above(k, x, stumpff(k - 2, x))


@stumpff.defjvp
def _stumpff_jvp(k: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (x,), (dx,) = primals, tangents
    return stumpff(k, x), 0.5 * (k * stumpff(k + 2, x) - stumpff(k + 1, x)) * dx


@jax.custom_jvp
def exp_coefficients(x: Array) -> tuple[Array, Array, Array]:
    """(sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3) at x = t^2, sharing one sine and one cosine.

    With W = hat(w): Exp(w) = I + c_1 W + c_2 W^2 and the left Jacobian is I + c_2 W + c_3 W^2.
    """
    return _stumpff_values(x)


@exp_coefficients.defjvp
def _exp_coefficients_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    (x,), (dx,) = primals, tangents
    first, second, third = exp_coefficients(x)
    fourth, fifth = stumpff(4, x), stumpff(5, x)
    half = 0.5 * dx
    rates = ((third - second) * half, (2.0 * fourth - third) * half, (3.0 * fifth - fourth) * half)
    return (first, second, third), rates


def jacobian_coefficients(x: Array) -> tuple[Array, Array, Array, Array]:
    """(c_2, c_3, c_2', c_3') for the left Jacobian of SE(3), the slopes with respect to x = t^2.

    Near zero c_k' = (k c_{k+2} - c_{k+1}) / 2; beyond, (c_{k-1} - k c_k) / (2x), which does not cancel at large angles.
    """
    first, second, third = exp_coefficients(x)
    fourth, fifth = stumpff(4, x), stumpff(5, x)
    switch = _stumpff_switch(5)
    small = x < switch
    # A selection, not a maximum: this one is differentiated, and a maximum has half a slope at the switch point.
    twice = 2.0 * jnp.where(small, switch, x)
    second_slope = jnp.where(small, fourth - 0.5 * third, (first - 2.0 * second) / twice)
    third_slope = jnp.where(small, 1.5 * fifth - 0.5 * fourth, (second - 3.0 * third) / twice)
    return second, third, second_slope, third_slope


# --- the inverse Jacobians -------------------------------------------------------------------------------------------


@cache
def _bernoulli(n: int) -> Fraction:
    if n == 0:
        return Fraction(1)
    return -sum((comb(n + 1, k) * _bernoulli(k) for k in range(n)), Fraction(0)) / (n + 1)


def _inverse_switch(n: int) -> float:
    return 1.0 if n <= 1 else 4.0


def _inverse_coefficient(n: int, j: int) -> Fraction:
    """That of x^j in the n-th derivative of sum_j |B_{2j+2}| / (2j+2)! x^j, which converges below 4 pi^2."""
    power = j + n
    return abs(_bernoulli(2 * power + 2)) / factorial(2 * power + 2) * Fraction(factorial(power), factorial(j))


@cache
def _inverse_terms(n: int, eps: float) -> tuple[float, ...]:
    return _enough(partial(_inverse_coefficient, n), _inverse_switch(n), eps)


def inverse_polynomial(n: int, x: Array, terms: int) -> Array | float:
    """The n-th derivative of the first `terms` terms of d(x) = 1/12 + x/720 + ..., the series of `inverse_derivative`.

    In J^-1 = I -+ W/2 + d(x) W^2 the j-th term is that of 2j commutators, because W^3 = -x W.
    """
    coefficients = [float(_inverse_coefficient(n, j)) for j in range(terms - n)]
    if len(coefficients) < 2:
        return coefficients[0] if coefficients else 0.0
    return _horner(x, tuple(coefficients))


def _inverse_series(n: int, x: Array) -> Array:
    return _horner(jnp.minimum(x, _inverse_switch(n)), _inverse_terms(n, _epsilon(x)))


def _inverse_closed(n: int, x: Array) -> list[Array]:
    """d and its first n derivatives from x d' = 1/8 - 3/2 d + x d^2 / 2 (the cotangent's Riccati equation)."""
    half = 0.5 * jnp.sqrt(x)
    values = [(1.0 - half * jnp.cos(half) / jnp.sin(half)) / x]
    for m in range(n):

        def square(order: int) -> Array:
            terms = [comb(order, i) * values[i] * values[order - i] for i in range(order + 1)]
            return sum(terms[1:], terms[0])

        rest = 0.5 * x * square(m) - (m + 1.5) * values[m]
        rest = rest + (0.125 if m == 0 else 0.5 * m * square(m - 1))
        values.append(rest / x)
    return values


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def inverse_derivative(n: int, x: Array) -> Array:
    """The n-th derivative with respect to x of d(x) = (1 - (t/2) cot(t/2)) / t^2, x = t^2 < 4 pi^2."""
    switch = _inverse_switch(n)
    return jnp.where(x < switch, _inverse_series(n, x), _inverse_closed(n, jnp.maximum(x, switch))[n])


@inverse_derivative.defjvp
def _inverse_derivative_jvp(n: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (x,), (dx,) = primals, tangents
    return inverse_derivative(n, x), inverse_derivative(n + 1, x) * dx


@jax.custom_jvp
def inverse_coefficients(x: Array) -> tuple[Array, Array]:
    """(d, d') with d(x) = (1 - (t/2) cot(t/2)) / t^2, x = t^2, sharing one sine and one cosine.

    With W = hat(w): the inverse left Jacobian of SO(3) is I - W/2 + d W^2; d' enters that of SE(3).
    """
    switch = _inverse_switch(1)
    small = x < switch
    value, rate = _inverse_closed(1, jnp.maximum(x, switch))
    return jnp.where(small, _inverse_series(0, x), value), jnp.where(small, _inverse_series(1, x), rate)


@inverse_coefficients.defjvp
def _inverse_coefficients_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    (x,), (dx,) = primals, tangents
    value, rate = inverse_coefficients(x)
    return (value, rate), (rate * dx, inverse_derivative(2, x) * dx)


# --- the logarithm ---------------------------------------------------------------------------------------------------


def angle_ratio(y: Array, c: Array) -> Array:
    """2 atan2(s, c) / s at y = s^2: turns the vector part of a quaternion (c, s n) of any scale into a rotation vector.

    Nothing cancels here, so a clipped argument is guard enough. It has no derivative of its own: the logarithm, its
    only caller, is differentiated as a whole.
    """
    s = _angle(y)
    return 2.0 * jnp.arctan2(s, c) / s
