"""Steps of filters as kernels: the numbers of the same filter in arrays, in batches and in derivatives."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.estimation import ErrorStateKalman, SquareRootKalman, Trapezoidal, UnscentedKalman, VanLoan

pytest.importorskip("llvmlite")

q, b = tx.State("q", group=tx.SO3), tx.State("b", shape=(3,))
gyro = tx.Control("gyro", shape=(3,))
noise = tx.Noise("n", shape=(3,), density=tx.Parameter("density", value=0.1))
SATELLITE = tx.System(rates={q: gyro - b - noise, b: -0.1 * b})
FIELD = tx.Measurement("field", q.T @ np.array([0.3, -0.2, 0.9]), covariance=0.01)
KEYS = jax.random.split(jax.random.key(0), 16)
FILTERS = [
    pytest.param(ErrorStateKalman, Trapezoidal(), id="error state"),
    pytest.param(UnscentedKalman, Trapezoidal(), id="unscented"),
    pytest.param(ErrorStateKalman, VanLoan(), id="a loop in the prediction"),
    pytest.param(SquareRootKalman, VanLoan(), id="roots of covariances"),
]


def estimate(key: Any) -> Any:
    """A random estimate, reading and value."""
    at, offset, root, reading, value = jax.random.normal(key, (5, 6, 6))
    x, P = {"q": tx.SO3.exp(at[0, :3]), "b": offset[0, :3]}, 0.1 * root @ root.T
    return x, P, {"gyro": reading[0, :3]}, value[0, :3]


def stepped(kalman: Any) -> Callable[..., Any]:
    """A prediction and an update."""

    def step(x: Any, P: Any, u: Any, z: Any) -> Any:
        prediction = kalman.predict(0.0, x, P, 0.2, u)
        update = kalman.update("field", 0.2, prediction.x, prediction.P, z, u)
        return update.x, update.P, update.nis, update.log_likelihood

    return step


ESTIMATES = jax.vmap(estimate)(KEYS)


@pytest.mark.parametrize(("kind", "noise"), FILTERS)
def test_a_batch_has_the_numbers_of_arrays(kind: Any, noise: Any) -> None:
    """Nothing is computed by XLA where the algebra has a scalar form."""
    results, texts = [], []
    for backend in (tx.Native(), tx.JAX()):
        step = jax.jit(jax.vmap(stepped(kind(tx.compile(SATELLITE, backend=backend), [FIELD], noise=noise))))
        results.append(step(*ESTIMATES))
        texts.append(step.lower(*ESTIMATES).as_text())
    jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-10, atol=1e-12), *results)
    if kind is not SquareRootKalman:
        loops = 2 * isinstance(noise, VanLoan)  # what doubles the interval, and what follows; JAX 0.12 needs one
        assert 2 <= texts[0].count("@twistax_") <= 2 + loops
        assert not [word for word in ("is_finite", "divide", "dot_general", "while") if word in texts[0]]


def test_a_step_in_float32_is_kernels_alone() -> None:
    kalman = UnscentedKalman(tx.compile(SATELLITE, backend=tx.Native()), [FIELD], noise=Trapezoidal())
    step, single = jax.jit(stepped(kalman)), jax.tree.map(lambda a: jnp.asarray(a[0], np.float32), ESTIMATES)
    text = step.lower(*single).as_text()
    assert text.count("@twistax_") == 2
    assert "divide" not in text


@pytest.mark.thorough
def test_derivatives_are_those_of_arrays() -> None:
    """Forward and reverse, of the likelihood of records by the density of the noise."""
    records = {"field": (np.array([0.1, 0.3, 0.4]), np.array([[0.3, 0.1, 0.8], [0.2, 0.2, 0.9], [np.nan] * 3]))}
    start, u = {"q": np.eye(3), "b": np.zeros(3)}, {"gyro": np.array([0.4, -0.7, 1.1])}
    slopes = []
    for backend in (tx.Native(), tx.JAX()):
        kalman = ErrorStateKalman(tx.compile(SATELLITE, backend=backend), [FIELD], noise=Trapezoidal())

        def likelihood(density: Any, kalman: Any = kalman) -> Any:
            return kalman.run(records, start, 0.1, t0=0.0, u=u, params={"density": density}).log_likelihood

        slopes += [jax.jacfwd(likelihood)(jnp.asarray(0.2)), jax.grad(likelihood)(jnp.asarray(0.2))]
        step = 1e-5
        slopes.append((likelihood(0.2 + step) - likelihood(0.2 - step)) / (2.0 * step))
    np.testing.assert_allclose(slopes, slopes[-2], rtol=1e-6)
