"""Loops, branches, functions inside functions and derivatives of one's own, as scalars: as JAX has them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scalar_cases import Case, as_jax, evaluate

from twistax.scalar.derivatives import cotangent_program
from twistax.scalar.jax_primitive import Derived, call_program
from twistax.scalar.reader import scalarize

V = np.random.default_rng(0).normal(size=4)
ROWS = np.random.default_rng(1).normal(size=(5, 4))
K = np.array(2)


@jax.custom_jvp
def tilted(x: jax.Array) -> jax.Array:
    return jnp.sin(x)


tilted.defjvp(lambda p, t: (tilted(*p), 3.0 * jnp.cos(p[0]) * t[0]))


def amplified(factor: float) -> Any:
    """Equal in value, different in derivative."""

    @jax.custom_jvp
    def function(x: jax.Array) -> jax.Array:
        return 1.0 * x

    function.defjvp(lambda p, t: (function(*p), factor * t[0]))
    return function


def scaled_back(factor: float) -> Any:
    @jax.custom_vjp
    def function(x: jax.Array) -> jax.Array:
        return 1.0 * x

    function.defvjp(lambda x: (function(x), x), lambda x, c: (factor * c + 0.0 * x,))
    return function


def _total(body: Any, reverse: bool = False, length: int | None = None) -> Any:
    return lambda x, rows: lax.scan(body, x, rows, reverse=reverse, length=length)


def _turn(carry: jax.Array, row: jax.Array) -> tuple[jax.Array, jax.Array]:
    new = jnp.sin(carry) * row + carry[::-1]
    return new, new * carry


def _newton(x: jax.Array) -> jax.Array:
    return lax.while_loop(lambda s: jnp.abs(s * s - x) > 1e-9, lambda s: 0.5 * (s + x / s), x + 1.0)


def _endless(x: jax.Array) -> jax.Array:
    """Ends for positive numbers only."""
    return lax.while_loop(lambda s: s < 1.0, lambda s: s * 2.0, x)


def _long(x: jax.Array) -> jax.Array:
    return lax.fori_loop(0, 3000, lambda _, s: s + 1e-3 * jnp.sin(s), x)


_branches = [lambda x: jnp.sin(x), lambda x: x * x, lambda x: 1.0 / x]

CASES = [
    Case("scan", _total(_turn), (V, ROWS)),
    Case("scan backwards", _total(_turn, reverse=True), (V, ROWS)),
    Case(
        "scan with what is outside",
        lambda x, rows, a: lax.scan(lambda c, r: (c * a + r, (c.sum(), K)), x, rows),
        (V, ROWS, V[::-1]),
    ),
    Case("scan of nothing", lambda x: lax.scan(lambda c, _: (c * 2.0, c), x, None, length=0), (V,)),
    Case(
        "scan that counts",
        lambda x: lax.scan(lambda c, _: ((c[0] + 1, c[1] * (1.0 + c[0])), c[0]), (0, x), None, length=4),
        (V,),
    ),
    Case(
        "scan in a scan",
        lambda x: lax.scan(lambda c, _: (lax.scan(_turn, c, c[None])[0], None), x, None, length=3)[0],
        (V,),
    ),
    Case("scan too long to write out", _long, (V[:2],)),
    Case("for", lambda x: lax.fori_loop(0, 5, lambda i, s: s * x + i, x), (V,)),
    Case("for with rows put in", lambda x: lax.fori_loop(0, 4, lambda i, s: s.at[i].set(x[i] * s[i - 1]), x), (V,)),
    Case("map", lambda rows: lax.map(lambda r: jnp.sin(r).sum(), rows), (ROWS,)),
    Case("vmap", lambda rows, a: jax.vmap(lambda r: jnp.outer(r, a) @ r)(rows), (ROWS, V)),
    Case("associative scan", lambda x: lax.associative_scan(jnp.multiply, x), (V,)),
    Case("while", _newton, (np.float64(3.0),), reverse=False),
    Case(
        "while of arrays",
        lambda x: lax.while_loop(lambda s: s.max() < 9.0, lambda s: s * 1.7, jnp.abs(x)),
        (V,),
        reverse=False,
    ),
    Case(
        "branch known",
        lambda x: (lax.cond(True, jnp.sin, jnp.cos, x), lax.switch(1, _branches, x), lax.switch(9, _branches, x)),
        (V,),
    ),
    Case("branch taken", lambda x: lax.cond(x[0] > 0.0, jnp.sin, lambda v: v * x, x), (np.abs(V),)),
    Case("branch not taken", lambda x: lax.cond(x[0] > 0.0, jnp.sin, lambda v: v * x, x), (-np.abs(V),)),
    *[Case(f"switch {k}", lambda i, x: lax.switch(i, _branches, x), (np.array(k), V)) for k in (-3, 0, 1, 2, 7)],
    Case(
        "the other branch is not finite",
        lambda x: lax.cond(x > 0.0, lambda s: jnp.sqrt(s) * jnp.log(s) + 1.0 / s, lambda s: s * s, x),
        (np.float64(-2.0),),
    ),
    Case(
        "the other branch divides by zero",
        lambda x: lax.cond(x != 0.0, lambda s: jnp.sin(s) / s + s**-3, lambda s: 1.0 - s * s / 6.0, x),
        (np.float64(0.0),),
    ),
    Case(
        "branches in branches",
        lambda x: lax.cond(x > 0.0, lambda s: lax.cond(s > 1.0, jnp.log, jnp.sqrt, s), lambda s: s + 1.0, x),
        (np.float64(-1.0),),
    ),
    Case(
        "branches in branches, the inner one",
        lambda x: lax.cond(x < 0.0, lambda s: lax.cond(s > 1.0, jnp.log, jnp.tan, s), jnp.sqrt, x),
        (np.float64(-1.0),),
    ),
    Case(
        "a loop that would not end in the other branch",
        lambda x: lax.cond(x > 0.0, _endless, lambda s: s * s, x),
        (np.float64(-2.0),),
        reverse=False,
    ),
    Case("own derivative", tilted, (V,)),
    Case("own derivative, of a sum", lambda x: tilted(tilted(x) + x) * tilted(x[0]), (V,)),
    Case("own derivatives that differ", lambda x: (amplified(2.0)(x), amplified(5.0)(x), amplified(2.0)(x)), (V,)),
    Case("own derivative, of numbers", lambda x: tilted(jnp.arange(4.0)) * x, (V,)),
    Case("own reverse derivative", lambda x: scaled_back(2.0)(x) * scaled_back(5.0)(x) + x, (V,), forward=False),
    Case("functions inside", lambda x: jax.jit(lambda y: jax.jit(jnp.sin)(y) + jax.checkpoint(jnp.cos)(y))(x), (V,)),
    Case("checkpointed", lambda x: jax.grad(lambda y: jax.checkpoint(lambda z: jnp.sin(z).prod())(y))(x), (V,)),
    Case(
        "derivatives inside",
        lambda x: (jax.grad(lambda y: jnp.sin(y).prod())(x), jax.jacfwd(jnp.sin)(x), jax.hessian(jnp.prod)(x)),
        (V,),
    ),
    Case(
        "no derivative at an angle of zero",
        lambda x: jnp.where(x > 0.0, jnp.sin(jnp.where(x > 0.0, x, 1.0)) / jnp.where(x > 0.0, x, 1.0), 1.0 - x * x),
        (np.array([0.0, 1.0, -1.0]),),
    ),
    Case("stopped", lambda x: x * lax.stop_gradient(jnp.sin(x)), (V,)),
    Case("no arguments", lambda: (jnp.arange(3.0), jnp.sin(jnp.ones(()))), ()),
    Case(
        "integers and truth values",
        lambda n, c, x: (n + 1, ~c, jnp.where(c, x, n.astype(float)), n > 2),
        (K, np.array(True), V),
    ),
]


test_as_jax = as_jax(CASES)


def test_what_jax_refuses_is_refused() -> None:
    """Forward through a reverse rule, reverse through a loop of unknown length."""
    forward = scalarize(lambda x: [scaled_back(2.0)(x)], jax.ShapeDtypeStruct((4,), float))
    with pytest.raises(TypeError, match="custom_vjp"):
        jax.jvp(lambda x: call_program(Derived(forward), x), (V,), (V,))
    reverse = scalarize(lambda x: [_newton(x)], jax.ShapeDtypeStruct((), float))
    with pytest.raises(ValueError, match=r"Reverse-mode differentiation does not work for lax\.while_loop"):
        cotangent_program(reverse, [0])


def test_what_is_opaque_is_named_once_and_called() -> None:
    program = scalarize(lambda x: [_newton(x), jnp.sort(x * jnp.ones(3))], jax.ShapeDtypeStruct((), float))
    assert program.counts()["call"] == 2
    found = evaluate(program, np.float64(4.0))
    np.testing.assert_allclose(found[0], 2.0, rtol=1e-9)


def test_functions_of_equal_derivatives_are_called_once() -> None:
    program = scalarize(
        lambda x: [amplified(2.0)(x), amplified(2.0)(x), amplified(3.0)(x)], jax.ShapeDtypeStruct((), float)
    )
    assert program.counts()["call"] == 2


def test_functions_that_differ_in_a_callback_alone_are_two() -> None:
    """Same source, same derivative: only the function that NumPy computes tells them apart."""

    def raised(by: float) -> Any:
        @jax.custom_jvp
        def function(x: jax.Array) -> jax.Array:
            return jax.pure_callback(lambda v: np.asarray(v + by), jax.ShapeDtypeStruct(x.shape, x.dtype), x)

        function.defjvp(lambda p, t: (function(*p), t[0]))
        return function

    program = scalarize(lambda x: [raised(2.0)(x), raised(5.0)(x)], jax.ShapeDtypeStruct((), float))
    assert [float(v) for v in evaluate(program, np.float64(1.0))] == [3.0, 6.0]


def test_random_keys_are_the_arrays_of_their_numbers() -> None:
    keys = jax.random.split(jax.random.key(5))

    def noisy(x: jax.Array) -> jax.Array:
        own = jax.random.fold_in(jax.random.split(jax.random.key(3))[1], 7)
        return x * jax.random.normal(own, (3,)) + jax.random.uniform(keys[1], (3,))

    x = jnp.array([0.5, -1.0, 2.0])
    program = Derived(scalarize(lambda x: [noisy(x)], jax.ShapeDtypeStruct((3,), x.dtype)))
    inside = jax.jit(lambda x: call_program(Derived(scalarize(lambda x: [noisy(x)], jax.typeof(x))), x)[0])
    for transform in (lambda f: f, jax.jacfwd, jax.jacrev):
        for function in (lambda x: call_program(program, x)[0], inside):
            np.testing.assert_allclose(transform(function)(x), transform(noisy)(x), rtol=1e-15)
