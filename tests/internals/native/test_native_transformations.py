"""Kernels inside of JAX: batches of every size, transformations, derivatives, threads."""

import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from transformations import agree, transformed

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import at_every_width

import twistax as tx
from twistax.scalar.jax_primitive import Derived, call_program
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm.machine_code import Processor
from twistax.scalar.targets.llvm.straight.body import Straight

RNG = np.random.default_rng(0)
X, A = RNG.normal(size=3), RNG.normal(size=(3, 3))
XS, AS = RNG.normal(size=(4, 3)), RNG.normal(size=(4, 3, 3))
TEN = RNG.normal(size=(40, 10))


def bent(x: jax.Array, a: jax.Array) -> jax.Array:
    """Products, divisions, a branch, functions of the C library, sines of sines."""
    y = jnp.sin(a @ x) / (1.5 + x @ x) + jnp.cos(jnp.sin(x)) * jnp.tanh(a[:, 0])
    return jnp.where(x > 0.1, y * jnp.sqrt(1.0 + y * y), jnp.maximum(y, -0.3))


def native(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """A function as a kernel, one program for each set of types."""
    programs: dict[Any, Derived] = {}

    def called(*arguments: jax.Array) -> Any:
        shapes = [jax.ShapeDtypeStruct(jnp.shape(a), jnp.result_type(a)) for a in arguments]
        key = str(shapes)
        if key not in programs:
            program = scalarize(lambda *v: jax.tree.leaves(function(*v)), *shapes)
            programs[key] = tx.Native(least=0, **options).derived(program)
            assert programs[key].runner is not None
        found = call_program(programs[key], *map(jnp.asarray, arguments))
        return found[0] if len(found) == 1 else found

    return called


def test_under_transformations() -> None:
    function = native(bent)
    both = jax.jit(
        lambda *arguments: [transformed(f)(*arguments) for f in (function, bent)],
        compiler_options={"xla_backend_optimization_level": 0},
    )
    agree(*both(X, A, XS, AS))
    jaxpr = str(jax.make_jaxpr(jax.vmap(jax.grad(lambda x: function(x, A).sum())))(XS))
    assert "native_program" in jaxpr
    assert "custom_call" in jax.jit(jax.vmap(jax.hessian(lambda x: function(x, A).sum()))).lower(XS).as_text()


def test_derivatives_against_differences() -> None:
    function, h = native(bent), 1e-4
    slopes = jax.jit(jax.jacfwd(function))(X, A)
    steps = h * np.concatenate([k * np.eye(3) for k in (1, -1, 2, -2)])
    p, m, pp, mm = np.split(jax.jit(jax.vmap(function, (0, None)))(X + steps, A), 4)
    np.testing.assert_allclose(slopes.T, (8 * (p - m) - (pp - mm)) / (12 * h), atol=1e-10)


def wide(x: jax.Array) -> list[jax.Array]:
    """Results of many lengths, so that rows are written in every way."""
    y = jnp.sin(x) * x[0]
    return [y[:1], y[:3], y, jnp.concatenate([y, x, y[2:5]]), (x > 0.0)[:5], jnp.argmax(x[:2]), jnp.zeros((0, 2))]


@at_every_width
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_any_number_of_bodies(dtype: Any, processor: Processor, monkeypatch: pytest.MonkeyPatch) -> None:
    """None, one, remainders of all lengths: each body bit by bit as in any other batch, and as by itself."""
    monkeypatch.setattr(Processor, "host", lambda: processor)
    function, rows = native(wide), TEN.astype(dtype)
    expected = jax.vmap(lambda x: jax.tree.leaves(wide(x)))(rows)
    everything = jax.vmap(function)(rows)
    for own, other in zip(everything, expected, strict=True):
        assert (own.shape, own.dtype) == (other.shape, other.dtype)
        np.testing.assert_allclose(own, other, rtol=1e-5 if dtype == np.float32 else 1e-13)
    sizes = range(21)
    found = jax.jit(lambda r: [jax.vmap(function)(r[: n + 3][3:]) for n in sizes])(rows)
    for n in sizes:
        for own, other in zip(found[n], everything, strict=True):
            np.testing.assert_array_equal(own, np.asarray(other)[3 : n + 3])
    for own, other in zip(function(rows[5]), everything, strict=True):
        np.testing.assert_array_equal(own, np.asarray(other)[5])


@pytest.mark.parametrize("threads", [1, 3, None])
def test_threads(threads: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of a few rows, many of them, calls beside each other: the result does not depend on who worked it out."""
    monkeypatch.setattr(Straight, "_CHUNK", 1)
    function = native(lambda x: jnp.sin(x) @ x, threads=threads)
    rows = RNG.normal(size=(5003, 6))
    together = jax.jit(lambda r: [jax.vmap(function)(k * r) for k in (1.0, 2.0, 3.0)])
    for _ in range(5):
        for k, own in zip((1.0, 2.0, 3.0), together(rows), strict=True):
            np.testing.assert_allclose(own, np.sum(np.sin(k * rows) * k * rows, 1), rtol=1e-12, atol=1e-13)


def test_waits_for_the_slowest_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two chunks: who has worked out its own must not leave while the other is under way."""
    monkeypatch.setattr(Straight, "_CHUNK", 10 * 50_000)
    function = native(lambda x: jnp.tanh(x[0] * x[1]) * jnp.exp(x[1]) + jnp.sin(x[0]) / (2.0 + x[1]))
    rows = RNG.normal(size=(100_000, 2))
    batched = jax.jit(jax.vmap(function))
    x, y = rows.T
    for k in range(5):
        expected = np.tanh((x + k) * y) * np.exp(y) + np.sin(x + k) / (2.0 + y)
        np.testing.assert_allclose(batched(rows + np.array([k, 0.0])), expected, rtol=1e-11, atol=1e-11)


def test_without_jit() -> None:
    function = native(bent)
    with jax.disable_jit():
        found = function(X, A)
    np.testing.assert_allclose(found, bent(X, A), rtol=1e-12)


def test_threads_that_make_the_same_kernel() -> None:
    """One of them makes it, none is refused."""
    together = threading.Barrier(4)

    def work(_: int) -> Any:
        function = native(lambda x: jnp.sin(1.2345 * x) * x)
        together.wait()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return function(X)

    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(work, range(4)):
            np.testing.assert_allclose(found, np.sin(1.2345 * X) * X, rtol=1e-13)


def test_odd_arguments() -> None:
    """None at all, empty ones, ones that are not read, integers, truth values."""
    nothing = native(lambda: [jnp.arange(3.0), jnp.sin(jnp.ones(()))])
    np.testing.assert_allclose(nothing()[0], [0.0, 1.0, 2.0])

    def function(e: jax.Array, n: jax.Array, c: jax.Array, x: jax.Array, unread: jax.Array) -> list[jax.Array]:
        return [e * 2.0, n + 1, ~c, jnp.where(c, x, n.astype(float)), jnp.zeros((0, 2), int), x, jnp.ones(2)]

    arguments = (
        jnp.zeros((2, 0)),
        jnp.array([[3, 4], [5, 6]]),
        jnp.array([[True, False], [False, True]]),
        jnp.array([[0.5, 1.5], [2.5, -1.0]]),
        jnp.full((2, 3), np.nan),
    )
    kernel = native(function)

    def every(f: Any) -> Any:
        slope = jax.vmap(jax.grad(lambda x, e, n, c, r: f(e, n, c, x, r)[3].sum()))(
            arguments[3], *arguments[:3], arguments[4]
        )
        return f(*(a[0] for a in arguments)), jax.vmap(f)(*arguments), jax.vmap(f)(*(a[:0] for a in arguments)), slope

    agree(*jax.jit(lambda: [every(kernel), every(function)])())
