"""Functions of the package that are one kernel each."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.scalar.kernel_function import KernelFunction

pytest.importorskip("llvmlite")


def function(a: Any, b: Any) -> tuple[Any, Any, Any]:
    powers = jax.lax.scan(lambda c, _: (c * b, c), b, length=2)[0]
    return jnp.sin(a) * b[:, None], a @ powers, a.T @ a


ARGUMENTS = np.array([[0.3, -0.8], [1.1, 0.4]]), np.array([0.7, -1.2])
KERNEL = KernelFunction(function, tx.Native())


def test_results_that_nothing_reads_are_not_computed() -> None:
    """Of three results one is used: the kernel has one, and the sines are gone."""
    text = jax.jit(lambda a, b: KERNEL(a, b)[1]).lower(*ARGUMENTS).as_text()
    call = next(line for line in text.splitlines() if "custom_call" in line)
    assert call.rpartition("->")[2].strip() == "tensor<1x2xf64>"
    assert "custom_call" not in jax.jit(lambda a, b: (KERNEL(a, b), a)[1]).lower(*ARGUMENTS).as_text()


@pytest.mark.parametrize("used", [(0,), (1,), (0, 2)])
def test_derivatives_of_some_results(used: tuple[int, ...]) -> None:
    """First and second derivatives, in batches, in forward and reverse passes, where other results are not used."""

    def some(of: Any) -> Any:
        return jax.checkpoint(lambda a, b: sum((jnp.sum(jnp.tanh(of(a, b)[k])) for k in used), jnp.zeros(())))

    results = []
    for of in (KERNEL, function):
        total = some(of)
        one = jax.jit(lambda a, b, f=total: (jax.grad(f)(a, b), jax.jacrev(jax.jacfwd(f, 1), 1)(a, b)))
        twice = jax.jit(lambda a, b, f=total: (jax.vmap(jax.grad(f, 1))(a, b), jax.vmap(jax.hessian(f, 1))(a, b)))
        batch = tuple(np.stack([x, 0.5 * x, -x, 2.0 * x]) for x in ARGUMENTS)
        results.append((one(*ARGUMENTS), twice(*batch)))
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-13), *results)
