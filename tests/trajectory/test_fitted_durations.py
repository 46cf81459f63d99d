"""Guesses of durations that are far too long, and limits of states that are far too wide."""

import functools
from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.trajectory import Problem, Status, Strategy


@functools.cache
def turning(guess: float) -> Problem:
    """A half turn about the first axis in least time, torques |u| <= 1."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,), min=-300.0, max=300.0)
    u = tx.Control("u", shape=(3,), min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={R: w, w: u}))
    ends: dict[str, Any] = {
        "initial": {R: np.eye(3), w: np.zeros(3)},
        "final": {R: np.diag([1.0, -1.0, -1.0]), w: np.zeros(3)},
    }
    options: dict[str, Any] = {"nodes": 31, "final_time": (0.01 * guess, 2.0 * guess), **HEUN}
    return Problem(dynamics, tx.Minimize(tx.Time()), final_time_guess=guess, **ends, **options)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_durations_that_are_far_too_long_are_fitted(seed: int) -> None:
    """A start of 77 s, for a turn of 3.24 s."""
    problem = turning(30_000.0)
    assert not problem.solve(seed=seed, final_time=(0.1, 60_000.0), strategies=[]).solved
    result = problem.solve(seed=seed, final_time=(0.1, 60_000.0), strategies=[Strategy.FITTED_DURATIONS])
    assert result.solved
    assert result.cost == pytest.approx(3.25, rel=0.02)


def test_wide_limits_of_states_at_rest_leave_perturbed_starts_alone() -> None:
    """Speeds of a mass that goes one metre in two seconds, with limits of some metres and of a million per second."""
    costs = []
    for wide in (4.0, 1e6):
        p, v = tx.State("p"), tx.State("v", min=-wide, max=wide)
        u = tx.Control("u", min=-5.0, max=5.0)
        ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
        drag = -0.1 * v * v * v
        problem = Problem(
            tx.compile(tx.System(rates={p: v, v: u + drag})),
            tx.Minimize(running=u**2),
            nodes=21,
            final_time=2.0,
            **ends,
            **HEUN,
        )
        results = [problem.solve(seed=seed, strategies=[]) for seed in range(1, 6)]
        assert [result.status for result in results] == [Status.SOLVED] * 5
        costs += [result.cost for result in results]
    np.testing.assert_allclose(costs, costs[0], rtol=1e-6)
