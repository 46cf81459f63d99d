"""The loop of steps behind derivatives: a plain loop's values and slopes, in little memory, for any bound."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from twistax.integrators.loop.checkpointed import take_steps

State = dict[str, jax.Array]


def step(y: State, own: dict[str, jax.Array]) -> State:
    """A step that mixes all entries and depends on which one it is."""
    a, b = y["a"], y["b"]
    return {"a": a + own["h"] * jnp.roll(jnp.sin(a), 1) * b, "b": b + own["h"] * jnp.cos(own["t"] + jnp.sum(a))}


def each(bound: int, h: jax.Array) -> dict[str, jax.Array]:
    k = jnp.arange(bound, dtype=jnp.float64)
    return {"t": k * h, "h": h * (1.0 + 0.3 * jnp.sin(k))}


def start() -> State:
    return {"a": jnp.array([0.3, -0.5, 0.9]), "b": jnp.array(0.7)}


def plain(y: State, h: jax.Array, count: jax.Array, bound: int) -> tuple[State, State]:
    """The end, and all values, of a loop over `bound` steps of which those beyond the count change nothing."""

    def one(y: State, entry: tuple[jax.Array, dict[str, jax.Array]]) -> tuple[State, State]:
        k, own = entry
        return jax.tree.map(lambda new, old: jnp.where(k < count, new, old), step(y, own), y), y

    end, before = jax.lax.scan(one, y, (jnp.arange(bound), each(bound, h)))
    return end, jax.tree.map(lambda a, last: jnp.concatenate([a, last[None]]), before, end)


def weighed(tree: Any) -> jax.Array:
    """A number in which every entry counts differently."""
    parts = [
        jnp.sum(leaf * jnp.cos(1.0 + jnp.arange(leaf.size, dtype=jnp.float64)).reshape(leaf.shape))
        for leaf in jax.tree.leaves(tree)
    ]
    return functools.reduce(jnp.add, parts)


@pytest.mark.parametrize(
    ("bound", "record"),
    [
        *((1, True), (15, True), (16, True), (17, True), (2000, True), (1, False), (17, False), (2000, False)),
        pytest.param(300, True, marks=pytest.mark.slow),  # as many levels as 2000
    ],
)
def test_values_and_derivatives_are_those_of_a_plain_loop(bound: int, record: bool) -> None:
    h = jnp.asarray(1.0 / bound)
    direction = (jax.tree.map(jnp.cos, start()), jnp.asarray(0.3 / bound))

    def ours(y: State, h: jax.Array, count: jax.Array) -> Any:
        return take_steps(step, y, each(bound, h), count, bound, record)

    def theirs(y: State, h: jax.Array, count: jax.Array) -> Any:
        end, every = plain(y, h, count, bound)
        return end, every if record else None

    @jax.jit
    def looked_at(count: jax.Array) -> tuple[Any, Any]:
        def reverse_of(loop: Callable[..., Any]) -> Any:
            return loop(start(), h, count), jax.grad(lambda y, h: weighed(loop(y, h, count)), argnums=(0, 1))(
                start(), h
            )

        forward = jax.jvp(lambda y, h: weighed(ours(y, h, count)), (start(), h), direction)[1]
        return (*reverse_of(ours), forward), reverse_of(theirs)

    for count in sorted({0, 1, bound // 2, bound - 1, bound}):
        (values, reverse, forward), (wanted, slopes) = looked_at(jnp.asarray(count))
        assert jax.tree.structure(values) == jax.tree.structure(wanted)
        jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-14), values, wanted)
        jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-10, atol=1e-12), reverse, slopes)
        along = sum(jnp.sum(a * b) for a, b in zip(*map(jax.tree.leaves, (slopes, direction)), strict=True))
        np.testing.assert_allclose(forward, along, rtol=1e-10, atol=1e-12)


def test_second_derivatives_are_those_of_a_plain_loop() -> None:
    h, count, bound = jnp.asarray(0.03), jnp.asarray(33), 40

    def curvature(cost: Callable[[jax.Array], jax.Array], modes: tuple[Any, ...]) -> list[jax.Array]:
        return [jax.jit(mode(jax.grad(cost)))(start()["a"]) for mode in modes]

    def cost(a: jax.Array) -> jax.Array:
        return weighed(take_steps(step, start() | {"a": a}, each(bound, h), count, bound, False)[0])

    (wanted,) = curvature(lambda a: weighed(plain(start() | {"a": a}, h, count, bound)[0]), (jax.jacfwd,))
    for one in curvature(cost, (jax.jacfwd, jax.jacrev)):
        np.testing.assert_allclose(one, wanted, rtol=1e-10, atol=1e-13)


def scratch(loop: Callable[[jax.Array, int], jax.Array], steps: int) -> int:
    """Bytes of scratch memory that the gradient of a loop takes."""
    compiled = jax.jit(jax.grad(loop), static_argnums=1).lower(jnp.ones(100), steps).compile()
    return int(compiled.memory_analysis().temp_size_in_bytes)


def test_memory_does_not_grow_with_the_steps() -> None:
    """From a thousand to sixteen thousand steps: a plain loop takes sixteen times as much, this one about four."""

    def one(y: jax.Array, h: jax.Array) -> jax.Array:
        return y + h * jnp.sin(jnp.roll(y, 1) * y)

    def written_out(y: jax.Array, steps: int) -> jax.Array:
        return jnp.sum(jax.lax.scan(lambda y, h: (one(y, h), None), y, jnp.full(steps, 1e-3))[0])

    def checkpointed(y: jax.Array, steps: int) -> jax.Array:
        return jnp.sum(take_steps(one, y, jnp.full(steps, 1e-3), jnp.asarray(steps), steps, False)[0])

    few, many = (scratch(checkpointed, n) for n in (1_000, 16_000))
    plain_few, plain_many = (scratch(written_out, n) for n in (1_000, 16_000))
    assert plain_many > 12 * plain_few
    assert many < 6 * few
    assert many < 0.1 * plain_many


@pytest.mark.parametrize("batched", [False, True], ids=["alone", "batch"])
def test_blocks_beyond_the_count_are_passed_over(batched: bool) -> None:
    """Steps that are computed are counted on the host: in a batch up to the largest count, and a block at most more."""
    calls: list[int] = []

    def one(y: jax.Array, own: jax.Array) -> jax.Array:
        jax.debug.callback(lambda _: calls.append(1), own)
        return y + own

    def solve(y: jax.Array, count: jax.Array) -> jax.Array:
        return take_steps(one, y, jnp.ones(2000), count, 2000, False)[0]

    if batched:
        ends = jax.jit(jax.vmap(solve))(jnp.zeros(3), jnp.array([5, 40, 17]))
        np.testing.assert_array_equal(ends, [5.0, 40.0, 17.0])
    else:
        assert float(jax.jit(solve)(jnp.zeros(()), jnp.asarray(40))) == 40.0
    jax.effects_barrier()
    assert 40 <= len(calls) <= (3 * 48 if batched else 48)
