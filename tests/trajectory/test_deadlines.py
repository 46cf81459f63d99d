"""Solves that end early: the best iterate, its measures, and why; and strategies left out."""

import time

import numpy as np
import pytest

import twistax as tx
from twistax.errors import TrajectoryError
from twistax.trajectory import IPOPT, Problem, Status, Strategy


def swing_up(nodes: int = 41) -> Problem:
    """A pendulum to its upright rest by a torque that is too small to lift it at once."""
    angle, rate, torque = tx.State("angle"), tx.State("rate"), tx.Control("torque", min=-0.4, max=0.4)
    dynamics = tx.compile(tx.System(rates={angle: rate, rate: torque - tx.Sin(angle)}))
    ends = {"initial": {angle: 0.0, rate: 0.0}, "final": {angle: np.pi, rate: 0.0}}
    return Problem(dynamics, tx.Minimize(running=torque**2), nodes=nodes, final_time=12.0, **ends)


def test_a_callback_ends_a_solve_at_the_best_iterate() -> None:
    whole = swing_up().solve()
    assert whole.solved
    seen: list[int] = []

    def enough(iteration: int, cost: float, violation: float) -> bool:
        seen.append(iteration)
        return iteration >= 6

    result = swing_up().solve(callback=enough)
    assert result.status is Status.STOPPED
    assert seen == list(range(7))
    assert result.iterations == 6 < whole.iterations
    assert np.isfinite(result.cost)
    assert 0.0 < result.violation == result.optimality.feasibility
    assert "STOPPED" in result.message


def test_a_callback_is_not_asked_again() -> None:
    """Neither by a run in other units, nor by one that leaves a saddle."""
    problem = swing_up()
    for last in range(1, 16, 2):
        seen: list[int] = []

        def enough(iteration: int, cost: float, violation: float, last: int = last, seen: list[int] = seen) -> bool:
            seen.append(iteration)
            return iteration == last

        assert problem.solve(callback=enough).status is Status.STOPPED
        assert seen == list(range(last + 1))


def test_a_comparison_of_numpy_ends_a_solve() -> None:
    result = swing_up().solve(callback=lambda iteration, cost, violation: np.abs(cost) < np.inf)
    assert result.status is Status.STOPPED


def test_what_a_callback_returns_otherwise_changes_nothing() -> None:
    plain = swing_up().solve()
    assert swing_up().solve(callback=lambda iteration, cost, violation: 1).iterations == plain.iterations


def test_time_that_runs_out_ends_a_solve() -> None:
    def slow(iteration: int, cost: float, violation: float) -> None:
        time.sleep(0.02)

    result = swing_up().solve(callback=slow, max_seconds=0.1)
    assert result.status is Status.OUT_OF_TIME
    assert 1 <= result.iterations <= 5
    assert swing_up().solve(max_seconds=1e3).solved


def test_no_further_try_begins_after_the_end() -> None:
    count = 0

    def first(iteration: int, cost: float, violation: float) -> bool:
        nonlocal count
        count += iteration == 0
        return iteration >= 2

    assert swing_up().solve(callback=first, guesses=5, refine=1e-6).status is Status.STOPPED
    assert count == 1


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_times_without_meaning_are_refused(seconds: float) -> None:
    with pytest.raises(TrajectoryError, match="max_seconds"):
        swing_up().solve(max_seconds=seconds)


def test_solvers_of_others_have_a_limit_of_their_own() -> None:
    with pytest.raises(TrajectoryError, match=r"IPOPT\(max_seconds=\.\.\.\)"):
        swing_up().solve(max_seconds=1.0, solver=IPOPT())


def test_strategies_are_chosen_by_name() -> None:
    """The scales of this start fit nothing: alone the method takes another number of steps."""
    problem = swing_up()
    far = {"guess": {"torque": np.full(40, 0.3)}, "initial": {"angle": 0.0, "rate": 0.0}}
    assert problem.solve(**far, strategies=tuple(Strategy)).iterations == problem.solve(**far).iterations
    alone = problem.solve(**far, strategies=(), max_iterations=300)
    assert alone.iterations != problem.solve(**far).iterations
    for wrong in (("RESCALING",), "RESCALING"):
        with pytest.raises(TrajectoryError, match="in a tuple"):
            problem.solve(strategies=wrong)
