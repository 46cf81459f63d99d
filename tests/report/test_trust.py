"""The sweep over units, limits and starts: what it states, and what it counts."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.report.registry import OPTIMAL
from twistax.report.sections import problems, trust
from twistax.report.sections.curvature import is_saddle
from twistax.report.sections.packed import packed
from twistax.report.sections.problems import Known


def test_every_problem_is_asked_the_same() -> None:
    assert {check.what for check in OPTIMAL["trust"]} == set(trust.SWEEPS)
    assert len(OPTIMAL["trust"]) == 7 * len(trust.SWEEPS)
    asked = {(row.by, row.expected.text) for row in OPTIMAL["trust"]}
    assert {text for by, text in asked if by == "SOLVED"} == {"at least 36", "at least 39", "at least 0"}
    assert {text for by, text in asked if by == "SOLVED at saddles"} == {"at most 0"}
    assert {text for by, text in asked if by == "SOLVED at no stationary point"} == {"at most 0"}
    # Other minima are not wrong.
    assert {text for by, text in asked if by == "SOLVED at other stationary points"} == {""}


def test_a_restated_problem_is_the_same_in_other_units() -> None:
    """x' = v t, v' = u: units of x, v, u, t and the cost are 10, 1/10, 10, 10 and 1/10 new ones."""
    x, v, u = tx.State("x"), tx.State("v", min=-1.0), tx.Control("u", shape=(1,), max=2.0)
    system = tx.System(rates={x: v * tx.Time(), v: u[0]}, constraints={"fast": v <= 3.0})
    ends = {"initial": {x: 1.0, v: 0.5}, "final": [{x: 4.0}, v <= 2.0], "guess": {"v": [0.5, 1.0]}}
    objective = tx.Minimize(tx.Time() * x, running=u @ u)
    times = {"final_time": (1.0, 6.0), "final_time_guess": 2.0}
    plain = tx.trajectory.Problem(tx.compile(system), objective, nodes=2, **times, **ends)
    found = trust.InOtherUnits(10.0, 100.0, {"x": 4.0, "v": 3.0, "u": 2.0})(plain).stated
    system = found["dynamics"].system
    rates = tx.lower([*system.rates.values()])(20.0, {"v": 0.7}, {"u": [40.0]})
    # In old units t = 2, x = 3, v = 7, u = 4.
    np.testing.assert_allclose(rates, [7.0 * 2.0 * 10.0 / 10.0, 4.0 / 10.0 / 10.0], rtol=1e-6)
    costs = tx.lower([found["objective"].final, found["objective"].running])(20.0, {"x": 30.0}, {"u": [40.0]})
    np.testing.assert_allclose(costs, [6.0 / 10.0, 16.0 / 10.0 / 10.0], rtol=1e-6)
    own = {leaf.name: leaf for leaf in (*system.states, *system.controls)}
    np.testing.assert_allclose([own["x"].min, own["x"].max], [-8000.0, 8000.0])
    np.testing.assert_allclose([own["v"].min, own["v"].max], [-0.1, 60.0])
    np.testing.assert_allclose([own["u"].min, own["u"].max], [[-4000.0], [20.0]])
    assert {s.name: float(value) for s, value in found["initial"][0].items()} == {"x": 10.0, "v": 0.05}
    np.testing.assert_allclose(found["final_time"], (0.1, 6000.0))
    assert found["final_time_guess"] == 20.0
    np.testing.assert_allclose(found["guess"][own["v"]], [0.05, 0.1])
    for asked, value in ((system.constraints["fast"], -1.0), (found["final"][1], 0.0)):
        (residual,) = tx.lower([asked.residual()])(0.0, {"v": 0.2})
        assert math.isclose(float(residual), value, rel_tol=1e-6, abs_tol=1e-6)


def test_a_packed_problem_is_the_same_with_one_vector() -> None:
    x, v, g = tx.State("x", min=-1.0), tx.State("v", shape=(2,), max=3.0), tx.State("g", group=tx.SO3)
    u = tx.Control("u", shape=(3,))
    system = tx.System(rates={x: v[0] * v[1], v: u[:2] + x, g: u}, constraints={"fast": v @ v <= 4.0})
    ends: dict[str, Any] = {"initial": {x: 1.0, g: np.eye(3)}, "final": [{v: [0.5, np.nan]}, x <= 2.0]}
    guess = {x: [1.0, 1.5, 2.0], u: np.full(3, 0.25)}
    objective = tx.Minimize(x, running=u @ u + v[1])
    plain = tx.trajectory.Problem(tx.compile(system), objective, nodes=3, final_time=1.0, guess=guess, **ends)
    found = packed(plain).stated
    own = found["dynamics"].system
    (whole,) = (s for s in own.states if s.name == "x")
    np.testing.assert_array_equal(whole.min, [-1.0, -np.inf, -np.inf])
    np.testing.assert_array_equal(whole.max, [np.inf, 3.0, 3.0])
    at = {"x": [2.0, 0.5, 3.0]}, {"u": [0.1, 0.2, 0.3]}
    rates = tx.lower([own.rates["x"], own.rates["g"] + 0.0 * whole[0] * own.controls[0]])(0.0, *at)
    np.testing.assert_allclose(rates, [[1.5, 2.1, 2.2], [0.1, 0.2, 0.3]], rtol=1e-6)
    exprs = [found["objective"].final, found["objective"].running, own.constraints["fast"].residual()]
    np.testing.assert_allclose(tx.lower(exprs)(0.0, *at), [2.0, 3.14, 5.25], rtol=1e-6)
    np.testing.assert_array_equal(found["initial"][0]["x"], [1.0, np.nan, np.nan])
    np.testing.assert_array_equal(found["final"][0]["x"], [np.nan, 0.5, np.nan])
    (late,) = tx.lower([found["final"][1].residual()])(0.0, at[0])
    assert float(late) == 0.0
    np.testing.assert_allclose(found["guess"]["x"][:, 0], [1.0, 1.5, 2.0])
    np.testing.assert_array_equal(found["guess"]["u"], np.full(3, 0.25))


def test_phases_are_restated_with_their_links() -> None:
    """m falls by 1 at the join: units of m and u are 10 and 1/10 new ones."""
    m, u = tx.State("m", scale=2.0), tx.Control("u", guess=0.5)
    dynamics = tx.compile(tx.System(rates={m: u}))
    last = tx.trajectory.Phase(dynamics, tx.Maximize(m), nodes=3, final_time=2.0)
    first = tx.trajectory.Phase(dynamics, nodes=2, final_time=(1.0, 2.0), initial={m: 3.0})
    plain = tx.trajectory.Problem([first, last], links=[{m: m - 1.0}])
    found = trust.InOtherUnits(10.0, 1.0, {"m": 4.0, "u": 2.0})(plain)
    (link,) = found.stated["links"]
    (left,) = tx.lower([*link.values()])(0.0, {"m": 20.0})
    assert float(left) == 10.0
    assert [phase.final_time for phase in found.phases] == [(10.0, 20.0), 20.0]
    assert [phase.final_time_guess for phase in found.phases] == [15.0, 20.0]
    (state,), (control,) = found.parts[0].dynamics.states, found.parts[0].dynamics.controls
    assert (float(state.scale), float(control.guess)) == (20.0, 0.05)


@pytest.mark.parametrize(("sign", "saddle"), [(-1.0, True), (1.0, False)])
def test_a_saddle_is_told_from_a_minimum(sign: float, saddle: bool) -> None:
    """x' = u, cost sign x(T)^2 with x(0) = 0, and u = 0 meets the first-order conditions of both."""
    x, u = tx.State("x"), tx.Control("u", min=-1.0, max=1.0)
    objective = tx.Minimize(sign * x**2, running=0.0 * u)
    problem = tx.trajectory.Problem(
        tx.compile(tx.System(rates={x: u})), objective, nodes=2, final_time=1.0, initial={x: 0.0}, substeps=1
    )
    result = problem.solve(tolerance=1e-6, max_iterations=1)
    still = result.warm.point._replace(xs={"x": np.zeros(2)}, us=np.zeros((1, 1)))
    none = {"dynamics": np.zeros((1, 1)), "rows": np.zeros_like(result.warm.rows)}
    there = dataclasses.replace(result, warm=dataclasses.replace(result.warm, point=still, **none))
    assert is_saddle(there) is saddle


def test_what_does_not_stay_is_counted() -> None:
    sweep = trust.StartSweep(Known(problems.goddard, 3.0))
    stays = {3.0: True, 2.9999: True, 2.5: True, 2.0: True, 1.0: False, 9.0: True}
    sweep.__dict__["_came"] = [
        trust.Tried(cost != 9.0, cost, 1, own, own and cost < 2.5) for cost, own in stays.items()
    ]
    assert sweep.best == 3.0
    assert [each.cost for each in sweep.elsewhere] == [2.5, 2.0, 1.0]
    assert [each.cost for each in sweep.wrong] == [1.0]
    assert [each.cost for each in sweep.saddles] == [2.0]
    assert math.isclose(sweep.spread(), 1e-4 / 3.0)
    assert sweep.excess_of_best() == 0.0


def test_a_sweep_that_fails_runs_once_and_fails_every_check() -> None:
    made = []

    def make(**_: Any) -> Any:
        made.append(True)
        raise tx.ModelError("no such problem")

    sweep = trust.StartSweep(Known(make, 1.0))
    for measure in (sweep.excess_of_best, sweep.spread, lambda: sweep.wrong):
        with pytest.raises(tx.ModelError, match="no such problem"):
            measure()
    assert len(made) == 1


def test_the_reach_is_that_of_an_optimum() -> None:
    known = Known(problems.goddard, 1.0)
    known.__dict__["result"] = SimpleNamespace(solved=False, status=tx.trajectory.Status.STALLED)
    with pytest.raises(RuntimeError, match="plainly stated it ends in STALLED"):
        _ = trust.StartSweep(known).tried
