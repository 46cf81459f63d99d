"""`tx.fast` functions that are linear can be transposed; and follow JAX's switch of precision."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

BACKENDS = (tx.JAX(), tx.XLA(least=0), tx.Native(least=0, scalars=tx.XLA(least=0)))
A = np.random.default_rng(3).normal(size=(4, 4)) + 4.0 * np.eye(4)
B = np.arange(1.0, 5.0)
each_backend = pytest.mark.parametrize("backend", BACKENDS, ids=lambda b: type(b).__name__)


def transposed(function: Any, x: Any, cotangent: Any) -> np.ndarray:
    (found,) = jax.linear_transpose(function, x)(cotangent)
    return np.asarray(found)


@each_backend
def test_linear_functions_are_transposed(backend: Any) -> None:
    near = lambda found, right: np.testing.assert_allclose(found, right, rtol=1e-12, atol=1e-12)  # noqa: E731
    by_matrix = tx.fast(lambda a, v: a @ v, backend=backend)
    near(transposed(lambda v: by_matrix(A, v), B, B), A.T @ B)
    near(transposed(lambda a: by_matrix(a, B), A, B), np.outer(B, B))
    both = jax.vmap(lambda a, v: by_matrix(a, v), in_axes=(0, None))
    near(transposed(lambda v: both(np.stack([A, 2.0 * A]), v), B, np.stack([B, B])), 3.0 * A.T @ B)
    near(transposed(lambda v: jax.jvp(lambda a: by_matrix(a, v), (A,), (A.T,))[1], B, B), A @ B)
    steps = tx.fast(lambda v: jax.lax.fori_loop(0, 900, lambda k, v: 0.999 * v + 1e-4 * (A @ v), v), backend=backend)
    near(transposed(steps, B, B), np.asarray(jax.jacfwd(steps)(B)).T @ B)


@each_backend
def test_linear_solvers_take_compiled_products(backend: Any) -> None:
    product = tx.fast(lambda v: A @ v, backend=backend)
    weights = np.cos(B)
    slope = jax.grad(lambda b: weights @ jax.scipy.sparse.linalg.gmres(product, b, tol=1e-12)[0])(B)
    np.testing.assert_allclose(slope, np.linalg.solve(A.T, weights), rtol=1e-9)
    solve = lambda matvec, b: jnp.linalg.solve(A, b)  # noqa: E731
    back = lambda vecmat, b: jnp.linalg.solve(A.T, b)  # noqa: E731
    slope = jax.grad(lambda b: weights @ jax.lax.custom_linear_solve(product, b, solve, back))(B)
    np.testing.assert_allclose(slope, np.linalg.solve(A.T, weights), rtol=1e-9)


def test_what_is_not_linear_is_refused() -> None:
    for backend in BACKENDS[1:]:
        with pytest.raises(NotImplementedError, match=r"not linear(.|\n)*jax.vjp"):
            transposed(tx.fast(lambda v: v * v, backend=backend), B, B)


@each_backend
@pytest.mark.filterwarnings("ignore:Explicitly requested dtype", "ignore:.*gives no speed-up")
def test_the_switch_of_precision_is_that_of_jit(backend: Any) -> None:
    """After the function is compiled; also for arrays of 64 bits that are left from before."""
    plain = lambda v: jnp.sin(v) * v + 2.0  # noqa: E731
    fast, jitted = tx.fast(plain, backend=backend), jax.jit(plain)
    wide = jnp.asarray(B)
    for x64 in (True, False, True):
        with jax.enable_x64(x64):
            for x in (B, wide, B.astype(np.float32)):
                for transformed in (lambda f: f, jax.jacfwd, lambda f: jax.grad(lambda v: f(v).sum())):
                    found, right = transformed(fast)(x), transformed(jitted)(x)
                    assert found.dtype == right.dtype
                    np.testing.assert_allclose(found, right, rtol=1e-6, atol=1e-6)
