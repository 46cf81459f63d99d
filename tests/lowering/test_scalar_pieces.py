"""Long programs are functions of their own, piece by piece: XLA works nothing out again across them."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from twistax.lowering.scalar import emitter
from twistax.lowering.scalar.primitive import Derived, call_program
from twistax.lowering.scalar.program import scalarize


def recursion(x: jax.Array, length: int = 20) -> list[jax.Array]:
    """Results, each of which needs all that the one before needs."""
    results = []
    for _ in range(length):
        x = jnp.sin(x) * jnp.roll(x, 1) - 0.5 * x
        results.append(jnp.sum(x))
    return [jnp.stack(results)]


POINT = np.random.default_rng(3).normal(size=6)


def operations_of(compiled: str) -> int:
    return len(re.findall(r" (?:multiply|add|subtract|sine)\(", compiled))


def test_results_that_share_do_not_share_by_repetition() -> None:
    program = scalarize(recursion, jax.ShapeDtypeStruct((6,), jnp.float64))
    run = jax.jit(lambda x: call_program(Derived(program), x))
    found = run.lower(jnp.asarray(POINT)).compile()
    np.testing.assert_allclose(found(jnp.asarray(POINT))[0], recursion(jnp.asarray(POINT))[0], rtol=1e-12)
    if jax.default_backend() == "cpu":
        assert operations_of(found.as_text()) < 3 * program.operations


def test_pieces_of_any_length_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with a call of what has no scalars in between."""

    def function(x: jax.Array) -> list[jax.Array]:
        first = recursion(x, 3)[0]
        ordered = jnp.sort(first * x[0])
        return [recursion(ordered, 3)[0] + first, ordered]

    program = scalarize(function, jax.ShapeDtypeStruct((6,), jnp.float64))
    expected = function(jnp.asarray(POINT))
    for length in (7, 10_000):
        monkeypatch.setattr(emitter, "_PIECE", length)
        found = jax.jit(jax.vmap(emitter.as_function(program)))(jnp.asarray(POINT)[None])
        for own, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(own[0], other, rtol=1e-11)
