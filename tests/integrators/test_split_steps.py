"""Fixed steps are split at known jumps: the order is kept, wherever the jumps lie."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from compiled_steps import kernels_of_equal_steps

TIMES, VALUES = np.array([0.0, 0.3, 0.7]), np.array([1.0, -2.0, 0.5])
TABLE = {"F": tx.ZeroOrderHold(TIMES, VALUES)}
EIGHT = tx.RKMK(tx.tableaus.DOP853)
BACKENDS = [tx.JAX(), pytest.param(tx.Native(), id="Native")]


@functools.cache
def lag(backend: Any = None) -> tx.Dynamics:
    """x' = F - x."""
    x, F = tx.State("x"), tx.Control("F")
    system = tx.System(rates={x: F - x})
    return tx.compile(system) if backend is None else tx.compile(system, backend=backend)


def exact(t: float, times: np.ndarray = TIMES) -> float:
    """x at t from x(0) = 0, piece by piece."""
    x = 0.0
    for begin, end, value in zip(times, [*times[1:], np.inf], VALUES, strict=True):
        if t > begin:
            x = value + (x - value) * np.exp(begin - min(t, end))
    return x


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("how", [{"dt": 0.11}, {"steps": 7}, {"steps": 2}, {"steps": 10}])
def test_a_table_that_jumps_inside_of_steps_costs_no_accuracy(backend: Any, how: dict) -> None:
    """The error is that of the method."""
    if isinstance(backend, tx.Native):
        pytest.importorskip("llvmlite", reason="native kernels need llvmlite")
    found = tx.integrate(lag(backend), {"x": 0.0}, t1=1.0, u=TABLE, method=EIGHT, **how)
    np.testing.assert_allclose(found.xs["x"], [exact(1.0)], atol=1e-11 if how != {"steps": 2} else 1e-9)


def test_the_order_is_kept() -> None:
    errors = [
        abs(float(tx.integrate(lag(), {"x": 0.0}, t1=1.0, u=TABLE, steps=steps).xs["x"][0]) - exact(1.0))
        for steps in (7, 14, 28)
    ]
    assert errors[0] < 2e-7
    assert all(np.log2(np.array(errors[:-1]) / errors[1:]) > 3.0)


def test_jumps_on_steps_split_none_and_others_one_each() -> None:
    count = lambda steps, **how: tx.integrate(lag(), {"x": 0.0}, t1=1.0, u=TABLE, steps=steps, **how).stats.steps  # noqa: E731
    assert count(10) == 10
    assert count(7) == 9
    assert count(7, jumps=[0.3, 0.5, 0.7]) == 10  # 0.3 and 0.7 are those of the table
    assert count(7, jumps=[-1.0, 0.0, 1.0, 2.0]) == 9


def test_a_function_of_time_whose_jumps_are_named() -> None:
    for side in (lambda t: t >= 0.4, lambda t: t > 0.4):
        switched = lambda t, side=side: {"F": jnp.where(side(t), -1.0, 1.0)}  # noqa: E731
        found = tx.integrate(lag(), {"x": 0.0}, t1=1.0, u=switched, steps=7, jumps=[0.4], method=EIGHT)
        np.testing.assert_allclose(found.xs["x"], [(2.0 - np.exp(-0.4)) * np.exp(-0.6) - 1.0], atol=1e-11)


def test_saved_times_and_dense_output_around_jumps() -> None:
    ts = np.array([0.0, 0.1, 0.3 - 1e-4, 0.3, 0.3 + 1e-12, 0.31, 0.5, 0.7, 0.71, 1.0])
    found = tx.integrate(lag(), {"x": 0.0}, t1=1.0, u=TABLE, steps=37, save_at=ts, dense=True)
    wanted = [exact(t) for t in ts]
    np.testing.assert_allclose(found.xs["x"], wanted, atol=5e-9)
    np.testing.assert_allclose(found.evaluate(ts)["x"], wanted, atol=5e-9)


def _from(first: jax.Array, steps: int, ts: np.ndarray) -> jax.Array:
    times = jnp.stack([jnp.zeros(()), first, jnp.asarray(0.7)])
    table = tx.ZeroOrderHold(times, jnp.asarray(VALUES))
    return tx.integrate(lag(), {"x": 0.0}, t1=1.0, u={"F": table}, steps=steps, save_at=ts).xs["x"]


def test_a_batch_has_jumps_at_different_times() -> None:
    firsts, ts = np.array([0.2, 0.3, 0.34, 0.5]), np.array([0.25, 0.4, 1.0])
    found = jax.jit(jax.vmap(lambda first: _from(first, 20, ts)))(firsts)
    wanted = [[exact(t, np.array([0.0, first, 0.7])) for t in ts] for first in firsts]
    np.testing.assert_allclose(found, wanted, atol=2e-8)


@pytest.mark.parametrize("first", [0.3, 0.34])
def test_derivatives_with_respect_to_the_time_of_a_jump(first: float) -> None:
    """On the edge of a step and inside of one: dx(t)/ds = (F_before - F_after) exp(s - t)."""
    ts = np.array([0.25, 0.45, 0.7, 1.0])
    # Rows of the second jump are not touched by the first.
    slope = 3.0 * np.exp(first - ts) * (ts > first)
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(derivative(_from)(jnp.asarray(first), 20, ts), slope, atol=1e-6)


@pytest.mark.parametrize("bend", [0.4, 0.45])
def test_derivatives_where_a_table_ends_with_the_solution(bend: float) -> None:
    """x' = 1 - k x: steps that no jump has added are not taken; at their times the table has no value."""
    x, F, k = tx.State("x"), tx.Control("F"), tx.Parameter("k")
    dynamics = tx.compile(tx.System(rates={x: F - k * x}))
    table = tx.FirstOrderHold([0.0, bend, 1.0], np.ones(3))

    def end(k: jax.Array) -> jax.Array:
        return tx.integrate(dynamics, {"x": 2.0}, t1=1.0, u={"F": table}, params={"k": k}, steps=10).xs["x"][0]

    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(derivative(end)(jnp.asarray(1.0)), -1.0, rtol=1e-5)


def test_other_jumps_compile_nothing() -> None:
    pytest.importorskip("llvmlite", reason="native kernels need llvmlite")
    x, F = tx.State("x"), tx.Control("F")
    own = tx.compile(tx.System(rates={x: F - x}), backend=tx.Native())
    for times, steps in ((TIMES, 7), ([0.0, 0.1, 0.9], 12), ([-3.0, -2.0, -1.0], 40)):
        tx.integrate(own, {"x": 0.0}, t1=1.0, steps=steps, u={"F": tx.ZeroOrderHold(times, VALUES)})
    assert len(kernels_of_equal_steps(own)) == 1


def test_a_long_table_of_kinks_in_single_precision() -> None:
    """A hundred rows, between which x follows a line."""
    ts = np.linspace(0.0, 1.0, 101).astype(np.float32) ** 2
    values = np.where(np.arange(101) % 2, 1.0, -1.0).astype(np.float32)
    found = tx.integrate(lag(), {"x": np.float32(0.0)}, t1=1.0, steps=9, u={"F": tx.FirstOrderHold(ts, values)})
    fine = tx.integrate(lag(), {"x": 0.0}, t1=1.0, rtol=1e-10, u={"F": tx.FirstOrderHold(ts, values)})
    assert found.xs["x"].dtype == np.float32
    np.testing.assert_allclose(found.xs["x"], fine.xs["x"], atol=2e-6)
