"""Integrations made once and called often: the solutions of `tx.integrate`, values checked in every call."""

import functools
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from compilations import compilations

R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
J, torque = tx.Parameter("J", shape=(3,), value=[1.0, 2.0, 3.0]), tx.Control("torque", shape=(3,))
START = {"R": np.eye(3), "w": np.array([0.1, 0.2, 0.3])}
TIMES = np.array([0.0, 0.5, 1.0])
ROWS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@functools.cache
def top() -> tx.Dynamics:
    rates: dict[Any, Any] = {R: w, w: (torque - tx.linalg.Cross(w, J * w)) / J}
    return tx.compile(tx.System(rates, outputs={"pushed": torque @ w}), backend=tx.JAX())


@functools.cache
def options() -> dict[str, Any]:
    return {"t1": 1.0, "dt": 0.25, "save_at": TIMES}


@functools.cache
def flown() -> Any:
    return tx.simulator(top(), START, u={"torque": tx.FirstOrderHold(TIMES, ROWS)}, **options())


def same(found: tx.Solution, expected: tx.Solution) -> None:
    assert found.stats == expected.stats
    assert found.result is expected.result
    for name in ("R", "w"):
        np.testing.assert_array_equal(found.xs[name], expected.xs[name])
    np.testing.assert_array_equal(found.ts, expected.ts)
    np.testing.assert_allclose(found.outputs["pushed"], expected.outputs["pushed"], rtol=1e-14)


def test_solutions_are_those_of_integrate_and_nothing_compiles_anew() -> None:
    """Whatever is left out is what it was made with, not what the last call had."""
    table, fly = tx.FirstOrderHold(TIMES, 2.0 * ROWS), flown()
    start, params = {"w": np.array([1.0, -0.2, 0.5])}, {"J": np.array([2.0, 2.0, 3.0])}
    integrate = functools.partial(tx.integrate, top(), **options())
    before = {"torque": tx.FirstOrderHold(TIMES, ROWS)}
    same(fly(), integrate(START, u=before))
    with compilations() as more:
        fly(start, u={"torque": table}, params=params)
    assert not more
    same(fly(start, u={"torque": table}, params=params), integrate(START | start, u={"torque": table}, params=params))
    same(fly({"w": [0, 1, 0]}), integrate(START | {"w": [0, 1, 0]}, u=before))
    same(fly(), integrate(START, u=before))


@functools.cache
def grows() -> tx.Dynamics:
    x = tx.State("x")
    return tx.compile(tx.System({x: x * x}), backend=tx.JAX())


def test_derivatives_and_batches_are_those_of_integrate() -> None:
    """x = x0 / (1 - x0 t), whose slope by x0 is 1 / (1 - x0 t)^2."""
    fly = tx.simulator(grows(), {"x": 0.5}, t1=1.0, dt=0.01)
    starts = np.array([0.1, 0.3, 0.5])
    found = jax.vmap(jax.value_and_grad(lambda x: fly({"x": x}).xs["x"][0]))(starts)
    np.testing.assert_allclose(found, (starts / (1.0 - starts), 1.0 / (1.0 - starts) ** 2), rtol=1e-7)


def test_failures_raise_as_they_do_there_unless_told_otherwise() -> None:
    for throw in (True, False):
        fly = tx.simulator(grows(), {"x": 0.5}, t1=1.0, dt=0.01, throw=throw)
        assert fly().result is tx.Result.SUCCESS
        if throw:
            with pytest.raises(tx.IntegrationError, match="'x'"):
                fly({"x": 1e200})
        else:
            assert fly({"x": 1e200}).result is tx.Result.NON_FINITE


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"x0": {"v": np.zeros(3)}}, "unknown key 'v' in x0.*'R', 'w'"),
        ({"x0": [1.0]}, "x0 must be a dict"),
        ({"x0": {"w": np.zeros(2)}}, r"x0\['w'\] expects shape \(3,\), got \(2,\)"),
        ({"x0": {"w": np.array([0.0, np.nan, 0.0])}}, r"x0\['w'\] expects finite"),
        ({"x0": {"R": 2.0 * np.eye(3)}}, r"x0\['R'\] is not an element of SO3"),
        ({"params": {"J": "heavy"}}, r"params\['J'\] expects real numbers"),
        ({"u": {"torque": np.zeros(3)}}, "FirstOrderHold of shape"),
        ({"u": {"torque": tx.ZeroOrderHold(TIMES, ROWS)}}, "FirstOrderHold of shape"),
        ({"u": {"torque": tx.FirstOrderHold(TIMES + [0.0, 0.1, 0.0], ROWS)}}, "at the same times"),
    ],
)
def test_values_of_a_call_are_checked(given: dict[str, Any], words: str) -> None:
    with pytest.raises(tx.InputError, match=words):
        flown()(**given)


def test_a_start_off_the_manifold_is_refused_in_a_call_too() -> None:
    x, y = tx.State("x"), tx.State("y")
    on_line = tx.System({x: -x, y: -y}, corrections={x: y - x, y: 0.0 * y})
    fly = tx.simulator(tx.compile(on_line, backend=tx.JAX()), {"x": 1.0, "y": 1.0}, t1=0.1, dt=0.1)
    fly({"x": 2.0, "y": 2.0})
    with pytest.raises(tx.InputError, match="from the manifold"):
        fly({"x": 2.0})


def test_what_cannot_stay_is_refused_when_it_is_made() -> None:
    with pytest.raises(tx.InputError, match=r"no option 'save_att'.*\n.*'save_at'"):
        tx.simulator(top(), START, save_att=TIMES)
    with pytest.raises(tx.InputError, match="traced"):
        jax.jit(lambda spin: tx.simulator(top(), START | {"w": spin}, u={"torque": ROWS[0]}, **options()))(START["w"])
    fly = tx.simulator(top(), START, u=lambda t: {"torque": t * ROWS[0]}, t1=0.1, dt=0.1)
    with pytest.raises(tx.InputError, match="the function u stays"):
        fly(u={"torque": ROWS[0]})
