"""Warm starts: multipliers, scales and a barrier that fits, and what is moved on for a receding horizon."""

import functools
import pickle
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.trajectory import Problem, Status, TrajectoryResult

LIMIT, LENGTH = 0.8, 0.25


@functools.cache
def regulator() -> Problem:
    """A mass is brought to rest with a limited force, which the start keeps at its limit; the speed is limited too."""
    p, v, u = tx.State("p"), tx.State("v", min=-0.55), tx.Control("u", min=-LIMIT, max=LIMIT)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    cost = tx.Minimize(5.0 * (p * p + v * v), running=p * p + v * v + 0.1 * u * u)
    return Problem(dynamics, cost, nodes=17, final_time=16 * LENGTH, initial={p: 1.0, v: 0.5})


@functools.cache
def solution() -> TrajectoryResult:
    result = regulator().solve()
    assert result.solved
    assert {f"u >= {-LIMIT:g}", "v >= -0.55"} <= set(result.active)
    return result


def test_a_solution_is_its_own_warm_start() -> None:
    again = regulator().solve(warm=solution())
    assert again.solved
    assert again.iterations == 0
    np.testing.assert_array_equal(again.us["u"], solution().us["u"])


def test_a_solution_with_many_limits_is_its_own_warm_start() -> None:
    """Limits that do not bind have a share of the barrier for their multipliers: many add up to a gap."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    problem = Problem(dynamics, tx.Minimize(running=u * u), nodes=101, final_time=3.0, **ends)
    result = problem.solve()
    assert result.solved
    assert problem.solve(warm=result).iterations == 0


@pytest.mark.parametrize("size", [1e-3, 3e-2, 0.1])
def test_a_neighbour_takes_few_iterations(size: float) -> None:
    start = {"p": 1.0 + size, "v": 0.5 - size}
    cold, guessed = (regulator().solve(initial=start, guess=g) for g in (None, {**solution().xs, **solution().us}))
    warm = regulator().solve(initial=start, warm=solution())
    assert warm.solved
    assert warm.iterations <= 8
    assert warm.iterations < min(cold.iterations, guessed.iterations)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
    assert warm.xs["p"][0] == 1.0 + size


def test_a_warm_start_far_away_is_solved_too() -> None:
    start = {"p": -3.0, "v": 0.0}
    warm, cold = regulator().solve(initial=start, warm=solution()), regulator().solve(initial=start)
    assert warm.solved
    assert warm.cost == pytest.approx(cold.cost, rel=1e-6)


def test_units_are_kept_close_by_and_measured_anew_far_away() -> None:
    first = regulator().solve(initial={"p": 1.0, "v": 0.5}, warm=solution())  # those of a guess fit that guess
    known = first.warm.units
    assert known is not None
    near = regulator().solve(initial={"p": 1.01, "v": 0.5}, warm=first).warm.units
    far = regulator().solve(initial={"p": -3.0, "v": 0.0}, warm=first).warm.units
    assert near is not None
    assert far is not None
    np.testing.assert_array_equal(near.v, known.v)
    assert far.cost > 2.0 * known.cost


def test_what_is_shifted_holds_its_last_control_and_follows_the_dynamics() -> None:
    own, moved = solution(), solution().shifted(3)
    np.testing.assert_array_equal(moved.point.us[:-3, 0], own.us["u"][3:])
    np.testing.assert_array_equal(moved.point.us[-3:, 0], np.full(3, own.us["u"][-1]))
    np.testing.assert_array_equal(moved.dynamics[:-3], own.warm.dynamics[3:])
    held = own.us["u"][-1]
    p, v = own.xs["p"][-1], own.xs["v"][-1]
    for node in (-3, -2, -1):
        p, v = p + LENGTH * v + LENGTH**2 / 2.0 * held, v + LENGTH * held
        assert moved.point.xs["p"][node] == pytest.approx(p, abs=1e-12)
        assert moved.point.xs["v"][node] == pytest.approx(v, abs=1e-12)


def test_a_receding_horizon_takes_few_iterations() -> None:
    """In closed loop against a push that the problem does not know."""
    plan, x = solution(), {"p": 1.0, "v": 0.5}
    for _ in range(6):
        u = float(plan.us["u"][0]) + 0.05
        x = {"p": x["p"] + LENGTH * x["v"] + LENGTH**2 / 2.0 * u, "v": x["v"] + LENGTH * u}
        plan = regulator().solve(initial=x, warm=plan.shifted())
        assert plan.solved
        assert plan.iterations <= 9
    assert abs(x["p"]) < 0.95


def test_a_warm_start_travels() -> None:
    own = pickle.loads(pickle.dumps(solution()))
    assert regulator().solve(warm=own).iterations <= 2


BAD: list[tuple[dict[str, Any], str]] = [
    ({"warm": 3.0}, "warm expects a result"),
    ({"warm": solution, "guess": {"p": 0.0}}, "leave out guess"),
]


@pytest.mark.parametrize(("case", "text"), BAD, ids=["number", "guess"])
def test_nonsense_is_refused(case: dict[str, Any], text: str) -> None:
    case = {name: value() if callable(value) else value for name, value in case.items()}
    with pytest.raises(tx.TrajectoryError, match=text):
        regulator().solve(**case)


def test_a_warm_start_of_another_mesh_is_refused() -> None:
    own = regulator()
    other = Problem(own.dynamics, tx.Minimize(tx.State("p") ** 2), nodes=5, final_time=1.0)
    with pytest.raises(tx.TrajectoryError, match="same states, controls, nodes"):
        other.solve(warm=solution())


def test_another_status_is_as_true() -> None:
    assert regulator().solve(initial={"p": 1.0, "v": -0.55}, warm=solution(), max_iterations=1).status is (
        Status.MAX_ITERATIONS
    )
