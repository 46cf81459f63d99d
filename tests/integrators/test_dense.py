"""Dense output: the state at any time, on the manifold, as accurate as the solution."""

import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.scenes import SCENES

SCENE = SCENES["euler-top"]
DOP853 = tx.RKMK(tx.tableaus.DOP853)
TIMES = np.linspace(0.0, 20.0, 41) ** 2 / 20.0
WAYS = {"fixed": {"steps": 400}, "chosen": {"rtol": 1e-11, "atol": 1e-11}}

#: Both, the fixed one among the slow tests.
CHOSEN_FIRST = ["chosen", pytest.param("fixed", marks=pytest.mark.slow)]


def integrated(**options: object) -> tx.Solution:
    return SCENE.integrate(method=DOP853, dense=True, **options)


@pytest.mark.parametrize("way", WAYS)
def test_every_state_is_the_true_one_and_a_rotation(way: str) -> None:
    found = integrated(**WAYS[way]).evaluate(TIMES)
    assert found["R"].shape == (41, 3, 3)
    assert float(jnp.max(jax.vmap(tx.SO3.defect)(found["R"]))) < 1e-14
    errors = [
        SCENE.error({name: np.asarray(value[i]) for name, value in found.items()}, t) for i, t in enumerate(TIMES)
    ]
    assert max(errors) < 1e-9


@pytest.mark.parametrize("way", CHOSEN_FIRST)
def test_it_is_what_saving_gives_and_does_not_disturb_the_solution(way: str) -> None:
    dense, plain = integrated(**WAYS[way]), SCENE.integrate(method=DOP853, save_at=TIMES, **WAYS[way])
    assert dense.stats.accepted == plain.stats.accepted
    found = dense.evaluate(TIMES)
    for name, value in plain.xs.items():
        np.testing.assert_allclose(found[name], value, atol=1e-13)
    np.testing.assert_allclose(dense.evaluate(20.0)["w"], dense.xs["w"][-1], atol=1e-14)
    np.testing.assert_allclose(dense.evaluate(0.0)["w"], SCENE.start["w"], atol=1e-15)


@pytest.mark.parametrize("way", CHOSEN_FIRST)
def test_the_slope_in_time_is_the_rate(way: str) -> None:
    sol = integrated(**WAYS[way])
    state, slope = jax.jvp(lambda t: sol.evaluate(t)["w"], (jnp.asarray(3.3),), (jnp.asarray(1.0),))
    rate = SCENE.dynamics(3.3, sol.evaluate(3.3), None, SCENE.params)["w"]
    np.testing.assert_allclose(slope, rate, atol=1e-9)
    np.testing.assert_allclose(state, jax.jit(lambda s, t: s.evaluate(t)["w"])(sol, 3.3), atol=1e-14)


@pytest.mark.slow
def test_its_derivative_with_respect_to_the_start_is_that_of_a_shorter_solution() -> None:
    x, k = tx.State("x"), tx.Parameter("k", value=0.5)
    decay = tx.compile(tx.System(rates={x: -k * x * x}))

    def at(x0: jax.Array, t: float) -> jax.Array:
        sol = tx.integrate(decay, {"x": x0}, t1=2.0, rtol=1e-11, method=DOP853, dense=True)
        return sol.evaluate(t)["x"]

    for t in (0.0, 0.7, 2.0):  # x = x0 / (1 + k x0 t)
        assert float(jax.grad(at)(3.0, t)) == pytest.approx(1.0 / (1.0 + 0.5 * 3.0 * t) ** 2, rel=1e-8)


def test_a_state_comes_from_the_step_that_holds_it() -> None:
    """x' = F jumps from 1 to -5 at 0.5: a step from before it to a time after it would miss."""
    x, F = tx.State("x"), tx.Control("F")
    push = tx.compile(tx.System(rates={x: F}))
    u = {"F": tx.ZeroOrderHold(np.array([0.0, 0.5]), np.array([1.0, -5.0]))}
    sol = tx.integrate(push, {"x": 0.0}, t1=1.0, rtol=1e-9, u=u, dense=True)
    np.testing.assert_allclose(sol.evaluate(np.array([0.49, 0.5, 0.51]))["x"], [0.49, 0.5, 0.45], atol=1e-14)


def test_a_solution_that_failed_can_be_read_up_to_there() -> None:
    x = tx.State("x")
    blow_up = tx.compile(tx.System(rates={x: x * x}))
    sol = tx.integrate(blow_up, {"x": 1.0}, t1=3.0, dt=0.01, dense=True, throw=False)
    assert sol.result is tx.Result.NON_FINITE
    assert float(sol.evaluate(0.5)["x"]) == pytest.approx(2.0, rel=1e-7)
    with pytest.raises(tx.InputError, match=r"evaluate expects times in \[0, 1.\d+\] \(the integrated span\), got 2"):
        sol.evaluate(2.0)


def test_what_was_not_kept_cannot_be_read() -> None:
    with pytest.raises(tx.InputError, match="has no dense output"):
        SCENE.integrate(method=DOP853, steps=100).evaluate(1.0)
    with pytest.raises(tx.InputError, match=r"times with shape \(n,\), got shape \(1, 2\)"):
        integrated(**WAYS["fixed"]).evaluate(np.zeros((1, 2)))


@pytest.mark.parametrize("how", [{"dt": 0.1}, {"rtol": 1e-7, "event": True}], ids=["fixed", "adaptive"])
def test_solutions_travel_with_their_dense_output(how: dict[str, Any]) -> None:
    R, x, u = tx.State("R", group=tx.SO3), tx.State("x"), tx.Control("u")
    dynamics = tx.compile(tx.System({R: np.array([0.1, 0.2, 0.3]) * x, x: u - x}))
    own = how | ({"event": tx.Event(x - 0.5)} if "event" in how else {})
    start, table = {"R": np.eye(3), "x": 1.0}, {"u": tx.ZeroOrderHold([0.0, 0.5], np.array([0.1, -0.1]))}
    solution = tx.integrate(dynamics, start, t1=1.0, u=table, dense=True, **own)
    back = pickle.loads(pickle.dumps(solution))
    assert (back.result, back.event, back.stats) == (solution.result, solution.event, solution.stats)
    for name, value in solution.evaluate(0.33).items():
        np.testing.assert_array_equal(back.evaluate(0.33)[name], value)
        np.testing.assert_array_equal(back.xs[name], solution.xs[name])
