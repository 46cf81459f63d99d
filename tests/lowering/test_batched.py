"""Members of a batch that share arguments, and loops of different lengths that share a kernel."""

import re
import tracemalloc
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

pytest.importorskip("llvmlite")

RANDOM = np.random.default_rng(3)
X, A = jnp.asarray(RANDOM.normal(size=3)), jnp.asarray(RANDOM.normal(size=(3, 3)) * 0.5)


# ---- what members of a batch share -----------------------------------------------------------------------------------


def test_a_table_that_is_shared_is_not_copied() -> None:
    table = jax.ShapeDtypeStruct((100_000, 3), float)

    def function(x: jax.Array, table: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda c, row: (0.5 * jnp.sin(c + row), None), x, table)[0]

    batched = jax.jit(jax.vmap(tx.fast(function), in_axes=(0, None)))
    compiled = batched.lower(jax.ShapeDtypeStruct((64, 3), float), table).compile()
    assert "twistax_" in compiled.as_text()
    assert compiled.memory_analysis().temp_size_in_bytes < 1e6  # a copy has 2.4e6, 64 of them 1.5e8
    rows, many = RANDOM.normal(size=(5, 3)), RANDOM.normal(size=(1000, 3))
    expected = [function(jnp.asarray(x), jnp.asarray(many)) for x in rows]
    np.testing.assert_allclose(batched(rows, many), expected, rtol=1e-12)


# ---- lengths of loops ------------------------------------------------------------------------------------------------


def _filtered(reverse: bool) -> Callable[..., Any]:
    def function(x: jax.Array, rows: jax.Array) -> Any:
        def step(c: jax.Array, u: jax.Array) -> Any:
            c = 0.9 * c + jnp.sin(u)
            return c, (c * u, c[:2] @ u[1:])

        return jax.lax.scan(step, x, rows, reverse=reverse)

    return function


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("rows", [None, 1, 7, 17])
def test_any_length(reverse: bool, rows: int | None) -> None:
    function = _filtered(reverse)
    own = tx.fast(function)
    batched = (lambda f: f) if rows is None else jax.vmap
    for length in (300, 301, 1000):
        x, u = RANDOM.normal(size=(rows or 1, 3)), RANDOM.normal(size=(rows or 1, length, 3))
        x, u = (x[0], u[0]) if rows is None else (x, u)
        found, expected = (jax.jit(batched(f))(x, u) for f in (own, function))
        for left, right in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(left, right, rtol=1e-11, atol=1e-12)


def test_lengths_share_a_kernel() -> None:
    own = jax.jit(tx.fast(_filtered(False)))
    texts = [own.lower(X, jax.ShapeDtypeStruct((n, 3), float)).as_text() for n in (300, 4000, 10**7)]
    targets = {target for text in texts for target in re.findall(r"twistax_\w+", text)}
    assert len(targets) == 1


def test_a_long_loop_takes_no_memory_to_compile() -> None:
    """Kernels are checked on short arrays."""
    own = jax.jit(tx.fast(lambda x, u: _filtered(True)(0.5 * x, 2.0 * u)))
    tracemalloc.start()
    try:
        assert "twistax_" in own.lower(X, jax.ShapeDtypeStruct((10**7, 3), float)).as_text()
        assert tracemalloc.get_traced_memory()[1] < 5e7  # one array has 2.4e8
    finally:
        tracemalloc.stop()


def test_arrays_of_another_length_are_refused() -> None:
    """What calls a kernel by its name, as exported programs do, cannot make it read beyond an end."""
    text = jax.jit(tx.fast(_filtered(False))).lower(X, jax.ShapeDtypeStruct((300, 3), float)).as_text()
    (target,) = set(re.findall(r"twistax_\w+", text))
    results = [jax.ShapeDtypeStruct((1, n), float) for n in (3, 900, 300)]

    def run(count: int, given: int, rows: int = 1) -> Any:
        call = jax.ffi.ffi_call(target, results)
        return jax.jit(call)(np.full((1, 1), count, np.int32), np.ones((rows, 3)), np.ones((1, given)))

    assert np.isfinite(run(300, 900)[0]).all()
    for count, given in ((301, 900), (300, 897), (-1, 900), (0, 900)):
        with pytest.raises(jax.errors.JaxRuntimeError, match="argument 2"):
            run(count, given)
    with pytest.raises(jax.errors.JaxRuntimeError, match="argument 1"):
        run(300, 900, 2)
