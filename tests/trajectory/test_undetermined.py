"""Controls that an optimum leaves open, against the moves that keep the ends of double integrators."""

from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.trajectory import Linear, Phase, Problem, QuasiNewton

INTERVALS = 24
q, w = tx.State("q", shape=(2,)), tx.State("w", shape=(2,))
u = tx.Control("u", shape=(2,), min=[-1.0, -1.0], max=[1.0, 1.0])
DYNAMICS = tx.compile(tx.System(rates={q: w, w: u}))
AT_REST, ENDS = {q: [0.0, 0.0], w: [0.0, 0.0]}, {q: [1.0, 0.2], w: [0.0, 0.0]}


def fastest(running: Any = None, **options: Any) -> Problem:
    """Two points that are pushed: the first, which goes farther, decides the time, which is 2."""
    stated: dict[str, Any] = {"nodes": INTERVALS + 1, "final_time": (0.5, 6.0), "initial": AT_REST, "final": ENDS}
    return Problem(DYNAMICS, tx.Minimize(tx.Time(), running=running), **stated | options)


def told(result: Any) -> list[str]:
    """The lines of `explain` on what is not determined."""
    return [line for line in result.explain().splitlines() if "does not determine" in line]


def test_the_control_that_does_not_decide_the_time_is_named() -> None:
    result = fastest().solve()
    assert result.final_time == pytest.approx(2.0, abs=1e-6)
    assert list(result.undetermined) == ["u[1]"]
    (line,) = told(result)
    assert "does not determine u[1] (in 24 of 24 intervals)" in line
    # Held pushes that change neither the last speed nor the last place.
    step = 2.0 / INTERVALS
    begins = step * np.arange(INTERVALS)
    rows = np.stack([np.full(INTERVALS, step), step * (2.0 - begins - 0.5 * step)])
    kept = np.eye(INTERVALS) - rows.T @ np.linalg.solve(rows @ rows.T, rows)
    np.testing.assert_allclose(result.undetermined["u[1]"], np.diag(kept), atol=1e-5)


def test_the_proposed_weight_determines_it() -> None:
    (line,) = told(fastest().solve())
    weight, name = line.partition("running=... + ")[2].split(" * ")
    assert name == "u[1]**2"
    result = fastest(float(weight) * u[1] ** 2).solve()
    assert result.undetermined == {}
    assert told(result) == []
    assert result.final_time == pytest.approx(2.0, abs=1e-5)
    again = fastest(float(weight) * u[1] ** 2).solve(seed=3)
    np.testing.assert_allclose(again.us["u"][:, 1], result.us["u"][:, 1], atol=1e-3)


@pytest.mark.parametrize("running", [tx.linalg.Sum(u**2), 1e-3 * tx.linalg.Sum(u**2)])
def test_strict_minima_have_none(running: Any) -> None:
    assert fastest(running).solve().undetermined == {}
    assert fastest(running, final_time=3.0).solve().undetermined == {}


def test_a_steered_thrust_is_determined_whatever_its_unit_is() -> None:
    """Problem 9 of COPS: the rate of the angle is fifty times as large as its unit."""
    x, y = tx.State("x", shape=(2,)), tx.State("y", shape=(2,))
    angle = tx.Control("angle", min=-1.5, max=1.5)
    dynamics = tx.compile(
        tx.System(rates={x: tx.Concat(x[1], 100.0 * tx.Cos(angle)), y: tx.Concat(y[1], 100.0 * tx.Sin(angle))})
    )
    ends: Any = {"initial": {x: [0.0, 0.0], y: [0.0, 0.0]}, "final": {x: [None, 45.0], y: [5.0, 0.0]}}
    options: Any = {"nodes": 31, "final_time": (0.1, 10.0), "controls": Linear()}
    result = Problem(dynamics, tx.Minimize(tx.Time()), **ends, **options).solve()
    assert result.final_time == pytest.approx(0.554571, rel=1e-3)
    assert result.undetermined == {}


def test_what_has_no_exact_hessian_says_nothing() -> None:
    assert fastest(hessian=QuasiNewton()).solve().undetermined == {}
    assert fastest().solve(max_iterations=3).undetermined == {}


def test_rates_of_continuous_controls_and_phases() -> None:
    assert list(fastest(controls=Linear()).solve().undetermined) == ["Rate(u)[1]"]
    half = {q: [0.5, 0.1]}
    first = Phase(DYNAMICS, nodes=9, final_time=(0.2, 3.0), initial=AT_REST, final=half, name="first")
    last = Phase(DYNAMICS, tx.Minimize(tx.Time()), nodes=9, final_time=(0.2, 3.0), final=ENDS, name="last")
    result = Problem([first, last]).solve()
    assert result.cost == pytest.approx(2.0, abs=1e-6)
    assert sorted(result.undetermined) == ["first: u[1]", "last: u[1]"]
    (line,) = told(result)
    assert "last: u[1] (in 8 of 8 intervals)" in line


def test_a_free_parameter_that_a_control_can_replace() -> None:
    push = tx.Parameter("push", value=0.0)
    dynamics = tx.compile(tx.System(rates={q: w, w: u + push}))
    cost = tx.Minimize(running=tx.linalg.Sum((u + push) ** 2))
    ends: Any = {"initial": AT_REST, "final": ENDS, "final_time": 3.0}
    result = Problem(dynamics, cost, nodes=9, free={push: (-0.2, 0.2)}, **ends).solve()
    assert result.solved
    assert sorted(result.undetermined) == []  # one direction of 17: no control alone is open
