"""Programs with small calls in which something is never read. Run in a process of its own: XLA has ended it."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx
from twistax.scalar.small_call import small_call


def looped(x: jax.Array, y: jax.Array, key: jax.Array | None = None) -> tuple[jax.Array, jax.Array | None]:
    """A loop; y goes into what nobody needs, the key through as it is."""

    def run(start: jax.Array, empty: jax.Array) -> tuple[jax.Array, jax.Array | None]:
        _unneeded = (y + 1.0, y > 0.0, (y * 1j).imag, empty)
        return jax.lax.fori_loop(0, 9, lambda _, a: jnp.sin(a) + x, start), key

    return small_call(run, jnp.zeros(3), jnp.zeros((0, 2)))


def loop(x: jax.Array, y: jax.Array) -> jax.Array:
    """The numbers of `looped`."""
    return looped(x, y)[0]


def branch(x: jax.Array, y: jax.Array) -> jax.Array:
    """The same in a branch; the other one reads nothing at all."""
    return jax.lax.cond(x[0] > 0.0, loop, lambda x, y: jnp.ones(3), x, y)


def check(function: Callable[[jax.Array, jax.Array], jax.Array], x: jax.Array, y: jax.Array) -> None:
    """In a batch, in a loop, and differentiated twice."""
    wanted = loop(x, y)
    np.testing.assert_allclose(jax.jit(function)(x, y), wanted)
    np.testing.assert_allclose(jax.jit(jax.vmap(function, (0, None)))(jnp.ones((2, 3)), y), [wanted, wanted])
    value, change = jax.jit(lambda x, y: jax.jvp(function, (x, y), (x, y)))(x, y)
    np.testing.assert_allclose(value, wanted)
    assert jnp.isfinite(change).all()

    def once(x: jax.Array) -> jax.Array:
        return jax.jvp(lambda x: function(x, y), (x,), (x,))[1]

    np.testing.assert_allclose(jax.jit(lambda x: jax.jvp(once, (x,), (x,)))(x)[0], once(x))
    assert jnp.isfinite(jax.jit(lambda x: jax.lax.fori_loop(0, 3, lambda _, x: function(x, y), x))(x)).all()


def small_calls() -> None:
    """Alone and in a branch; with keys; of nothing."""
    x, y = jnp.ones(3), jnp.asarray(2.0)
    for function in (loop, branch):
        check(function, x, y)
    jax.jit(looped)(x, y, jax.random.key(0))
    jax.jit(lambda: small_call(lambda: jax.lax.fori_loop(0, 9, lambda _, a: jnp.sin(a), 1.0)))()


def rollout() -> None:
    """The gradient, in a branch, through implicit steps of rates that read no time."""
    w, k = tx.State("w", shape=(2,)), tx.Parameter("k", value=2.0)
    dynamics = tx.compile(tx.System(rates={w: -k * w}), backend=tx.XLA())

    def end(k: jax.Array) -> jax.Array:
        method = tx.ImplicitRKMK(tx.tableaus.IMPLICIT[0])
        given = {"k": k}
        saved = tx.integrate(dynamics, {"w": np.ones(2)}, t1=1.0, steps=3, params=given, method=method, save_at=[0.4])
        return saved.xs["w"].sum()

    k0, step = jnp.asarray(2.0), 1e-6
    found = jax.jit(lambda k: jax.lax.cond(k > 1.0, jax.grad(end), lambda k: k, k))(k0)
    np.testing.assert_allclose(found, (end(k0 + step) - end(k0 - step)) / (2.0 * step), rtol=1e-5)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    small_calls()
    rollout()
