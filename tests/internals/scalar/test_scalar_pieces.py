"""Long programs are functions of their own, piece by piece: XLA works nothing out again across them."""

import re
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from twistax.scalar.derivatives import jacobian
from twistax.scalar.jax_primitive import Derived, call_program
from twistax.scalar.program import ScalarProgram
from twistax.scalar.reader import one_by_one, scalarize
from twistax.scalar.small_call import small_call
from twistax.scalar.targets import xla as emitter


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


def in_loop(step: Callable[[jax.Array], list[jax.Array]]) -> Callable[[jax.Array], list[jax.Array]]:
    """As flights have it: a loop that is one small function."""

    def each(x: jax.Array, _: None) -> tuple[jax.Array, list[jax.Array]]:
        found = step(x)
        return x + 1e-200 * found[0][:6], found

    return lambda x: [rows[0] for rows in small_call(lambda y: jax.lax.scan(each, y, None, length=1)[1], x)]


USES = {"alone": lambda step: step, "a batch": jax.vmap, "a batch in a loop": lambda step: jax.vmap(in_loop(step))}


@pytest.mark.parametrize("use", USES)
def test_results_that_share_do_not_share_by_repetition(use: str) -> None:
    program = scalarize(recursion, jax.ShapeDtypeStruct((6,), jnp.float64))
    derived = Derived(program)
    run = jax.jit(USES[use](lambda x: call_program(derived, x)))
    point = jnp.asarray(POINT) if use == "alone" else jnp.asarray(np.stack([POINT, POINT]))
    found = run.lower(point).compile()
    np.testing.assert_allclose(np.atleast_2d(found(point)[0])[0], recursion(jnp.asarray(POINT))[0], rtol=1e-12)
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


def waiting(program: ScalarProgram) -> float:
    """How many numbers that are there are needed later, on average, when nodes are worked out in their order."""
    g = program.graph
    place = {i: k for k, i in enumerate(program.live)}
    last = {i: k for i, k in place.items() if g.operation(i) is not None}
    for i, k in place.items():
        last.update({j: k for j in g.sources(i) if j in last})
    return sum(k - place[i] for i, k in last.items()) / len(place)


def test_results_one_by_one_keep_fewer_numbers_waiting() -> None:
    """Derivatives along many tangents come side by side; the same numbers come of another order."""
    shape = jax.ShapeDtypeStruct((6,), jnp.float64)
    program = scalarize(lambda x: recursion(x, 8), shape)
    slopes = program.restricted([np.array(list(jacobian(program, [0]).values()))])
    ordered = one_by_one(slopes)
    assert ordered.operations == slopes.operations
    assert waiting(ordered) < 0.6 * waiting(slopes)
    found, expected = (jax.jit(emitter.as_function(p))(jnp.asarray(POINT))[0] for p in (ordered, slopes))
    np.testing.assert_allclose(found, expected, rtol=1e-11)
