"""The covariance of a prediction against SciPy's exponential and exact solutions, in batches of any norm."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

import twistax as tx
from twistax.estimation import ErrorStateKalman

N = 4
x = tx.State("x", shape=(N,))
A = tx.Parameter("A", shape=(N, N))
SYSTEM = tx.System(rates={x: A @ x + np.diag([1.0, 0.3, 2.0, 0.0]) @ tx.Noise("w", shape=(N,), density=1.0)})
INTENSITY = np.diag([1.0, 0.09, 4.0, 0.0])
SENSOR = tx.Measurement("x", x, covariance=1.0)
KALMAN = ErrorStateKalman(tx.compile(SYSTEM), [SENSOR], method=tx.RKMK(tx.tableaus.EULER))


@jax.jit
def noise(slopes: Any) -> Any:
    """The covariance of a second of noise."""
    return KALMAN.predict(0.0, {"x": jnp.zeros(N, slopes.dtype)}, 0.0, 1.0, params={"A": slopes}).P


def by_scipy(slopes: np.ndarray) -> np.ndarray:
    """Van Loan's block matrix."""
    E = expm(np.block([[-slopes, INTENSITY], [np.zeros((N, N)), slopes.T]]))
    return np.asarray(E[N:, N:].T @ E[:N, N:])


def random(norm: float, key: int = 0) -> np.ndarray:
    slopes = np.random.default_rng(key).normal(size=(N, N))
    return norm * slopes / np.linalg.norm(slopes, 1)


def test_any_norm_is_as_exact_as_scipy_in_one_program() -> None:
    """The number of doublings is decided by value, also within one batch, whose members have one compiled program."""
    slopes = np.stack([random(norm, key) for key, norm in enumerate([0.0, 1e-9, 1e-3, 0.01, 0.1, 1.0, 3.0, 10.0])])
    expected = np.stack([by_scipy(matrix) for matrix in slopes])
    alone = np.stack([noise(matrix) for matrix in slopes])
    together = jax.jit(jax.vmap(noise))(slopes)
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
    # SciPy's has exp(-A) in it, so its digits go at a norm of 10.
    np.testing.assert_allclose(alone / scale, expected / scale, atol=2e-13)
    np.testing.assert_allclose(together / scale, alone / scale, atol=1e-15)
    assert noise._cache_size() == 1
    np.testing.assert_array_equal(alone, np.swapaxes(alone, 1, 2))


def test_stiff_and_nilpotent_systems_have_their_exact_covariance() -> None:
    """Where Van Loan's exponential overflows: a decay within 1e-4 of the step; and large chains of integrators."""
    stiff = np.diag([-1e4, -1.0, -1e-3, -30.0])
    stiff[0, 1] = 5.0
    steady = solve_continuous_lyapunov(stiff, -INTENSITY)
    np.testing.assert_allclose(noise(stiff), steady - expm(stiff) @ steady @ expm(stiff).T, rtol=1e-11, atol=1e-14)
    chain = np.zeros((N, N))
    chain[1, 0], chain[2, 1], chain[3, 2] = 300.0, 1e4, 1.0
    cubes = [1.0, 300.0, 3e6 / 2.0, 3e6 / 6.0]  # of t^0 to t^3, from the first noise
    orders = np.arange(N)
    expected = np.outer(cubes, cubes) / (orders[:, None] + orders[None, :] + 1.0)
    expected[1:, 1:] += 0.09 * np.outer(*2 * [[1.0, 1e4, 5e3]]) / (orders[:3, None] + orders[None, :3] + 1.0)
    expected[2:, 2:] += 4.0 * np.array([[1.0, 0.5], [0.5, 1.0 / 3.0]])
    np.testing.assert_allclose(noise(chain), expected, rtol=1e-13)


def test_single_precision() -> None:
    got = noise(random(2.0).astype(np.float32))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, by_scipy(random(2.0)), rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("norm", [0.0, 0.002, 2.0])
def test_derivatives(norm: float) -> None:
    """Forward and reverse against differences, with no doubling and with several."""
    total = lambda slopes: jnp.sum(jnp.cos(jnp.arange(16.0).reshape(4, 4)) * noise(slopes))  # noqa: E731
    at, step = random(norm), 1e-5
    numeric = [(total(at + d) - total(at - d)) / (2.0 * step) for d in step * np.eye(16).reshape(16, N, N)]
    for derivative in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(np.ravel(derivative(total)(at)), numeric, rtol=1e-7, atol=1e-9)
    # Finite as long as the covariance is: in a reverse pass nothing is doubled once more.
    growing = np.diag([250.0, 1.0, -1.0, 0.0])
    np.testing.assert_allclose(jax.grad(total)(growing), jax.jacfwd(total)(growing), rtol=1e-9)
