"""Steps that are differentiated as programs: the derivatives of arrays, and where there is no program."""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turning_top import Cost, integrated, top

import twistax as tx
from compiled_steps import programs_of_steps
from twistax.scenes import ROCKET

#: Programs that run once need not be fast.
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
BACKENDS = {"XLA": tx.XLA(), "native": tx.Native()}


@functools.cache
def in_arrays(derivative: Callable[[Cost], Cost]) -> np.ndarray:
    """A derivative by JAX alone."""
    return run(derivative(integrated(tx.compile(top(), backend=tx.JAX()), steps=3)))


def run(function: Cost) -> np.ndarray:
    z = jnp.linspace(-0.2, 0.3, 3)
    return np.asarray(jax.jit(function).lower(z).compile(QUICK)(z))


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd, pytest.param(jax.hessian, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_arrays(name: str, derivative: Callable[[Cost], Cost]) -> None:
    if name == "native":
        pytest.importorskip("llvmlite", reason="native kernels need llvmlite")
    dynamics = tx.compile(top(), backend=BACKENDS[name])
    found = run(derivative(integrated(dynamics, steps=3)))
    np.testing.assert_allclose(found, in_arrays(derivative), rtol=1e-11, atol=1e-12)
    assert len(programs_of_steps(dynamics)) == 1


def test_without_scalars_there_is_no_program() -> None:
    dynamics = tx.compile(top(), backend=tx.JAX())
    jax.make_jaxpr(jax.grad(integrated(dynamics, steps=3)))(jnp.zeros(3))
    assert not programs_of_steps(dynamics)


def test_a_long_loop_of_stages_stays_a_loop_for_xla() -> None:
    """All thirteen stages as scalars would take XLA half a minute."""
    dynamics = tx.compile(ROCKET.system, backend=tx.XLA())
    options = {"t1": 1.0, "steps": 3, "u": ROCKET.u, "method": tx.RKMK(tx.tableaus.DOP853)}

    def end(push: jax.Array) -> jax.Array:
        start = {name: value + push for name, value in ROCKET.start.items()}
        return tx.integrate(dynamics, start, params=ROCKET.params, **options).xs[dynamics.states[0].name]

    jax.make_jaxpr(jax.jacfwd(end))(jnp.asarray(0.0))
    (program,) = (found.program for found in programs_of_steps(dynamics))
    assert len(program.calls) == 1
    assert program.operations < 1000


def test_derivatives_may_be_larger_than_a_function_is_allowed_to_be() -> None:
    pytest.importorskip("llvmlite", reason="native kernels need llvmlite")
    dynamics = tx.compile(top(), backend=tx.Native(scalars=tx.XLA(largest=1200)))
    found = run(jax.grad(integrated(dynamics, steps=3)))
    np.testing.assert_allclose(found, in_arrays(jax.grad), rtol=1e-11, atol=1e-12)
    (program,) = (found.program for found in programs_of_steps(dynamics))
    assert len(program.graph.numbers) > 1200


def test_steps_that_solve_equations_stay_as_they_are() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x * x}))
    method = tx.ImplicitRKMK(tx.tableaus.GAUSS_LEGENDRE4)
    jax.make_jaxpr(jax.grad(lambda x0: tx.integrate(dynamics, {"x": x0}, t1=1.0, steps=2, method=method).xs["x"][-1]))(
        1.0
    )
    assert not programs_of_steps(dynamics)


def test_wide_states_stay_arrays() -> None:
    x = tx.State("x", shape=(500,))
    dynamics = tx.compile(tx.System(rates={x: -x}), backend=tx.Native())

    def cost(x0: jax.Array) -> jax.Array:
        return tx.integrate(dynamics, {"x": x0}, t1=1.0, steps=50).xs["x"][-1].sum()

    np.testing.assert_allclose(jax.grad(cost)(jnp.ones(500)), np.exp(-1.0), rtol=1e-7)
    assert not programs_of_steps(dynamics)


def test_a_control_that_closes_over_a_traced_value_keeps_its_derivative() -> None:
    x, F = tx.State("x"), tx.Control("F")
    dynamics = tx.compile(tx.System(rates={x: F - x}))

    def cost(k: jax.Array) -> jax.Array:
        sol = tx.integrate(dynamics, {"x": 1.0}, t1=1.0, steps=100, u=lambda t: {"F": k * jnp.cos(0.0 * t)})
        return sol.xs["x"][-1]

    found = jax.grad(cost)(jnp.asarray(0.3))
    np.testing.assert_allclose(found, 1.0 - np.exp(-1.0), rtol=1e-9)


def noise_of(key: jax.Array) -> Callable[[jax.Array], dict[str, jax.Array]]:
    return lambda t: {"F": t * jax.random.normal(key, dtype=t.dtype)}


TABLE = jnp.linspace(0.0, 1.0, 5000)
CONTROLS = {
    "a random key": noise_of(jax.random.key(3)),
    "a legacy random key": noise_of(jax.random.PRNGKey(3)),
    "a long table": lambda t: {"F": TABLE[(4999.0 * t).astype(int)]},
}


@pytest.mark.parametrize("name", CONTROLS)
def test_controls_that_no_program_holds_stay_as_they_are(name: str) -> None:
    """Keys are no numbers; a table that is closed over would become scalars one by one, which takes minutes."""
    x, F = tx.State("x"), tx.Control("F")
    dynamics = tx.compile(tx.System(rates={x: F - x}))

    def cost(x0: jax.Array) -> jax.Array:
        return tx.integrate(dynamics, {"x": x0}, t1=1.0, steps=100, u=CONTROLS[name]).xs["x"][-1]

    np.testing.assert_allclose(jax.grad(cost)(jnp.asarray(0.3)), np.exp(-1.0), rtol=1e-8)
    assert not programs_of_steps(dynamics)
