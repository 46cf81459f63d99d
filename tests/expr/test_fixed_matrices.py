"""Solve with a matrix of parameters: inverted once for a whole loop, and nearly as accurate as by elimination."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

N = 6


@pytest.mark.parametrize("columns", [(), (3,)])
def test_the_residual_is_near_that_of_an_elimination(columns: tuple[int, ...]) -> None:
    """At a condition number of 1e10 and a solution of size 1 the inverse alone leaves far more, refined once 1e-13."""
    matrix, rhs = tx.Parameter("A", shape=(N, N)), tx.State("b", shape=(N, *columns))
    solution = jax.jit(tx.lower(tx.linalg.Solve(matrix, rhs)))
    for seed in range(50):
        rng = np.random.default_rng(seed)
        left, right = (np.linalg.qr(rng.normal(size=(N, N)))[0] for _ in range(2))
        A = left @ np.diag(np.logspace(0, -10, N)) @ right
        b = A @ rng.normal(size=(N, *columns))

        def residual(x: np.ndarray, A: np.ndarray = A, b: np.ndarray = b) -> float:
            return float(np.abs(A @ x - b).max() / np.abs(x).max())

        # n eps |A| |x|, |A| = 1. Source: Higham (2002), section 9.3.
        assert residual(np.linalg.inv(A) @ b) > 1e-10
        assert residual(np.asarray(solution(0.0, {"b": b}, None, {"A": A}))) < N * np.finfo(float).eps


def test_a_loop_inverts_it_once() -> None:
    A, b = tx.Parameter("A", shape=(N, N)), tx.State("b", shape=(N,))
    dynamics = tx.compile(tx.System(rates={b: tx.linalg.Solve(A, b)}))

    def loop(x: jax.Array, A: jax.Array) -> jax.Array:
        def step(x: jax.Array, _: None) -> tuple[jax.Array, None]:
            return x + 0.1 * dynamics.functions.vector_field(jnp.zeros(()), {"b": x}, {}, {"A": A})["b"], None

        return jax.lax.scan(step, x, None, length=100)[0]

    program = jax.jit(loop).lower(jnp.ones(N), jnp.eye(N)).compile().as_text()
    name = re.search(r"body=(%[\w.\-]+)", program)
    assert name is not None
    body = program[program.index(f"\n{name[1]} ") :].split("\n}")[0]
    assert "getrf" in program
    assert "custom-call" not in body
