"""Steps chosen by tolerances in one kernel: the solution that XLA's loop makes, one body or a batch."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from windy_body import START, U, windy_body

import twistax as tx
from compiled_steps import kernels_of_chosen_steps
from twistax.jax_inside import all_equations

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

NATIVE, PLAIN = tx.compile(windy_body(), backend=tx.Native()), tx.compile(windy_body(), backend=tx.JAX())
METHODS = {
    "fifth order": tx.RKMK(tx.tableaus.TSIT5),
    "quaternion": tx.RKMK(tx.tableaus.BOGACKI_SHAMPINE3, chart=tx.charts.Ambient()),
    "two estimates": tx.RKMK(tx.tableaus.DOP853),
}


def near(found: tx.Solution, expected: tx.Solution, rtol: float = 1e-11) -> None:
    """The same steps, and the same states to what rounding makes of them."""
    assert found.stats == expected.stats
    assert found.result == expected.result
    np.testing.assert_allclose(found.ts, expected.ts, rtol=rtol)
    for name, value in expected.xs.items():
        np.testing.assert_allclose(found.xs[name], value, rtol=rtol, atol=rtol, equal_nan=True)


@pytest.mark.parametrize("name", METHODS)
def test_the_solution_is_that_of_the_loop(name: str) -> None:
    dynamics = tx.compile(windy_body(), backend=tx.Native())
    given: dict[str, Any] = {"t1": 0.7, "rtol": 1e-6, "u": U, "method": METHODS[name]}
    near(tx.integrate(dynamics, START, **given), tx.integrate(PLAIN, START, **given))
    assert len(kernels_of_chosen_steps(dynamics)) == 1


def test_saved_times_limits_and_jumps() -> None:
    table = tx.ZeroOrderHold(np.array([0.0, 0.25, 0.5]), np.array([[1.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, -4.0]]))
    given: dict[str, Any] = {
        "t1": 0.7,
        "rtol": 1e-8,
        "u": {"F": table},
        "save_at": [0.0, 0.1, 0.25, 0.3, 0.7],
        "jumps": [0.6],
        "control": tx.StepControl(dtmax=0.05, dcoeff=0.1),
    }
    dynamics = tx.compile(windy_body(), backend=tx.Native())
    near(tx.integrate(dynamics, START, **given), tx.integrate(PLAIN, START, **given))
    assert len(kernels_of_chosen_steps(dynamics)) == 1


def test_one_call_of_the_kernel_goes_on_across_jumps() -> None:
    """Also where rows are filled on the way; of many limits it sees some at a time."""
    table = tx.FirstOrderHold(np.linspace(0.0, 1.0, 9), np.random.default_rng(2).normal(size=(9, 3)))
    rows = {"save_at": np.linspace(0.0, 1.0, 5)}
    for more in ({}, rows, {**rows, "between": tx.Between.POLYNOMIAL}):
        given: dict[str, Any] = {"t1": 1.0, "rtol": 1e-6, "u": {"F": table}, **more}
        program = jax.make_jaxpr(lambda x, given=given: tx.integrate(NATIVE, x, **given).xs)(START)
        names = [eqn.primitive.name for eqn in all_equations(program.jaxpr)]
        assert "while" not in names
        assert names.count("repeated_step") == 1
    many: dict[str, Any] = {"t1": 1.0, "rtol": 1e-4, "u": U, "jumps": np.linspace(0.0, 1.0, 151) ** 2}
    for more in ({}, {"save_at": [0.0, 0.01, 0.33, 1.0]}):
        near(tx.integrate(NATIVE, START, **many, **more), tx.integrate(PLAIN, START, **many, **more))


def test_rows_on_polynomials_are_filled_by_the_kernel() -> None:
    """An oscillator whose force jumps, in lanes with forces and tolerances of their own, against the exact solution."""
    x, v, F = tx.State("x"), tx.State("v"), tx.Control("F")
    dynamics = tx.compile(tx.System({x: v, v: F - x}), backend=tx.Native())
    ts, jump = np.append(np.linspace(0.0, 3.0, 41), 3.0), 0.7
    given: dict[str, Any] = {
        "t1": 3.0,
        "save_at": ts,
        "between": tx.Between.POLYNOMIAL,
        "method": METHODS["fifth order"],
    }

    def flown(force: Any, rtol: Any) -> tx.Solution:
        table = tx.ZeroOrderHold(np.array([0.0, jump]), np.array([1.0, -2.0]) * force)
        return tx.integrate(dynamics, {"x": 0.0, "v": 0.0}, rtol=rtol, u={"F": table}, **given)

    s = ts - jump
    later = -2.0 + (3.0 - np.cos(jump)) * np.cos(s) + np.sin(jump) * np.sin(s)
    exact = np.where(ts < jump, 1.0 - np.cos(ts), later)
    forces, tolerances = np.array([1.0, -3.0, 0.2, 5.0, 2.0]), np.array([1e-8, 1e-9, 1e-10, 1e-9, 1e-11])
    found = jax.vmap(flown)(forces, tolerances)
    np.testing.assert_allclose(found.xs["x"], forces[:, None] * exact, atol=1e-6)
    # Another number of rows needs no other kernel; rows by steps have one of their own.
    given.update(save_at=ts[::2])
    assert flown(2.0, 1e-11).stats.steps == found.stats.steps[-1]
    assert len(kernels_of_chosen_steps(dynamics)) == 1
    given.update(save_at=None, between=tx.Between.STEP)
    assert flown(2.0, 1e-11).stats.steps == found.stats.steps[-1]
    assert len(kernels_of_chosen_steps(dynamics)) == 2


def test_rows_on_polynomials_leave_little_to_xla() -> None:
    """It runs a program of a thousand operations, by its own count, on another thread: 10 us, as long as all rows."""
    given: dict[str, Any] = {"t1": 0.7, "rtol": 1e-6, "u": U, "between": tx.Between.POLYNOMIAL}
    for ts in (np.linspace(0.0, 0.7, 401), np.linspace(0.0, 0.7, 3)):
        run = jax.jit(lambda x, ts=ts: tx.integrate(NATIVE, x, save_at=ts, **given).xs)
        assert run.lower(START).compile().cost_analysis()["flops"] < 1000.0


def test_steps_are_taken_back_and_a_solution_without_length_has_none() -> None:
    given: dict[str, Any] = {"rtol": 1e-9, "dt": 0.5, "u": U}
    found, expected = (tx.integrate(d, START, t1=1.0, **given) for d in (NATIVE, PLAIN))
    near(found, expected)
    assert found.stats.rejected > 0
    still = tx.integrate(NATIVE, START, t1=0.0, **given)
    assert still.stats.steps == 0
    np.testing.assert_array_equal(still.xs["V"][-1], START["V"])


def test_failures_are_those_of_the_loop() -> None:
    """Lane by lane: the others go on."""
    y = tx.State("x")
    fast = tx.System(rates={y: y * y})
    starts = jnp.array([0.5, 30.0, 0.1, 1e200, 4.0])
    ends = []
    for backend in (tx.Native(), tx.XLA()):
        dynamics = tx.compile(fast, backend=backend)

        def solve(x0: Any, throw: bool = True, steps: int = 900, dynamics: tx.Dynamics = dynamics) -> tx.Solution:
            control = tx.StepControl(max_steps=steps)
            return tx.integrate(dynamics, {"x": x0}, t1=1.0, rtol=1e-6, atol=1e-9, control=control, throw=throw)

        found = jax.vmap(solve)(starts)
        one, short = solve(30.0, throw=False), solve(0.5, throw=False, steps=3)
        # Close to the pole rounding decides how large x is.
        x = jnp.where(found.result == tx.Result.SUCCESS.value, found.xs["x"][:, -1], 0.0)
        ends.append((x, found.result, found.stats.steps, found.stats.rhs_evaluations))
        ends[-1] += tuple(jnp.asarray(v) for s in (one, short) for v in (s.ts[-1], s.result.value, s.stats.rejected))
        with pytest.raises(tx.IntegrationError, match="x"):
            solve(1e200)
    for found, expected in zip(*ends, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-7)
    assert len(set(np.asarray(ends[0][1]).tolist())) > 1


def test_a_batch_is_each_solution_with_tolerances_and_an_end_of_its_own() -> None:
    ends, tolerances = jnp.linspace(0.1, 0.9, 11), 10.0 ** -jnp.linspace(4.0, 9.0, 11)

    def end(dynamics: tx.Dynamics, t1: jax.Array, rtol: jax.Array) -> tx.Solution:
        return tx.integrate(dynamics, START, t1=t1, rtol=rtol, u=U)

    found, expected = (
        jax.jit(jax.vmap(lambda t1, rtol, d=d: end(d, t1, rtol)))(ends, tolerances) for d in (NATIVE, PLAIN)
    )
    np.testing.assert_array_equal(found.stats.steps, expected.stats.steps)
    for name, value in expected.xs.items():
        np.testing.assert_allclose(found.xs[name], value, rtol=1e-11, atol=1e-11)


def test_single_precision_stays_single() -> None:
    start = {name: np.asarray(value, np.float32) for name, value in START.items()}
    dynamics = tx.compile(windy_body(), backend=tx.Native())
    control = tx.StepControl(factormax=np.float64(5.0), dtmax=np.float64(0.2))
    found, expected = (tx.integrate(d, start, t1=0.5, rtol=1e-4, u=U, control=control) for d in (dynamics, PLAIN))
    assert len(kernels_of_chosen_steps(dynamics)) == 1
    assert {value.dtype for value in found.xs.values()} == {np.dtype(np.float32)}
    for name, value in expected.xs.items():
        np.testing.assert_allclose(found.xs[name], value, rtol=1e-4, atol=1e-4)


def test_counts_that_single_precision_cannot_hold_are_left_to_the_loop() -> None:
    dynamics = tx.compile(windy_body(), backend=tx.Native())
    start = {name: np.asarray(value, np.float32) for name, value in START.items()}
    control = tx.StepControl(max_steps=2**23)
    tx.integrate(dynamics, start, t1=0.1, rtol=1e-3, u=U, control=control)
    assert not kernels_of_chosen_steps(dynamics)


def test_steps_in_a_kernel_keep_to_their_side_of_a_jump() -> None:
    """Steps see times by a few units of round-off inside of their ends."""
    x, t = tx.State("x"), tx.Time()
    system = tx.System(rates={x: tx.Cond(t <= 0.7, x, -x) + tx.Cond(t >= 1.3, 100.0, 0.0)})
    dynamics = tx.compile(system, backend=tx.Native())

    control = tx.StepControl(max_steps=15)
    found = tx.integrate(dynamics, {"x": 1.0}, t1=2.0, rtol=1e-6, jumps=[0.7, 1.3], control=control)
    end = 100.0 + (np.exp(0.7 - 0.6) - 100.0) * np.exp(-0.7)
    np.testing.assert_allclose(found.xs["x"], [end], rtol=1e-6)
    assert kernels_of_chosen_steps(dynamics)


def test_other_numbers_do_not_compile_again() -> None:
    dynamics = tx.compile(windy_body(), backend=tx.Native())
    for rtol, t1 in ((1e-4, 0.1), (1e-7, 0.5)):
        tx.integrate(dynamics, START, t1=t1, rtol=rtol, u=U)
    assert len(kernels_of_chosen_steps(dynamics)) == 1
