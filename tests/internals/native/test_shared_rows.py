"""Kernels and programs of batches whose members share arguments."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.scalar.jax_primitive import Derived, call_program
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm import kernel

pytest.importorskip("llvmlite")


RANDOM = np.random.default_rng(3)


X, A = jnp.asarray(RANDOM.normal(size=3)), jnp.asarray(RANDOM.normal(size=(3, 3)) * 0.5)


XS, AS = jnp.asarray(RANDOM.normal(size=(5, 4, 3))), jnp.asarray(RANDOM.normal(size=(5, 4, 3, 3)) * 0.5)


def bent(x: jax.Array, a: jax.Array) -> jax.Array:
    return jnp.sin(a @ x) / (1.5 + x @ x) + jnp.where(x > 0.1, x * a[0], jnp.cos(x))


def wound(x: jax.Array, a: jax.Array) -> jax.Array:
    """A loop that contracts."""
    return jax.lax.fori_loop(0, 700, lambda k, c: jnp.cos(0.3 * a @ c) + 1e-3 * k * x, x)


def program(runner: Any) -> Callable[..., jax.Array]:
    derived = Derived(scalarize(lambda *a: [bent(*a)], X, A), None, runner)
    return lambda x, a: call_program(derived, x, a)[0]


WAYS = {
    "XLA": (program(None), bent),
    "kernel": (program(tx.Native(least=0).runner), bent),
    "loop": (tx.fast(wound), wound),
}


def _taken(a: jax.Array, batched: tuple[bool, bool]) -> jax.Array:
    """With the axes of those batches that it has."""
    for axis, has in enumerate(batched):
        a = a if has else jax.lax.slice_in_dim(a, 0, 1, axis=axis)
    return a.reshape(tuple(n for n, has in zip(a.shape[:2], batched, strict=True) if has) + a.shape[2:])


@pytest.mark.parametrize("way", WAYS)
def test_every_pattern_of_two_batches(way: str) -> None:
    """Each argument has the axis of the outer batch or not, and of the inner one or not; values and derivatives."""
    patterns = [
        (x, a)
        for x, a in itertools.product(itertools.product((True, False), repeat=2), repeat=2)
        if any(p for p, _ in (x, a)) and any(p for _, p in (x, a))
    ]

    def every(function: Callable[..., jax.Array]) -> Any:
        found = []
        for x, a in patterns:
            batched = function
            for level in (1, 0):
                batched = jax.vmap(batched, in_axes=tuple(0 if own[level] else None for own in (x, a)))
            point = _taken(XS, x), _taken(AS, a)

            def total(*own: jax.Array, batched: Any = batched) -> jax.Array:
                return jnp.sum(jnp.sin(batched(*own)))

            direction = jax.tree.map(jnp.cos, point)
            slope = jax.jvp(batched, point, direction)[1] if way != "loop" else batched(*point)
            found.append([batched(*point), slope, jax.grad(total, (0, 1))(*point)])
        return found

    own, other = WAYS[way]
    options = {"xla_backend_optimization_level": 0}
    found, expected = (jax.jit(lambda f=f: every(f), compiler_options=options)() for f in (own, other))
    for left, right in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(left, right, rtol=0, atol=1e-10 * max(1.0, float(jnp.abs(right).max())))


def test_what_all_share_is_read_from_one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []
    called = kernel.Kernel.__call__
    monkeypatch.setattr(
        kernel.Kernel, "__call__", lambda self, rows, *a, **o: given.append((rows, a)) or called(self, rows, *a, **o)
    )
    jax.jit(jax.vmap(WAYS["kernel"][0], in_axes=(0, None))).lower(XS[0], A)
    ((rows, (x, a)),) = given
    assert (rows, x.shape, a.shape) == (4, (4, 3), (1, 3, 3))
