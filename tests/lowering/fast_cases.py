"""Functions of arrays with loops, for the tests of `tx.fast`."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

RANDOM = np.random.default_rng(5)
A = jnp.asarray(RANDOM.normal(size=(3, 3)) * 0.5)
X = jnp.asarray(RANDOM.normal(size=3))
MANY = jnp.asarray(RANDOM.normal(size=(700, 3)))
#: More than is unrolled, and no multiple of anything.
LENGTH = 701


def recursion(a: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Carried, scanned over and stacked."""

    def body(c: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        c = jnp.sin(a @ c) + u
        return c, jnp.stack([c.sum(), c[0] * u[1]])

    return jax.lax.scan(body, x, MANY.astype(x.dtype))


def backwards(a: jax.Array, x: jax.Array) -> Any:
    return jax.lax.scan(lambda c, u: (0.9 * c + u, c @ a), x, MANY.astype(x.dtype), reverse=True)


def counted(a: jax.Array, x: jax.Array, length: int = LENGTH) -> jax.Array:
    """By `fori_loop`, with the number of the iteration."""
    return jax.lax.fori_loop(0, length, lambda k, c: jnp.cos(a @ c) + 1e-3 * k, x)


def until(a: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """As many iterations as it takes."""

    def going(state: Any) -> jax.Array:
        return (jnp.abs(state[0]).max() > 1e-3) & (state[1] < 5000)

    return jax.lax.while_loop(going, lambda s: (0.99 * (s[0] + 0.01 * a @ jnp.sin(s[0])), s[1] + 1), (x, 0))


def mixed(a: jax.Array, x: jax.Array) -> dict[str, Any]:
    """Integers, truth values and tuples are carried; constants are folded; what is before and after is straight."""
    zeros, many = jnp.zeros((2, 3), x.dtype).at[0, 1].set(2.0), MANY.astype(x.dtype)

    def body(state: Any, row: Any) -> Any:
        count, flag, (c, d) = state
        c = jnp.where(flag, a @ c, c + row["u"]) * 0.5
        new = (count + jnp.where(c[0] > 0, 2, 1), ~flag | (c[1] > 0.1), (c, zeros @ c + d * 0.1))
        return new, {"count": count, "flag": flag, "c": jnp.outer(c, c)}

    start = (3, x[0] > 0, (jnp.tanh(a) @ x, jnp.zeros(2, x.dtype)))
    end, rows = jax.lax.scan(body, start, {"u": many, "k": jnp.arange(len(many))})
    return {"end": end, "rows": rows, "after": jnp.linalg.det(a) * end[2][0], "none": None}


def two_in_a_row(a: jax.Array, x: jax.Array) -> jax.Array:
    """The second loop takes what the first one gives, through a call and a branch."""
    first = jax.jit(recursion)(a, x)[0]
    return jax.lax.cond(first[0] > 10.0, lambda c: c, lambda c: counted(a, c), first) @ backwards(a, first)[1].sum(0)


def nested(a: jax.Array, x: jax.Array) -> jax.Array:
    """A loop inside of a loop that is too long to be unrolled."""

    def outer(c: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.lax.fori_loop(0, 100, lambda k, d: jnp.sin(a @ d) + 0.1 * u, c), c.sum()

    return jax.lax.scan(outer, x, MANY[:40].astype(x.dtype))[1]


def around_others(a: jax.Array, x: jax.Array) -> Any:
    """As many iterations as it takes, with loops in the question and in the answer."""

    def going(state: Any) -> jax.Array:
        size = jax.lax.fori_loop(0, 3000, lambda k, s: 0.9999 * s, jnp.abs(state[0]).max())
        return (size > 1e-3 * jnp.abs(x).max()) & (state[1] < 5)

    def body(state: Any) -> Any:
        return jax.lax.fori_loop(0, LENGTH, lambda k, c: 0.998 * jnp.sin(c + 0.001 * a @ c), state[0]), state[1] + 1

    return jax.lax.while_loop(going, body, (x, 0))


def straight(a: jax.Array, x: jax.Array) -> jax.Array:
    """No loops."""
    for _ in range(12):
        x = jnp.sin(a @ x) + jnp.linalg.solve(a + 3.0 * jnp.eye(3, dtype=a.dtype), x)
    return x


def small_loop(a: jax.Array, x: jax.Array) -> jax.Array:
    """A loop that is unrolled."""
    return jax.lax.scan(lambda c, u: (jnp.sin(a @ c) + u, c[0]), x, MANY[:7].astype(x.dtype))[1]


FUNCTIONS = [recursion, backwards, counted, until, mixed, two_in_a_row, nested, around_others, straight, small_loop]
#: Those with a derivative in reverse.
SMOOTH = [recursion, backwards, counted, two_in_a_row, nested, straight, small_loop]
every = pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
smooth = pytest.mark.parametrize("function", SMOOTH, ids=lambda f: f.__name__)


def close(found: Any, expected: Any, tolerance: float = 1e-12) -> None:
    """Of one structure, with the same types, equal to rounding."""
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for own, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert own.dtype == other.dtype
        assert own.shape == other.shape
        scale = float(jnp.abs(other).max()) if other.size and other.dtype.kind == "f" else 1.0
        np.testing.assert_allclose(own, other, rtol=0, atol=tolerance * scale)


def around(a: jax.Array, rows: int) -> jax.Array:
    """Arrays that differ a little."""
    return jnp.asarray(np.asarray(a) + 0.1 * RANDOM.normal(size=(rows, *a.shape)))


def scalar(function: Callable[..., Any]) -> Callable[..., jax.Array]:
    """The sum of all results."""

    def total(a: jax.Array, x: jax.Array) -> jax.Array:
        real = [leaf for leaf in jax.tree.leaves(function(a, x)) if leaf.dtype == a.dtype]
        return sum((jnp.sum(leaf * jnp.cos(leaf)) for leaf in real), jnp.zeros((), a.dtype))

    return total
