"""The interface of integrate: grid, saved times, precision, failures, no second compilation."""

import functools
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import forced, free_body, start

import twistax as tx
from compilations import compilations
from twistax.tableaus import EULER, HEUN


@functools.cache
def decay() -> tx.Dynamics:
    """x' = -a x + b F."""
    x, F = tx.State("x"), tx.Control("F")
    a = tx.Parameter("a", value=1.0)
    return tx.compile(tx.System(rates={x: F - a * x}))


def test_without_save_at_only_the_end_comes_back() -> None:
    sol = tx.integrate(forced(), start(), t1=1.0, dt=0.3)
    assert sol.ts.shape == (1,)
    assert float(sol.ts[0]) == 1.0
    assert sol.xs["g"].shape == (1, 4, 4)
    assert sol.stats.steps == sol.stats["accepted"] == 3
    assert sol.stats.rejected == 0
    assert sol.stats.rhs_evaluations == 12
    assert sol.result is tx.Result.SUCCESS
    assert str(sol.result) == "SUCCESS: the end time was reached"
    with pytest.raises(tx.InputError, match="the counts are: 'steps', 'accepted'"):
        _ = sol.stats["stages"]


def test_dt_is_rounded_to_whole_steps_and_steps_may_be_given() -> None:
    by_dt = tx.integrate(forced(), start(), t1=1.0, dt=0.26)
    by_steps = tx.integrate(forced(), start(), t1=1.0, steps=4)
    np.testing.assert_array_equal(by_dt.xs["g"], by_steps.xs["g"])
    assert tx.integrate(forced(), start(), t1=1.0, dt=5.0).stats.steps == 1
    still = tx.integrate(forced(), start(), t0=1.0, t1=1.0, dt=0.1, save_at=[1.0])
    assert still.stats.steps == 0
    np.testing.assert_allclose(still.xs["g"][0], start()["g"], atol=1e-15)


def test_saved_times_on_the_grid_are_its_points() -> None:
    """0, a point that repeats, and the end; the rest of the solution is not disturbed."""
    sol = tx.integrate(forced(), start(), t1=1.0, dt=0.1, save_at=[0.0, 0.3, 0.3, 1.0])
    assert sol.stats.rhs_evaluations == 40
    np.testing.assert_array_equal(sol.xs["g"][0], start()["g"])
    np.testing.assert_array_equal(sol.xs["V"][1], sol.xs["V"][2])
    np.testing.assert_allclose(sol.xs["V"][1], tx.integrate(forced(), start(), t1=0.3, dt=0.1).xs["V"][0], rtol=1e-13)
    # Two programs, which XLA may round differently in the last place.
    end = tx.integrate(forced(), start(), t1=1.0, dt=0.1).xs["g"][0]
    np.testing.assert_allclose(sol.xs["g"][3], end, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("tableau", [EULER, HEUN, tx.tableaus.RK4], ids=lambda tableau: tableau.name)
def test_saved_times_off_the_grid_have_the_order_of_the_method(tableau: object) -> None:
    ts = np.array([0.137, 0.5, 0.777, 1.0])
    fine = tx.integrate(forced(), start(), t1=1.0, dt=1e-3, save_at=ts).xs
    errors = []
    for dt in (0.02, 0.01):
        sol = tx.integrate(forced(), start(), t1=1.0, dt=dt, method=tx.RKMK(tableau), save_at=ts)
        assert float(jnp.max(jax.vmap(tx.SE3.defect)(sol.xs["g"]))) < 1e-14
        errors.append(np.abs(np.asarray(sol.xs["g"] - fine["g"])).max(axis=(1, 2)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(np.full(4, tableau.order), abs=0.6)
    assert (errors[1][[0, 2]] < 3.0 * errors[1][3]).all()


def test_saved_times_may_be_coarse_single_precision_numbers() -> None:
    ts = np.array([0.1, 0.3, 0.7, 0.9], dtype=np.float32)
    sol = tx.integrate(forced(), start(), t1=1.0, dt=0.1, save_at=ts)
    assert sol.stats.rhs_evaluations == 40


def test_time_does_not_drift() -> None:
    """A pulse over the last of 1e5 steps in single precision: a time summed up step by step would miss its start."""
    x, h = tx.State("x"), 1e-5
    dynamics = tx.compile(tx.System(rates={x: tx.Where(tx.Time() >= 1.0 - 1.5 * h, 1.0, 0.0)}))
    sol = tx.integrate(dynamics, {"x": np.float32(0.0)}, t1=1.0, dt=h, method=tx.RKMK(EULER))
    assert float(sol.xs["x"][0]) == pytest.approx(h, rel=1e-6)


def test_single_precision_stays_single() -> None:
    x0 = {name: value.astype(np.float32) for name, value in start().items()}
    sol = tx.integrate(forced(), x0, t1=1.0, dt=0.01, save_at=[0.0, 0.5, 0.777, 1.0])
    assert {value.dtype for value in sol.xs.values()} == {jnp.dtype("float32")}
    assert sol.ts.dtype == jnp.float32
    full = tx.integrate(forced(), start(), t1=1.0, dt=0.01, save_at=[0.0, 0.5, 0.777, 1.0])
    np.testing.assert_allclose(sol.xs["g"], full.xs["g"], atol=1e-4)


def test_other_numbers_do_not_compile_again() -> None:
    dynamics = tx.compile(free_body())
    M = np.asarray(dynamics.system.parameters[0].value)

    def solve(dt: float, t1: float, seed: int, size: float, ts: list[float]) -> None:
        tx.integrate(dynamics, start(seed), t1=t1, dt=dt, params={"M": size * M}, save_at=ts)

    with compilations() as first:
        solve(0.1, 1.0, 3, 1.0, [0.11, 0.5])
    with compilations() as second:
        solve(0.03, 2.5, 4, 2.0, [0.2, 1.7])
    assert first
    assert not second


def test_other_controls_do_not_compile_again() -> None:
    dynamics = decay()
    ts = np.array([0.0, 1.0])
    forms = {
        "held": lambda k: {"F": k},
        "table": lambda k: {"F": tx.ZeroOrderHold(ts, k * ts)},
        "linear": lambda k: {"F": tx.FirstOrderHold(4.0 * ts - 0.1 * k, k * ts)},
    }
    for form in forms.values():
        tx.integrate(dynamics, {"x": 1.0}, t1=1.0, dt=0.1, u=form(1.0))
        with compilations() as more:
            tx.integrate(dynamics, {"x": 2.0}, t0=0.5, t1=3.0, dt=0.2, u=form(3.0))
        assert not more


@functools.cache
def blow_up() -> tx.Dynamics:
    """x' = x^2 reaches infinity at t = 1 from x = 1."""
    x, y = tx.State("x"), tx.State("y")
    return tx.compile(tx.System(rates={x: x * x, y: -y}))


def test_a_blow_up_raises_and_names_time_state_and_cause() -> None:
    with pytest.raises(tx.IntegrationError) as caught:
        tx.integrate(blow_up(), {"x": 1.0, "y": 1.0}, t1=5.0, dt=0.01, save_at=[0.5, 5.0])
    message = str(caught.value)
    assert message.startswith("state 'x' became infinite or NaN in the step from t = 1.0")
    assert "likely cause: the step 0.01 s is too long" in message
    assert "last finite state: |x| = " in message


def test_a_turn_is_too_far_for_exponential_coordinates_alone() -> None:
    """A spin that grows without bound: plain quaternions hold any turn, so that the length of the step is to blame."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    dynamics = tx.compile(tx.System(rates={R: w, w: 1e3 * tx.linalg.Norm(w) ** 2 * w}))
    start = {"R": np.eye(3), "w": np.array([0.0, 0.0, 50.0])}
    for chart, hint in (
        (None, "exponential coordinates support half a turn"),
        (tx.charts.Ambient(), "is too long for"),
    ):
        with pytest.raises(tx.IntegrationError, match=f"state .*'R'.*(.|\n)*{hint}"):
            tx.integrate(dynamics, start, t1=1.0, dt=0.1, method=tx.RKMK(tx.tableaus.RK4, chart))


def test_a_singular_rate_is_told_from_a_step_that_is_too_long() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -1.0 / x}))
    with pytest.raises(tx.IntegrationError, match="rate of 'x' is not finite there"):
        tx.integrate(dynamics, {"x": 0.0}, t1=1.0, dt=0.1)


def test_a_control_that_is_lost_on_the_way_is_named() -> None:
    def u(t: jax.Array) -> dict[str, jax.Array]:
        return {"F": jnp.sqrt(1.05 - t)}

    with pytest.raises(tx.IntegrationError, match=r"step from t = 1 s.\n  likely cause: control 'F' is not finite"):
        tx.integrate(decay(), {"x": 1.0}, t1=2.0, dt=0.1, u=u)


def test_throw_false_keeps_the_good_part() -> None:
    sol = tx.integrate(blow_up(), {"x": 1.0, "y": 1.0}, t1=5.0, dt=0.01, save_at=[0.5, 0.777, 3.0, 5.0], throw=False)
    assert sol.result is tx.Result.NON_FINITE
    np.testing.assert_allclose(sol.ts, [0.5, 0.777])
    np.testing.assert_allclose(sol.xs["x"], [2.0, 1.0 / (1.0 - 0.777)], rtol=1e-6)
    alone = tx.integrate(blow_up(), {"x": 1.0, "y": 1.0}, t1=5.0, dt=0.01, throw=False)
    assert alone.result == tx.Result.NON_FINITE
    assert 1.0 <= float(alone.ts[0]) < 1.1
    assert np.isfinite(alone.xs["x"]).all()
    assert alone.stats.steps == round(float(alone.ts[0]) / 0.01)


@pytest.mark.parametrize("how", [{"steps": 200}, {"rtol": 1e-6}])
def test_a_traced_end_that_was_not_reached_is_nan_and_derivatives_of_one_that_was_are_right(how: dict) -> None:
    dynamics = blow_up()

    def end(x: jax.Array) -> tx.Solution:
        return tx.integrate(dynamics, {"x": x, "y": 1.0}, t1=0.5, **how)

    sols = jax.jit(jax.vmap(end))(jnp.array([1.0, 5.0, 1.2]))
    assert [code == tx.Result.SUCCESS for code in sols.code] == [True, False, True]
    for value in sols.xs.values():
        np.testing.assert_array_equal(np.isnan(value[:, 0]), [False, True, False])
    np.testing.assert_array_equal(sols.ts[:, 0], 0.5)
    for derivative in (jax.grad, jax.jacfwd):
        slopes = jax.jit(jax.vmap(derivative(lambda x: end(x).xs["x"][0])))(jnp.array([1.0, 5.0, 1.2]))
        np.testing.assert_allclose(slopes[jnp.array([0, 2])], [4.0, 1.0 / (1.0 - 0.6) ** 2], rtol=1e-4)


@pytest.mark.parametrize("how", [{"steps": 200}, {"rtol": 1e-6}, {"steps": 200, "save_at": [0.1, 0.5]}])
def test_a_failure_under_grad_outside_of_jit_is_raised(how: dict) -> None:
    with pytest.raises(tx.IntegrationError, match="state 'x'"):
        jax.grad(lambda x: tx.integrate(blow_up(), {"x": x, "y": 1.0}, t1=0.5, **how).xs["x"][-1])(5.0)


@pytest.mark.parametrize("how", [{"steps": 4}, {"rtol": 1e-6}])
def test_traced_times_that_make_no_sense_give_nan(how: dict) -> None:
    dynamics = decay()

    @jax.jit
    def saved(save_at: jax.Array, t1: float = 1.0) -> tx.Solution:
        return tx.integrate(dynamics, {"x": 1.0}, t1=t1, u={"F": 0.0}, save_at=save_at, **how)

    def missing(sol: tx.Solution) -> list[bool]:
        assert (sol.result == tx.Result.NON_FINITE) == bool(np.isnan(sol.xs["x"]).any())
        return np.isnan(sol.xs["x"]).tolist()

    assert missing(saved(jnp.array([0.0, 0.5, 1.0]))) == [False, False, False]
    assert missing(saved(jnp.array([0.5, 2.0]))) == [False, True]
    assert missing(saved(jnp.array([-0.5, 0.5]))) == [True, False]
    assert missing(saved(jnp.array([0.5, 0.2]))) == [True, True]
    assert missing(saved(jnp.array([0.0, 0.5]), -1.0)) == [True, True]
    ends = jax.jit(lambda t1: tx.integrate(dynamics, {"x": 1.0}, t1=t1, u={"F": 0.0}, **how))
    assert missing(ends(-1.0)) == [False]
    assert missing(ends(np.nan)) == [True]
    assert missing(ends(0.0)) == [False]


def test_whole_numbers_of_numpy_are_numbers_of_steps(unchecked: None) -> None:
    sol = tx.integrate(decay(), {"x": 1.0}, t1=1.0, u={"F": 0.0}, steps=np.int64(10))
    assert sol.stats.steps == 10
    control = tx.StepControl(max_steps=np.int64(50), factormax=np.int32(5))
    assert control == tx.StepControl(max_steps=50, factormax=5)
    assert tx.integrate(decay(), {"x": 1.0}, t1=1.0, u={"F": 0.0}, rtol=1e-4, control=control).result == 0


def test_the_last_saved_time_lies_before_a_failure() -> None:
    with pytest.raises(tx.IntegrationError):
        tx.integrate(blow_up(), {"x": 1.0, "y": 1.0}, t1=5.0, dt=0.01, save_at=[0.5])


def test_stages_that_count_for_nothing_are_not_evaluated() -> None:
    """The last stage of this pair has no weight: a rate that is singular exactly there does no harm."""
    x, t = tx.State("x"), tx.Time()
    dynamics = tx.compile(tx.System(rates={x: 1.0 / tx.Sqrt(1.0 - t)}))
    sol = tx.integrate(dynamics, {"x": 0.0}, t1=1.0, steps=4, method=tx.RKMK(tx.tableaus.BOGACKI_SHAMPINE3))
    assert sol.stats.rhs_evaluations == 4 * 3
    assert 1.5 < float(sol.xs["x"][0]) < 2.0


@pytest.mark.parametrize("how", [{"steps": 4}, {"rtol": 1e-6}])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_traced_start_that_is_not_finite_is_told_by_the_result(how: dict[str, float], value: float) -> None:
    solve = jax.jit(lambda x: tx.integrate(decay(), {"x": x}, t1=1.0, u={"F": 0.0}, **how))
    assert solve(value).result == tx.Result.NON_FINITE
    assert solve(1.0).result == tx.Result.SUCCESS


def test_wrong_arguments_are_refused_by_the_name_of_the_function() -> None:
    for arguments, message in [
        (
            {"x0": {"x": 1.0}, "t1": 1.0, "dtt": 0.1},
            r"integrate\(\) got an unexpected .* 'dtt'; it expects 't1', 'dt', ",
        ),
        ({"x0": {"x": 1.0}, "dt": 0.1}, r"integrate\(\) missing a required argument: 't1'"),
        ({"t1": 1.0, "dt": 0.1}, r"integrate\(\) missing a required argument: 'x0'"),
    ]:
        with pytest.raises(TypeError, match=message):
            tx.integrate(decay(), **arguments)
    with pytest.raises(TypeError, match=r"expects 2 positional arguments \(dynamics, x0\), got 3.\n  fix: .* u, par"):
        tx.integrate(decay(), {"x": 1.0}, {"F": 0.0}, t1=1.0)  # type: ignore[call-arg]


def test_one_phase_and_several_have_the_same_options() -> None:
    one, several, phase = (
        inspect.signature(function).parameters for function in (tx.integrate, tx.integrate_phases, tx.Phase)
    )
    assert set(one) - set(several) == {"dynamics", "t1", "jumps", "event", "max_crossings"}
    assert set(several) - set(one) == {"phases", "links"}
    assert set(phase) - set(one) == {"duration", "name"}
    shared = set(several) & set(one) - {"x0"}
    assert {name: one[name].default for name in shared} == {name: several[name].default for name in shared}
