"""Functions of matrices as loops in kernels, beside JAX: products, factors, solutions, reductions and loops."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

pytest.importorskip("llvmlite")

from twistax.scalar.targets.llvm.arrays.body import ArrayBody, array_form
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.machine_code import Processor

pytestmark = pytest.mark.thorough

RANDOM = np.random.default_rng(0)


def drawn(*shape: int) -> Any:
    return RANDOM.normal(size=shape)


def positive(n: int, *stack: int) -> Any:
    a = RANDOM.normal(size=(*stack, n, n))
    return a @ np.swapaxes(a, -1, -2) / n + np.eye(n)


def agrees(function: Callable[..., Any], *arguments: Any) -> None:
    """One member alone, and more members than lanes, in both precisions."""
    for dtype, tolerance in ((np.float64, 1e-11), (np.float32, 2e-4)):
        values = [np.asarray(a, dtype) for a in arguments]
        processor, form = Processor.host(), array_form(jax.make_jaxpr(function)(*values), False)
        for lanes in (1, processor.lanes(form.dtype)):
            rows = 1 if lanes == 1 else lanes + 3
            batch = [np.stack([a * dtype(1.0 + 0.1 * i) for i in range(rows)]) for a in values]
            kernel = HostKernel(ArrayBody(form, lanes), processor)
            results = kernel.run([batch[k].reshape(rows, -1) for k in kernel.body.read])
            expected = jax.tree.leaves(jax.jit(jax.vmap(function))(*batch))
            for k, result in zip(kernel.body.written, results, strict=True):
                size = np.max(np.abs(expected[k]), initial=1.0)
                np.testing.assert_allclose(result, expected[k].reshape(rows, -1), atol=tolerance * size, rtol=0.0)


@pytest.mark.parametrize(("m", "k", "n"), [(12, 17, 12), (33, 2, 20), (1, 30, 1)])
def test_products(m: int, k: int, n: int) -> None:
    def products(a: Any, at: Any, b: Any, bt: Any, x: Any) -> Any:
        pairs = itertools.product((a, at.T), (b, bt.T))
        return [one @ other for one, other in pairs], a @ x, at.T @ x, x @ b, jnp.outer(x, x)

    agrees(products, drawn(m, k), drawn(k, m), drawn(k, n), drawn(n, k), drawn(k))


def test_products_along_several_axes() -> None:
    def products(a: Any, b: Any, c: Any) -> Any:
        return jnp.einsum("iajb,jbk->iak", a, b), jnp.einsum("bij,bkj->bik", c, c)

    agrees(products, drawn(3, 6, 4, 2), drawn(4, 2, 5), drawn(3, 6, 7))


@pytest.mark.parametrize("n", [5, 17])
def test_factors_and_solutions(n: int) -> None:
    def solved(a: Any, b: Any, x: Any) -> Any:
        factor = jax.scipy.linalg.cho_factor(a)
        return (
            jnp.linalg.cholesky(a),
            lax.linalg.lu(a + 3.0 * jnp.triu(a.T @ a)),
            jnp.linalg.solve(a, x),
            (
                jax.scipy.linalg.cho_solve(factor, b),
                jnp.linalg.solve(a, b),
            ),
        )

    agrees(solved, positive(n), drawn(n, 3), drawn(n))


@pytest.mark.parametrize(("left", "lower"), list(itertools.product((False, True), repeat=2)))
def test_triangles(left: bool, lower: bool) -> None:
    n = 13
    triangle = np.tril(0.1 * drawn(n, n)) + 1.5 * np.eye(n)

    def solved(a: Any, b: Any) -> Any:
        pairs = itertools.product((False, True), repeat=2)
        options = [{"transpose_a": t, "unit_diagonal": u} for t, u in pairs]
        return [lax.linalg.triangular_solve(a, b, left_side=left, lower=lower, **o) for o in options]

    agrees(solved, triangle if lower else triangle.T, drawn(n, 6) if left else drawn(6, n))


def test_stacks_of_factors() -> None:
    agrees(lambda a, b: (jnp.linalg.cholesky(a), lax.linalg.lu(b)), positive(6, 4), drawn(3, 2, 7, 7))


def test_branches() -> None:
    def function(a: Any, x: Any) -> Any:
        kind = (jnp.abs(x[0]) * 40.0).astype(int) - 1
        branches = (lambda a: a @ a.T, lambda a: a.T, lambda a: jnp.tanh(a) + a[:1])
        return lax.switch(kind, branches, a), a @ x

    agrees(function, drawn(20, 20), 0.03 * np.ones(20))


def test_entries_sums_and_places() -> None:
    def function(a: Any, b: Any, c: Any) -> Any:
        chosen = jnp.where(a > 0.0, jnp.sin(a), jnp.exp(-jnp.abs(a)) * c[:, None])
        sums = a.sum(0), a.sum(1), a.max(1), a.min(0), a.prod(1), a.sum(), (a > 0.0).any(1).astype(a.dtype)
        moved = jnp.concatenate([a, a[:, ::2]], 1), jnp.pad(a, ((1, 2), (0, 3))), a[2:7, 1:].reshape(-1), a.T[:, 3]
        where = (100.0 * jnp.abs(c[:8])).astype(int)
        where = jnp.where(where > 6, 6, where)
        placed = a[where], a.at[where].add(2.0 * a[:8], mode="clip"), lax.dynamic_slice(a, (where[0], where[1]), (3, 4))
        beyond = jnp.where(where > 3, where + 9, where)
        dropped = a.at[beyond].add(2.0 * a[:8]), a.at[beyond[0] - 12].set(a[1])
        updated = lax.dynamic_update_slice(a, a[:2, :2], (where[2], where[3]))
        return chosen, sums, moved, placed, dropped, updated, jnp.stack([a, 2.0 * a], 1), a @ b, jnp.tril(a)

    agrees(function, drawn(9, 11), drawn(11, 2), drawn(9))


def test_loops() -> None:
    def function(a: Any, x: Any, rows: Any) -> Any:
        def forth(c: Any, row: Any) -> Any:
            return jnp.tanh(a @ c + row), c.sum() + row

        def back(c: Any, row: Any) -> Any:
            total, one, other = c
            return (total + jnp.outer(one, row), jnp.tanh(a @ other + row), one), one

        start = (jnp.zeros_like(a), x, 2.0 * x)
        return lax.scan(forth, x, rows), lax.scan(back, start, rows, reverse=True)

    agrees(function, drawn(20, 20), drawn(20), drawn(6, 20))
