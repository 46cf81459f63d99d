"""Fixed steps in one kernel: the solution that XLA's loop makes, one body or a batch."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from windy_body import START, U, windy_body

import twistax as tx
from compiled_steps import kernels_of_equal_steps

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

NATIVE, PLAIN = tx.compile(windy_body(), backend=tx.Native()), tx.compile(windy_body(), backend=tx.JAX())
METHODS = {
    "classical": tx.RKMK(tx.tableaus.RK4),
    "quaternion": tx.RKMK(tx.tableaus.TSIT5, chart=tx.charts.Ambient()),
    "thirteen stages": tx.RKMK(tx.tableaus.DOP853),
    "commutator-free": tx.CommutatorFree(),
}


def _near(found: dict[str, jax.Array], expected: dict[str, jax.Array], rtol: float = 1e-13) -> None:
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=rtol, atol=rtol, equal_nan=True)


@pytest.mark.parametrize("name", METHODS)
def test_the_solution_is_that_of_the_loop(name: str) -> None:
    dynamics = tx.compile(windy_body(), backend=tx.Native())
    given: dict[str, Any] = {"t1": 0.7, "steps": 9, "u": U, "method": METHODS[name], "save_at": [0.0, 0.3, 0.35, 0.7]}
    found, expected = (tx.integrate(d, START, **given) for d in (dynamics, PLAIN))
    _near(found.xs, expected.xs)
    assert found.stats == expected.stats
    assert len(kernels_of_equal_steps(dynamics)) == 1


def test_saved_rows_are_filled_in_the_kernel() -> None:
    given: dict[str, Any] = {"t1": 0.7, "steps": 9, "u": U, "save_at": [0.0, 0.3, 0.35, 0.7]}
    for x0 in (START, {name: np.asarray(value, np.float32) for name, value in START.items()}):
        traced = str(jax.make_jaxpr(lambda x0: tx.integrate(NATIVE, x0, **given).xs)(x0))
        assert traced.count("repeated_step[") == 1
        assert "while[" not in traced


def test_a_batch_is_each_solution_with_a_length_and_steps_of_its_own() -> None:
    lengths, pushes = jnp.linspace(0.1, 0.9, 11), jnp.linspace(0.0, 5.0, 33).reshape(11, 3)

    def end(dynamics: tx.Dynamics, t1: jax.Array, push: jax.Array) -> dict[str, jax.Array]:
        return tx.integrate(dynamics, START, t1=t1, steps=6, u={"F": push}).xs

    found, expected = (
        jax.jit(jax.vmap(lambda t1, push, d=d: end(d, t1, push)))(lengths, pushes) for d in (NATIVE, PLAIN)
    )
    _near(found, expected)


def test_a_solution_that_fails_ends_where_the_loop_does() -> None:
    """Lane by lane: the others go on."""
    x = tx.State("x")
    fast = tx.System(rates={x: x * x})
    starts = jnp.array([0.5, 30.0, 0.1, 1e200, 4.0])
    ends = []
    for backend in (tx.Native(), tx.XLA()):
        dynamics = tx.compile(fast, backend=backend)
        found = jax.vmap(lambda x0, d=dynamics: tx.integrate(d, {"x": x0}, t1=1.0, steps=40))(starts)
        ends.append((found.xs["x"], found.result, found.stats.steps, found.stats.rhs_evaluations))
        saved: dict[str, Any] = {"t1": 1.0, "steps": 40, "save_at": [0.0, 0.025, 0.5, 1.0]}
        rows = jax.vmap(lambda x0, d=dynamics, s=saved: tx.integrate(d, {"x": x0}, **s))(starts)
        ends[-1] += (rows.xs["x"], rows.stats.steps)
        part = tx.integrate(dynamics, {"x": 30.0}, **saved, throw=False)
        ends[-1] += (part.xs["x"], part.ts, jnp.asarray(part.result.value), jnp.asarray(part.stats.steps))
        with pytest.raises(tx.IntegrationError, match="infinite or NaN"):
            tx.integrate(dynamics, {"x": 1e200}, t1=1.0, steps=40)
    for found, expected in zip(*ends, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-10)
    assert len(set(np.asarray(ends[0][2]).tolist())) > 2


@pytest.mark.slow
def test_derivatives_are_those_of_the_steps() -> None:
    def end(dynamics: tx.Dynamics, V: jax.Array) -> jax.Array:
        return tx.integrate(dynamics, {**START, "V": V}, t1=0.5, steps=5, u=U).xs["V"].sum()

    V, arrays = jnp.asarray(START["V"]), tx.compile(windy_body(), backend=tx.JAX())
    found, expected = (jax.grad(lambda V, d=d: end(d, V))(V) for d in (NATIVE, arrays))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_controls_may_be_functions_of_time_and_tables() -> None:
    times, values = np.array([0.0, 0.2, 0.5]), np.arange(9.0).reshape(3, 3)
    controls = [lambda t: {"F": jnp.stack([t, jnp.sin(t), 1.0 - t])}, {"F": tx.FirstOrderHold(times, values)}]
    for u in controls:
        found, expected = (tx.integrate(d, START, t1=0.5, steps=10, u=u) for d in (NATIVE, PLAIN))
        _near(found.xs, expected.xs)


def test_other_numbers_do_not_compile_again() -> None:
    dynamics = tx.compile(windy_body(), backend=tx.Native())
    for steps, t1 in ((3, 0.1), (8, 0.5)):
        tx.integrate(dynamics, START, t1=t1, steps=steps, u=U)
    assert len(kernels_of_equal_steps(dynamics)) == 1


def test_single_precision_stays_single() -> None:
    start = {name: np.asarray(value, np.float32) for name, value in START.items()}
    found, expected = (tx.integrate(d, start, t1=0.5, steps=10, u=U) for d in (NATIVE, PLAIN))
    assert {value.dtype for value in found.xs.values()} == {np.dtype(np.float32)}
    _near(found.xs, expected.xs, rtol=1e-5)


@pytest.mark.parametrize("steps", [{"steps": 10}, {"rtol": 1e-4}], ids=["fixed", "adaptive"])
def test_it_runs_without_x64(steps: dict[str, Any]) -> None:
    """As JAX comes. Counters too must have a type of that mode: JAX 0.12 warns of others."""
    with jax.enable_x64(False):
        found = tx.integrate(tx.compile(windy_body(), backend=tx.Native()), START, t1=0.5, u=U, **steps)
        assert {value.dtype for value in found.xs.values()} == {np.dtype(np.float32)}
    _near(found.xs, tx.integrate(PLAIN, START, t1=0.5, steps=100, u=U).xs, rtol=1e-3)


def test_events_and_dense_output_are_as_ever() -> None:
    event = tx.Event(tx.State("V", shape=(6,))[2] + 3.0)
    for given in ({"event": event}, {"dense": True}):
        found, expected = (tx.integrate(d, START, t1=0.5, steps=10, u=U, **given) for d in (NATIVE, PLAIN))
        _near(found.xs, expected.xs)


def test_wide_states_are_left_to_xla() -> None:
    x = tx.State("x", shape=(500,))
    dynamics = tx.compile(tx.System(rates={x: -x}), backend=tx.Native())
    found = tx.integrate(dynamics, {"x": np.ones(500)}, t1=1.0, steps=50).xs["x"]
    np.testing.assert_allclose(found, np.exp(-1.0), rtol=1e-7)
    assert not kernels_of_equal_steps(dynamics)


@pytest.mark.parametrize("traced", [jnp.arange(3), jnp.arange(3.0)])
def test_controls_may_close_over_traced_values(traced: jax.Array) -> None:
    pushes = jnp.arange(9.0).reshape(3, 3)

    def end(dynamics: tx.Dynamics, i: jax.Array) -> jax.Array:
        push = pushes[i] if i.dtype == int else i * pushes[1]
        return tx.integrate(dynamics, START, t1=0.5, steps=5, u=lambda t: {"F": t * push}).xs["V"]

    found, expected = (jax.vmap(lambda i, d=d: end(d, i))(traced) for d in (NATIVE, PLAIN))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_controls_may_print() -> None:
    """What a control does besides its values is done at every stage."""
    times: list[float] = []

    def u(t: jax.Array) -> dict[str, jax.Array]:
        jax.debug.callback(lambda s: times.append(float(s)), t)
        return {"F": t * jnp.ones(3)}

    tx.integrate(NATIVE, START, t1=0.5, steps=5, u=u)
    jax.effects_barrier()
    assert set(times) >= {0.0, 0.05, 0.1, 0.25, 0.5}


def test_without_jit() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}), backend=tx.Native())
    with jax.disable_jit():
        found = tx.integrate(dynamics, {"x": 1.0}, t1=0.5, steps=10)
    np.testing.assert_allclose(found.xs["x"], np.exp(-0.5), rtol=1e-7)
    assert kernels_of_equal_steps(dynamics)
