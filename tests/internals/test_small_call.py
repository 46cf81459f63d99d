"""Small calls change the speed, never the result; and this notices when the undocumented attribute stops working."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import forced_body, spatial_inertia, start

import twistax as tx
from twistax.scalar import small_call as module
from twistax.scalar.small_call import small_call
from twistax.tableaus import DOP853, RK4

#: How our calls differ from those XLA makes of small loops on its own.
MARK = 'inlineable="false"'


def looped(x: jax.Array, y: jax.Array) -> dict[str, jax.Array]:
    """A loop with a branch, a product and a table in it; the second argument is never read."""

    def body(i: jax.Array, x: jax.Array) -> jax.Array:
        turned = jnp.where(x > 0.5, jnp.sin(x), x * x)
        return jnp.eye(3) @ turned + 0.01 * jnp.asarray([1.0, 2.0, 3.0])[i % 3]

    return {"x": jax.lax.fori_loop(0, 20, body, x), "same": x}


def compiled(function: Callable[..., object], *arguments: object) -> str:
    return jax.jit(function).lower(*arguments).compile().as_text()


def test_the_result_is_the_same() -> None:
    x, y = jnp.array([0.1, 0.7, 0.4]), jnp.ones(4)
    inside = jax.jit(lambda x, y: small_call(looped, x, y))(x, y)
    for name, wanted in looped(x, y).items():
        np.testing.assert_allclose(inside[name], wanted, rtol=1e-14)


def test_the_attribute_reaches_the_compiled_program() -> None:
    """The canary: if this fails after an upgrade, look at `small_call` before trusting any measured time."""
    text = compiled(lambda x, y: small_call(looped, x, y)["x"], jnp.ones(3), jnp.ones(4))
    (call,) = [line for line in text.splitlines() if " call(" in line and 'jit(small_function)"' in line]
    assert MARK in call
    assert 'xla_cpu_small_call="true"' in call


def test_libraries_are_left_outside() -> None:
    """A solver from LAPACK, a callback, a large product, entries set at several places: none compiles inside."""

    def solves(a: jax.Array) -> jax.Array:
        return jnp.linalg.solve(a + 9.0 * jnp.eye(8), jnp.ones(8))

    def calls_back(a: jax.Array) -> jax.Array:
        return jax.pure_callback(lambda b: b, jax.ShapeDtypeStruct(a.shape, a.dtype), a)

    def multiplies(a: jax.Array) -> jax.Array:
        return jnp.tile(a, (2, 2)) @ jnp.tile(a, (2, 2))

    def sets(a: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, 3, lambda i, a: a.at[jnp.array([0, 2])].set(2.0 * a[1]), a)

    def adds(a: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, 3, lambda i, a: a.at[jnp.array([0, 2])].add(2.0 * a[1]), a)

    a = jnp.arange(64.0).reshape(8, 8) / 64.0
    for function in (solves, calls_back, multiplies, sets, adds):
        assert MARK not in compiled(lambda a, f=function: small_call(f, a), a)
        np.testing.assert_array_equal(small_call(function, a), function(a))


def test_entries_set_at_one_place_are_inside() -> None:
    def sets(a: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, 3, lambda i, a: a.at[i].set(a[1] + 1.0).at[1].add(a[2]).at[2:4].set(a[0]), a)

    a = jnp.arange(5.0)
    assert MARK in compiled(lambda a: small_call(sets, a), a)
    np.testing.assert_array_equal(small_call(sets, a), sets(a))


@pytest.mark.slow
def test_without_the_attribute_solutions_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """A JAX that has lost it is integrated the same, only slower. Its inertia is baked: as an input it calls LAPACK."""
    body = tx.compile(forced_body(), bake={"M": spatial_inertia()}, backend=tx.XLA())
    known, seen = module.known_inside, []
    monkeypatch.setattr(module, "known_inside", lambda jaxpr: seen.append(known(jaxpr)) or seen[-1])
    for tableau in (RK4, DOP853):
        method = tx.RKMK(tableau)
        fast = tx.integrate(body, start(), t1=1.0, dt=0.05, method=method, save_at=[0.0, 0.32, 1.0])
        assert seen
        assert all(seen)
        with monkeypatch.context() as patch:
            patch.setattr(module, "small_calls_exist", lambda: False)
            jax.clear_caches()
            plain = tx.integrate(body, start(), t1=1.0, dt=0.05, method=method, save_at=[0.0, 0.32, 1.0])
        for name in fast.xs:
            np.testing.assert_allclose(fast.xs[name], plain.xs[name], rtol=1e-12, atol=1e-13)


def test_solutions_by_tables_are_small_calls() -> None:
    """Tables are looked up by comparisons of their own kind; they must not cost the fast loop."""
    x, F = tx.State("x"), tx.Control("F")
    dynamics = tx.compile(tx.System(rates={x: F * tx.Linterp(x, [0.0, 0.5, 1.0], [1.0, 0.5, 2.0])}))
    ts, values = jnp.array([0.0, 0.5, 0.8]), jnp.array([1.0, -0.5, 0.3])

    def solve(x: jax.Array, values: jax.Array) -> jax.Array:
        def advance(i: jax.Array, x: jax.Array) -> jax.Array:
            t, h = 0.1 * i, jnp.asarray(0.1)
            F = tx.ZeroOrderHold(ts, values).during(t, h)(t)
            return x + h * dynamics.functions.vector_field(t, {"x": x}, {"F": F}, {})["x"]

        return jax.lax.fori_loop(0, 10, advance, x)

    assert MARK in compiled(lambda x, v: small_call(solve, x, v), jnp.asarray(0.2), values)
    np.testing.assert_allclose(small_call(solve, jnp.asarray(0.2), values), solve(jnp.asarray(0.2), values), rtol=1e-13)


@pytest.mark.parametrize("size", [1, 2, 5, 40])
def test_systems_of_any_size_compile(size: int) -> None:
    """Rates that are the state itself, constants, unread states: what has made XLA abort."""
    x, y = tx.State("x", shape=(size,)), tx.State("y")
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    dynamics = tx.compile(tx.System(rates={x: x, y: 1.0, g: V, V: np.zeros(6)}))
    start = {"x": np.ones(size), "y": 0.0, "g": np.eye(4), "V": np.arange(6.0) / 10.0}
    sol = tx.integrate(dynamics, start, t1=1.0, dt=0.01)
    np.testing.assert_allclose(sol.xs["x"][0], np.full(size, np.e), rtol=1e-8)
    np.testing.assert_allclose(sol.xs["y"][0], 1.0, rtol=1e-12)
    np.testing.assert_allclose(sol.xs["g"][0], tx.lie.se3.exp(np.arange(6.0) / 10.0), atol=1e-12)


def test_forward_derivatives_from_a_constant_start_compile() -> None:
    """XLA moves constant arguments into the function, and has aborted on what is left of them."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    spin = tx.compile(tx.System(rates={R: w, w: -w}))

    def end(v: jax.Array) -> jax.Array:
        return tx.integrate(spin, {"R": np.eye(3), "w": v}, t1=0.5, steps=5).xs["R"][0]

    one, other = jnp.ones(3), jnp.arange(3.0)
    change = jax.jit(lambda v, d: jax.jvp(end, (v,), (d,))[1])(one, other)
    step = 1e-6
    numeric = (end(one + step * other) - end(one - step * other)) / (2.0 * step)
    np.testing.assert_allclose(change, numeric, atol=1e-8)


def test_what_is_never_read_ends_no_process() -> None:
    """XLA aborts on a small function with an argument that nothing reads, which may be a value it closes over."""
    script = Path(__file__).with_name("unread_values.py")
    ran = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-2000:]
