"""Small systems are solved as accurately as LAPACK solves them, on every path."""

from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.linalg

import twistax as tx
from twistax.expr.solve import eliminate

CASES = 40


def systems(n: int, condition: float, dtype: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of a condition number, right-hand sides, and the solutions to 50 digits, rounded to float64."""
    rng = np.random.default_rng(n)
    A, b, x = [], [], []
    for _ in range(CASES):
        left, right = (np.linalg.qr(rng.normal(size=(n, n)))[0] for _ in range(2))
        matrix = ((left * np.geomspace(1.0, 1.0 / condition, n)) @ right).astype(dtype)
        # A right-hand side of a solution of size one: only there do the two algorithms differ.
        vector = (matrix @ rng.normal(size=n)).astype(dtype)
        with mpmath.workdps(50):
            exact = mpmath.lu_solve(mpmath.matrix(matrix.tolist()), mpmath.matrix(vector.tolist()))
        A.append(matrix)
        b.append(vector)
        x.append([float(v) for v in exact])
    return np.array(A), np.array(b), np.array(x)


def error(found: Any, exact: np.ndarray) -> float:
    """The median over the cases of the largest relative error."""
    return float(np.median(np.abs(np.asarray(found) - exact).max(-1) / np.abs(exact).max(-1)))


@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("backend", [tx.JAX(), tx.XLA(least=0), tx.Native(least=0)], ids=["JAX", "XLA", "Native"])
def test_as_accurate_as_lapack(n: int, backend: Any) -> None:
    A_, b_ = tx.State("A", shape=(n, n)), tx.State("b", shape=(n,))
    inverse = tx.linalg.Inv(A_) @ b_
    dynamics = tx.compile(tx.System({A_: 0.0 * A_, b_: tx.linalg.Solve(A_, b_)}, {"Ab": inverse}), backend=backend)
    run = jax.jit(jax.vmap(lambda A, b: dynamics(0.0, {"A": A, "b": b})["b"]))
    for dtype, conditions in ((np.float64, (1e2, 1e5, 1e8, 1e12, 1e14)), (np.float32, (1e2, 1e5))):
        for condition in conditions:
            A, b, x = systems(n, condition, dtype)
            found = run(A, b)
            assert found.dtype == dtype
            (gesv,) = scipy.linalg.get_lapack_funcs(("gesv",), (A,))  # NumPy would compute in float64
            lapack = np.stack([gesv(*case)[2] for case in zip(A, b, strict=True)])
            assert error(found, x) <= 3.0 * error(lapack, x), (dtype, condition)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_inverse_of_a_stack(n: int) -> None:
    A, _, _ = systems(n, 1e10, np.float64)
    found = tx.lower(tx.linalg.Inv(tx.State("A", shape=A.shape)))(0.0, {"A": A})
    scale = np.abs(np.linalg.inv(A)).max(axis=(-2, -1))
    residual = np.abs(A @ np.asarray(found) - np.eye(n)).max(axis=(-2, -1))
    assert (residual <= 1e-15 * scale * n**2).all()


def test_pivots_are_chosen() -> None:
    """Each has a zero or a tiny entry where elimination would divide by it."""
    matrices = [
        [[0.0, 2.0, 1.0], [1.0, 0.0, 0.0], [3.0, 0.0, 1.0]],
        [[1.0, 1.0, 0.0], [1.0, 1.0, 2.0], [0.0, 1.0, 0.0]],
        [[1e-20, 1.0, 1.0], [1.0, 1.0, 2.0], [1.0, 2.0, 1.0]],
        [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
    ]
    b = np.array([1.0, -2.0, 0.5])
    for A in map(np.array, matrices):
        np.testing.assert_allclose(
            eliminate(jnp.asarray(A), jnp.asarray(b)[:, None])[:, 0], np.linalg.solve(A, b), rtol=1e-14
        )


def test_extreme_units_and_singular_matrices() -> None:
    A, b = np.diag([1e150, 1e-150, 1.0]), np.array([1e150, 1e-150, 1.0])
    np.testing.assert_allclose(eliminate(jnp.asarray(A), jnp.asarray(b)[:, None])[:, 0], 1.0, rtol=1e-15)
    assert not np.isfinite(eliminate(jnp.ones((3, 3)), jnp.asarray(b)[:, None])).any()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_derivatives_are_those_of_the_implicit_function(n: int) -> None:
    """dx = A^-1 (db - dA x), forward, in reverse, and once more."""
    rng = np.random.default_rng(3)
    A, dA = rng.normal(size=(2, n, n))
    b, db = rng.normal(size=(2, n, 2))

    def run(A: jax.Array, b: jax.Array) -> jax.Array:
        return eliminate(A, b)

    x = np.linalg.solve(A, b)
    dx = np.linalg.solve(A, db - dA @ x)
    np.testing.assert_allclose(jax.jvp(run, (A, b), (dA, db))[1], dx, rtol=1e-11, atol=1e-12)
    weights = rng.normal(size=x.shape)
    back = jax.vjp(run, A, b)[1](weights)
    assert np.vdot(back[0], dA) + np.vdot(back[1], db) == pytest.approx(np.vdot(weights, dx), rel=1e-10)
    second = jax.jvp(lambda A, b: jax.jvp(run, (A, b), (dA, db))[1], (A, b), (dA, db))[1]
    np.testing.assert_allclose(second, -2.0 * np.linalg.solve(A, dA @ dx), rtol=1e-9, atol=1e-10)
    batched = jax.vmap(run)(np.stack([A, A.T]), np.stack([b, b]))
    np.testing.assert_allclose(batched[1], np.linalg.solve(A.T, b), rtol=1e-11)


def test_no_product_of_matrices_stands_in_derivatives() -> None:
    """Accelerators round its factors to fewer bits, and a large one may not stand in a small function."""
    A = jnp.ones((10, 3, 3)) + jnp.eye(3)[None]
    for derivative in (jax.jacfwd, jax.jacrev):
        assert "dot_general" not in str(jax.make_jaxpr(derivative(lambda A: eliminate(A, A)))(A))
