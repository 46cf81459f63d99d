"""Trajectories that are the worst ones are left, or named."""

import pytest
from trajectory_systems import EULER

import twistax as tx
from twistax.trajectory import Problem
from twistax.trajectory.strategy import strategies


def test_a_worst_trajectory_is_left_or_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first-order conditions hold where a maximum is at its least."""
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,), min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={x: u}))
    problem = Problem(dynamics, tx.Maximize(x @ x), nodes=5, final_time=1.0, initial={x: [0.0, 0.0]}, **EULER)
    seen: list[int] = []
    result = problem.solve(callback=lambda iteration, cost, violation: seen.append(iteration))
    assert result.solved
    assert result.cost == pytest.approx(2.0, rel=1e-5)
    assert not result.saddle
    assert seen == sorted(seen)  # iterations of all searches in a row
    assert result.iterations - 1 == seen[-1]
    monkeypatch.setattr(strategies, "_AWAY", ())
    worst = problem.solve()
    assert worst.solved
    assert worst.saddle
    assert "at a saddle: the objective falls to second order from here" in worst.message
    assert worst.message in worst.explain()
