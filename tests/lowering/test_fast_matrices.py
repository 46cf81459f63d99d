"""`tx.fast` of larger arrays: matrices in loops, long chains as scalars."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

pytest.importorskip("llvmlite")

RANDOM = np.random.default_rng(0)
A = jnp.asarray(0.9 * np.eye(12) + 0.05 * RANDOM.normal(size=(12, 12)))
B = jnp.asarray(RANDOM.normal(size=(12, 4)))
P = jnp.eye(12)


def riccati(P: jax.Array, A: jax.Array, B: jax.Array) -> jax.Array:
    """The cost to go one step before, of a linear-quadratic regulator with unit weights."""
    S = jnp.eye(B.shape[1], dtype=P.dtype) + B.T @ P @ B
    K = jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(S), B.T @ P @ A)
    return jnp.eye(len(P), dtype=P.dtype) + A.T @ P @ (A - B @ K)


def joint(q: jax.Array, i: int) -> jax.Array:
    c, s, o, z = jnp.cos(q), jnp.sin(q), jnp.ones_like(q), jnp.zeros_like(q)
    if i % 2:
        return jnp.array([[c, -s, z, 0.1 * o], [s, c, z, z], [z, z, o, 0.2 * o], [z, z, z, o]])
    return jnp.array([[o, z, z, 0.1 * o], [z, c, -s, z], [z, s, c, 0.2 * o], [z, z, z, o]])


def placements(q: jax.Array) -> jax.Array:
    """Those of the links of a chain."""
    T, links = jnp.eye(4, dtype=q.dtype), []
    for i in range(len(q)):
        T = T @ joint(q[i], i)
        links.append(T)
    return jnp.stack(links)


def sum_of_squares(*arguments: Any) -> jax.Array:
    return jnp.sum(riccati(*arguments) ** 2)


def test_a_riccati_step_is_one_kernel_with_its_derivatives() -> None:
    """Warnings are errors here: it gains."""
    assert tx.fast(riccati).explain(P, A, B).startswith("native: loops over arrays")
    tangents = (0.1 * A, 0.1 * A @ A, 0.1 * B)
    for function in (riccati, jax.grad(sum_of_squares, (0, 1, 2))):
        for one, other in zip(*map(jax.tree.leaves, (tx.fast(function)(P, A, B), function(P, A, B))), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)
    for one, other in (
        (jax.jvp(tx.fast(riccati), (P, A, B), tangents)[1], jax.jvp(riccati, (P, A, B), tangents)[1]),
        (jax.grad(lambda A: jnp.sum(tx.fast(riccati)(P, A, B) ** 2))(A), jax.grad(sum_of_squares, 1)(P, A, B)),
    ):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_batches_and_single_precision() -> None:
    many = jnp.stack([c * P for c in np.linspace(0.5, 2.0, 21)])
    expected = jax.vmap(riccati, (0, None, None))(many, A, B)
    np.testing.assert_allclose(jax.vmap(tx.fast(riccati), (0, None, None))(many, A, B), expected, rtol=1e-11)
    np.testing.assert_allclose(tx.fast(jax.vmap(riccati, (0, None, None)))(many, A, B), expected, rtol=1e-11)
    single = tx.fast(riccati)(*(a.astype(jnp.float32) for a in (P, A, B)))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, riccati(P, A, B), rtol=2e-5, atol=2e-5)


def test_repeated_riccati_steps_are_one_kernel() -> None:
    def repeated(P: jax.Array, A: jax.Array, B: jax.Array) -> Any:
        return jax.lax.scan(lambda P, _: (riccati(P, A, B), jnp.trace(P)), P, None, length=60)

    assert tx.fast(repeated).explain(P, A, B).startswith("scan: native: loops over arrays")
    for one, other in zip(tx.fast(repeated)(P, A, B), repeated(P, A, B), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)


def test_a_state_that_adds_to_itself_is_computed_once() -> None:
    """Of 169 entries, which is no whole number of vectors: the last one reaches back."""

    def grown(x: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda x, _: (x + 0.01 * x @ x, None), x, None, length=100)[0]

    x = jnp.asarray(0.1 * np.random.default_rng(0).normal(size=(13, 13)))
    assert tx.fast(grown).explain(x).startswith("scan: native: loops over arrays")
    np.testing.assert_allclose(tx.fast(grown)(x), grown(x), rtol=1e-12, atol=1e-13)


def test_a_long_chain_is_scalars_although_its_placements_are_a_large_array() -> None:
    q = jnp.asarray(RANDOM.normal(size=10))
    assert tx.fast(placements).explain(q).startswith("native: ")
    np.testing.assert_allclose(tx.fast(placements)(q), placements(q), atol=1e-13)
    slope = tx.fast(jax.grad(lambda q: jnp.sum(placements(q) ** 2)))
    np.testing.assert_allclose(slope(q), jax.grad(lambda q: jnp.sum(placements(q) ** 2))(q), rtol=1e-9, atol=1e-9)


def test_diagonals_and_traces_are_scalars() -> None:
    """JAX writes them as a branch by platform."""

    def function(a: jax.Array) -> jax.Array:
        return jnp.diag(jnp.sin(a @ a)) + jnp.trace(jnp.cos(a) @ a)

    a = jnp.asarray(np.random.default_rng(3).normal(size=(6, 6)))
    assert "native" in tx.fast(function).explain(a)
    np.testing.assert_allclose(tx.fast(function)(a), jax.jit(function)(a), rtol=1e-12)
    np.testing.assert_allclose(jax.jacrev(tx.fast(function))(a), jax.jacfwd(function)(a), atol=1e-11)


def test_a_loop_whose_end_depends_on_its_values_stays_one_of_jax() -> None:
    """It may not end for the arguments of a self-test."""

    def squared(a: jax.Array) -> jax.Array:
        return jax.lax.while_loop(lambda m: jnp.abs(m).max() < 1e3, lambda m: m @ m, a @ a)

    assert "while, executed by JAX" in tx.fast(squared).explain(A)
