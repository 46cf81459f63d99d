"""Limits between the points where they are asked: held there too, or the result says that they are not."""

import functools
from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx


@functools.cache
def below_a_ceiling() -> tx.trajectory.Problem:
    """There and back below a ceiling by least effort, in ten intervals."""
    x, v, u = tx.State("x", max=1.0 / 9.0), tx.State("v"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: v, v: u}))
    ends: dict[str, Any] = {"initial": {x: 0.0, v: 1.0}, "final": {x: 0.0, v: -1.0}}
    twice = {**HEUN, "substeps": 2}
    return tx.trajectory.Problem(dynamics, tx.Minimize(running=0.5 * u**2), nodes=11, final_time=1.0, **ends, **twice)


def highest(result: tx.trajectory.TrajectoryResult) -> float:
    """The highest point of all parabolas, from the controls alone."""
    x, v, top = float(result.xs["x"][0]), float(result.xs["v"][0]), -np.inf
    for u in result.us["u"]:
        turn = np.clip(-v / u, 0.0, 0.1)
        top = max(top, x, x + v * turn + 0.5 * u * turn**2)
        x, v = x + 0.1 * v + 0.005 * u, v + 0.1 * u
    return max(top, x)


def test_a_limit_holds_along_the_whole_path() -> None:
    problem = below_a_ceiling()
    plain = problem.solve()
    assert highest(plain) > 1.0 / 9.0 + 1e-5
    held = problem.solve(between=1e-6)
    assert held.solved
    # Parabolas may pass between samples of the rollout.
    assert highest(held) <= 1.0 / 9.0 + 1e-6
    assert held.iterations > plain.iterations
    # It costs a little.
    assert 0.0 < held.cost / plain.cost - 1.0 < 1e-3


def test_perturbed_guesses_stay_where_the_end_is_given() -> None:
    # The given end decides whether x keeps its limit there; a guess that missed the end said INFEASIBLE at once.
    result = below_a_ceiling().solve(guesses=6)
    assert all(status is tx.trajectory.Status.SOLVED for status, *_ in result.tries), result.tries
    assert np.ptp([cost for _, cost, *_ in result.tries]) <= 1e-5


def test_what_cannot_hold_is_said() -> None:
    # It starts at the ceiling and rises: no control keeps it from passing.
    problem, start = below_a_ceiling(), {"x": 1.0 / 9.0}
    assert problem.solve(initial=start).solved
    result = problem.solve(initial=start, between=1e-6)
    assert result.status is tx.trajectory.Status.EXCEEDED
    assert "between nodes" in result.message
    assert max(result.between_nodes.values()) > 1e-3


def test_a_share_without_meaning_is_refused() -> None:
    with pytest.raises(tx.TrajectoryError, match="between"):
        below_a_ceiling().solve(between=0.0)
