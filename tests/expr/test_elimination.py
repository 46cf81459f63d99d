"""Small systems are solved as accurately as LAPACK solves them, on every path."""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.linalg

import twistax as tx

#: From matrices and right-hand sides of a number of systems to their solutions, by Solve and by Inv.
Run = Callable[[np.ndarray, np.ndarray], Sequence[Any]]

CASES = 100


def eliminate(A: Any, b: Any) -> Any:
    """A^-1 b of a small matrix (n, n) and columns b (n, k), by `Solve`."""
    solution = tx.linalg.Solve(tx.State("A", np.shape(A)), tx.State("b", np.shape(b)))
    return tx.lower(solution)(0.0, {"A": A, "b": b})


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


def by_backend(backend: Any, system: tx.System, folder: Path) -> Run:
    dynamics = tx.compile(system, backend=backend)
    return jax.jit(
        jax.vmap(lambda A, b: [dynamics.outputs(0.0, {"A": A, "b": b})[name] for name in ("solve", "inverse")])
    )


def lowered(system: tx.System, folder: Path) -> Run:
    function = tx.lower(tuple(system.outputs.values()))
    return jax.jit(jax.vmap(lambda A, b: [*function(0.0, {"A": A, "b": b})]))


def in_c(system: tx.System, folder: Path) -> Run:
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler is installed")
    libraries = {}
    for dtype in (np.dtype(np.float64), np.dtype(np.float32)):
        source = tx.compile(system).to_c(folder, name=dtype.name, dtype=dtype, jacobian=()).source
        target = source.with_suffix(".so")
        subprocess.run([compiler, "-O1", "-shared", "-fPIC", str(source), "-lm", "-o", str(target)], check=True)
        libraries[dtype] = ctypes.CDLL(str(target))

    def run(A: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
        real = ctypes.c_float if A.dtype == np.float32 else ctypes.c_double
        found = np.zeros((2, *b.shape), A.dtype)
        for k in range(len(A)):
            arrays = [np.ascontiguousarray(a) for a in (A[k], b[k])] + [found[0, k], found[1, k]]
            pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
            getattr(libraries[A.dtype], f"{A.dtype.name}_outputs")(real(0.0), *pointers)
        return list(found)

    return run


def in_casadi(system: tx.System, folder: Path) -> Run:
    pytest.importorskip("casadi", reason="casadi is not installed (extra twistax[casadi])")
    function = tx.compile(system).to_casadi("outputs")

    def run(A: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
        if A.dtype == np.float32:
            pytest.skip("CasADi computes in double precision")
        found = [function(t=0.0, A=A[k], b=b[k]) for k in range(len(A))]
        return [np.array([np.array(each[name])[:, 0] for each in found]) for name in ("solve", "inverse")]

    return run


PATHS: dict[str, Callable[[tx.System, Path], Run]] = {
    "lower": lowered,
    "JAX": partial(by_backend, tx.JAX()),
    "XLA": partial(by_backend, tx.XLA(least=0)),
    "Native": partial(by_backend, tx.Native(least=0)),
    "C": in_c,
    "CasADi": in_casadi,
}
CONDITIONS = {np.float64: (1e2, 1e5, 1e8, 1e11, 1e14), np.float32: (1e2, 1e4, 1e6)}


@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("path", PATHS)
def test_as_accurate_as_lapack(n: int, path: str, tmp_path: Path) -> None:
    """Solve and Inv, beside LAPACK's in the same precision: the median error is at most three times as large.

    At XLA's optimisation level 0, which the suite's flags ask for, an inverse times a vector is up to 36 times less
    accurate, where the same scalars by NumPy are not: the smoke tier, with XLA's own settings, sees that path.
    """
    if path == "XLA" and os.environ.get("XLA_FLAGS"):
        pytest.skip("with XLA's own settings only")
    A_, b_ = tx.State("A", shape=(n, n)), tx.State("b", shape=(n,))
    outputs = {"solve": tx.linalg.Solve(A_, b_), "inverse": tx.linalg.Inv(A_) @ b_}
    run = PATHS[path](tx.System({A_: 0.0 * A_, b_: 0.0 * b_}, outputs), tmp_path)
    for dtype, conditions in CONDITIONS.items():
        for condition in conditions:
            A, b, x = systems(n, condition, dtype)
            # NumPy would compute in float64.
            gesv, getrf, getri = scipy.linalg.get_lapack_funcs(("gesv", "getrf", "getri"), (A,))
            solved = np.stack([gesv(*case)[2] for case in zip(A, b, strict=True)])
            inverses = [getri(*getrf(matrix)[:2])[0] for matrix in A]
            multiplied = np.stack([inverse @ right for inverse, right in zip(inverses, b, strict=True)])
            for found, lapack in zip(run(A, b), (solved, multiplied), strict=True):
                assert found.dtype == dtype
                assert error(found, x) <= 3.0 * error(lapack, x), (np.dtype(dtype).name, condition)


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
        assert "dot_general" not in str(jax.make_jaxpr(derivative(lambda A: jax.vmap(eliminate)(A, A)))(A))
