"""Like operations of one body in vectors of a kernel."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fast_cases import close

import twistax as tx
from twistax.scalar.targets.llvm import kernel, machine_code

pytest.importorskip("llvmlite")


RANDOM = np.random.default_rng(5)


def test_like_operations_of_one_body_are_put_into_vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a product of matrices, of numbers of which each is driven by another; not of a body that turns."""
    packed: list[bool] = []

    def compiled(text: str, processor: Any, level: int, pack: bool) -> bytes:
        packed.append(pack)
        return machine_code.compiled(text, processor, level, pack)

    monkeypatch.setattr(kernel, "compiled", compiled)
    monkeypatch.setenv("TWISTAX_CACHE", "off")
    a, x = jnp.asarray(0.4 * RANDOM.normal(size=(5, 5))), jnp.asarray(RANDOM.normal(size=(5, 5)))

    def products(c: jax.Array) -> jax.Array:
        return a @ c + 0.1 * x

    def driven(c: jax.Array) -> jax.Array:
        return 0.9 * c + 0.1 * jnp.tanh(jnp.roll(c, 1, 0) * c)

    def turning(c: jax.Array) -> jax.Array:
        return c + 1e-3 * jnp.stack([c[1] * c[2], -2.0 * c[2] * c[0], c[0], c[0] + c[1] ** 2, jnp.sin(c[3])])

    def gated(c: jax.Array) -> jax.Array:
        kept = jnp.exp(-jnp.abs(c))
        return jnp.stack([c[0] - 0.1 * kept[0], kept[1] * c[0], kept[2] * kept[3] + 0.5, 0.9 * c[3], c[4] - c[0]])

    kinds = ((products, x, True), (driven, x[0], True), (gated, x[0], True), (turning, x[0], False))
    for step, start, found in kinds:
        packed.clear()
        own, plain = (
            f(lambda c, step=step: jax.lax.fori_loop(0, 900, lambda _, c: step(c), c)) for f in (tx.fast, jax.jit)
        )
        close(own(start), plain(start))
        assert (True in packed) == found, step
