"""Integration backward in time, against exact solutions and the way forward."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

SPIN = np.array([0.3, -0.2, 0.5])
#: Both kinds of steps, and methods of every family.
HOW = {
    "fixed": {"steps": 60},
    "chosen": {"rtol": 1e-10},
    "commutator-free": {"steps": 60, "method": tx.CommutatorFree()},
    "Radau": {"rtol": 1e-9, "method": tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)},
    "Gauss": {"steps": 30, "method": tx.ImplicitRKMK(tx.tableaus.GAUSS_LEGENDRE6)},
    "Tsit5": {"rtol": 1e-10, "method": tx.RKMK(tx.tableaus.TSIT5)},
}


@functools.cache
def system(backend: Any = None) -> tx.Dynamics:
    """A body that turns at a constant rate while x' = F - x + cos t."""
    R, x, F = tx.State("R", group=tx.SO3), tx.State("x"), tx.Control("F")
    known = tx.System(rates={R: SPIN, x: F - x + tx.Cos(tx.Time())})
    return tx.compile(known) if backend is None else tx.compile(known, backend=backend)


def exact(t: Any, force: float = 0.5) -> dict[str, Any]:
    t = jnp.asarray(t)
    x = force + 0.5 * (jnp.cos(t) + jnp.sin(t)) + 2.0 * jnp.exp(-t)
    turned = lambda t: tx.lie.so3.exp(t * SPIN)  # noqa: E731
    return {"R": (jax.vmap(turned) if t.ndim else turned)(t), "x": x}


def near(found: Any, wanted: Any, atol: float = 1e-8) -> None:
    for name in wanted:
        np.testing.assert_allclose(found[name], wanted[name], atol=atol)


@pytest.mark.parametrize(
    "name", [n if n in ("fixed", "chosen") else pytest.param(n, marks=pytest.mark.slow) for n in HOW]
)
def test_the_exact_solution_backward(name: str) -> None:
    ts = np.array([2.0, 1.7, 0.95, 0.3, -0.5])
    found = tx.integrate(system(), exact(2.0), t0=2.0, t1=-0.5, u={"F": 0.5}, save_at=ts, dense=True, **HOW[name])
    assert found.result is tx.Result.SUCCESS
    np.testing.assert_array_equal(found.ts, ts)
    near(found.xs, exact(ts), 1e-7)
    near(found.evaluate(ts[::-1]), exact(ts[::-1]), 1e-7)
    with pytest.raises(tx.InputError, match=r"\[-0.5, 2\] \(the integrated span"):
        found.evaluate(2.1)


@pytest.mark.parametrize("how", [{"steps": 25}, {"rtol": 1e-9}], ids=["fixed", "chosen"])
def test_kernels_go_backward_and_other_directions_compile_nothing(how: dict) -> None:
    pytest.importorskip("llvmlite", reason="native kernels need llvmlite")
    own = tx.compile(system().system, backend=tx.Native())
    for t0, t1 in ((0.0, 1.0), (1.0, 0.0)):
        near(tx.integrate(own, exact(t0), t0=t0, t1=t1, u={"F": 0.5}, **how).last, exact(t1), 1e-6)
    before = len(list(own.functions.steps.values()))
    tx.integrate(own, exact(0.5), t0=0.5, t1=-1.0, u={"F": 0.5}, **how)
    assert len(list(own.functions.steps.values())) == before


@pytest.mark.parametrize("how", [{"steps": 40}, {"rtol": 1e-9}], ids=["fixed", "chosen"])
def test_there_and_back_across_the_jumps_of_a_table(how: dict) -> None:
    """Also polynomials between the ends of steps, and a function of time whose jumps are named."""
    table, ts = tx.ZeroOrderHold([-1.0, 0.333, 0.7], [1.0, -20.0, 0.5]), np.linspace(0.0, 1.0, 9)
    switched = lambda t: {"F": jnp.where(t < 0.333, 1.0, jnp.where(t < 0.7, -20.0, 0.5))}  # noqa: E731
    for given in ({"u": {"F": table}}, {"u": switched, "jumps": [0.333, 0.7]}):
        there = tx.integrate(system(), exact(0.0), t1=1.0, save_at=ts, **given, **how)
        back = tx.integrate(system(), there.last, t0=1.0, t1=0.0, save_at=ts[::-1], **given, **how)
        near(back.xs, {name: value[::-1] for name, value in there.xs.items()}, 5e-7)
        if "rtol" in how:
            smooth = {"save_at": ts[::-1], "between": tx.Between.POLYNOMIAL}
            rows = tx.integrate(system(), there.last, t0=1.0, t1=0.0, **smooth, **given, **how)
            near(rows.xs, back.xs, 1e-6)
            assert rows.stats.rejected <= 3


def test_polynomials_backward_in_a_kernel_and_in_a_loop_of_batches() -> None:
    """Along steps whose direction is traced too; jit without vmap is a kernel where the backend has them."""
    ends = jnp.array([1.0, -0.8])

    def rows(t1: jax.Array) -> dict[str, jax.Array]:
        given = {"rtol": 1e-9, "save_at": t1 * jnp.array([0.0, 0.3, 0.77, 1.0]), "between": tx.Between.POLYNOMIAL}
        return tx.integrate(system(), exact(0.0), t1=t1, u={"F": 0.5}, **given).xs

    every, last = jax.jit(jax.vmap(rows))(ends), jax.jit(rows)(ends[1])
    wanted = exact(ends[1] * jnp.array([0.0, 0.3, 0.77, 1.0]))
    near({name: value[1] for name, value in every.items()}, wanted, 1e-7)
    near(last, wanted, 1e-7)


def test_a_batch_of_both_directions_under_jit_and_derivatives() -> None:
    """The end is exact(t1) from exact(0): its derivative with respect to t1 is the rate there."""

    def end(t1: jax.Array) -> jax.Array:
        return tx.integrate(system(), exact(0.0), t1=t1, u={"F": 0.5}, steps=40).xs["x"][0]

    ends = jnp.array([1.5, -1.5, -0.2])
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(end)))(ends)
    np.testing.assert_allclose(found, exact(ends)["x"], atol=1e-6)
    np.testing.assert_allclose(slopes, 0.5 * (jnp.cos(ends) - jnp.sin(ends)) - 2.0 * jnp.exp(-ends), atol=1e-5)


def test_a_failure_backward_names_its_time() -> None:
    """x' = -x^2 from 1 at t = 2 was infinite at t = 1."""
    x = tx.State("x")
    pole = tx.compile(tx.System(rates={x: -x * x}))
    with pytest.raises(tx.IntegrationError, match="at t = 1"):
        tx.integrate(pole, {"x": 1.0}, t0=2.0, t1=0.0, rtol=1e-8)
    found = tx.integrate(pole, {"x": 1.0}, t0=2.0, t1=0.0, rtol=1e-8, save_at=[1.5, 1.25, 0.5], throw=False)
    np.testing.assert_allclose(found.xs["x"], [2.0, 4.0], rtol=1e-7)
    assert found.result is tx.Result.STEP_TOO_SMALL


def test_saved_times_fall_with_the_time() -> None:
    with pytest.raises(tx.InputError, match=r"sorted from t0 to t1, got 0\.2 before 0\.5"):
        tx.integrate(system(), exact(1.0), t0=1.0, t1=0.0, u={"F": 0.5}, steps=4, save_at=[0.2, 0.5])
    table = tx.ZeroOrderHold([0.5, 0.7], [1.0, 2.0])
    with pytest.raises(tx.InputError, match=r"begins at 0\.5, but the integration"):
        tx.integrate(system(), exact(1.0), t0=1.0, t1=0.0, u={"F": table}, steps=4)
