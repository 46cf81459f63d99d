"""The coefficient functions and their derivatives against sums and differentiation with fifty digits."""

from functools import cache, reduce

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from twistax.groups import series

SWITCHES = (1.0, 4.0, 16.0)
POINTS = [0.0, 1e-300, 1e-18, 1e-10, 1e-4, 0.3, 2.5, 9.0, np.pi**2, 30.0]
POINTS += [np.nextafter(switch, side) for switch in SWITCHES for side in (0.0, switch, 99.0)]


@cache
def stumpff_terms(k, order):
    """Coefficients of the order-th derivative of sum_j (-x)^j / (2j + k)!, the highest power first."""
    terms = range(order, 60)
    return [(-1) ** j * mpmath.ff(j, order) / mpmath.factorial(2 * j + k) for j in reversed(terms)]


@cache
def inverse_terms(order):
    """Of the order-th derivative of sum_j |B_{2j+2}| x^j / (2j+2)!, which converges below 4 pi^2."""
    terms = range(order, 700)
    return [
        abs(mpmath.bernoulli(2 * j + 2)) * mpmath.ff(j, order) / mpmath.factorial(2 * j + 2) for j in reversed(terms)
    ]


def stumpff_exact(k, x, order):
    return reduce(lambda value, term: value * x + term, stumpff_terms(k, order))


def inverse_exact(_, x, order):
    return reduce(lambda value, term: value * x + term, inverse_terms(order))


#: Units in the last place that may be lost, by the order of the derivative.
LOSS = {stumpff_exact: (6, 20, 100, 1000), inverse_exact: (20, 1e3, 1e3, 1e4)}

#: XLA's own settings, as users have them: products and sums are fused. The suite's settings fuse none and lose more.
OWN = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}


def pick(function, index):
    return lambda x: function(x)[index]


FUNCTIONS = {
    **{f"stumpff {k}": (lambda x, k=k: series.stumpff(k, x), stumpff_exact, k) for k in range(6)},
    **{f"exp_coefficients {i}": (pick(series.exp_coefficients, i), stumpff_exact, i + 1) for i in range(3)},
    "inverse_coefficients 0": (pick(series.inverse_coefficients, 0), inverse_exact, None),
    "inverse_derivative 0": (lambda x: series.inverse_derivative(0, x), inverse_exact, None),
}
SLOPES = {
    "jacobian_coefficients 2": (pick(series.jacobian_coefficients, 2), stumpff_exact, 2),
    "jacobian_coefficients 3": (pick(series.jacobian_coefficients, 3), stumpff_exact, 3),
    "inverse_coefficients 1": (pick(series.inverse_coefficients, 1), inverse_exact, None),
    "inverse_derivative 1": (lambda x: series.inverse_derivative(1, x), inverse_exact, None),
}


@cache
def exact(function, k, x, order):
    with mpmath.workdps(50):
        return float(function(k, mpmath.mpf(x), order))


def derivatives(function):
    """x -> the value and the first two derivatives, by forward mode."""
    first = jax.jacfwd(function)
    return lambda x: jnp.stack([function(x), first(x), jax.jacfwd(first)(x)])


@pytest.mark.parametrize("precision", [np.float64, np.float32])
def test_values_and_two_derivatives(precision):
    """All functions at all points in one precision, compiled once."""
    points, wrong = np.array(POINTS, precision), []
    chains = {name: derivatives(function) for name, (function, _, _) in (FUNCTIONS | SLOPES).items()}
    together = jax.jit(jax.vmap(lambda x: {name: chain(x) for name, chain in chains.items()}), compiler_options=OWN)
    for name, values in together(points).items():
        _, oracle, k = (FUNCTIONS | SLOPES)[name]
        assert values.dtype == precision
        for x, row in zip(points, np.asarray(values), strict=True):
            for order, value in enumerate(row, start=1 if name in SLOPES else 0):
                expected = exact(oracle, k, float(x), order)
                # Each differentiation of a closed form costs some digits where it takes over from the series.
                scale = max(abs(expected), abs(exact(oracle, k, 0.0, order)))
                if not abs(value - expected) <= LOSS[oracle][order] * np.finfo(precision).eps * scale:
                    wrong.append((name, x, order))
    assert not wrong


def everything(x):
    """All coefficients of the maps at once."""
    return sum(
        (*series.exp_coefficients(x), *series.jacobian_coefficients(x), *series.inverse_coefficients(x)),
        series.inverse_derivative(0, x),
    )


def test_forward_is_reverse():
    points = np.array(POINTS)
    forward, reverse = (np.asarray(jax.jit(jax.vmap(mode(everything)))(points)) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=1e-13)


def test_nothing_but_finite_numbers_on_the_way():
    with jax.debug_nans(True):
        for x in (0.0, 1.0):
            assert jnp.isfinite(jax.grad(jax.grad(everything))(jnp.asarray(x)))


def test_angle_ratio():
    for dtype in (np.float64, np.float32):
        small = np.finfo(dtype).tiny
        for s, c in ((0.0, 1.0), (small, 3.0), (1e-3, 1.0), (0.6, 0.8), (1.0, 0.0)):
            got = series.angle_ratio(jnp.asarray(s * s, dtype), jnp.asarray(c, dtype))
            expected = 2.0 * np.arctan2(s, c) / s if s > 1e-30 else 2.0 / c
            assert got.dtype == dtype
            np.testing.assert_allclose(got, expected, rtol=4 * np.finfo(dtype).eps)
