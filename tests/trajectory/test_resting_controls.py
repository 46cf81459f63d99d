"""Controls without limits whose best value is zero: their slopes vanish there, and their sizes with them."""

import functools

import numpy as np
import pytest

import twistax as tx
from twistax.trajectory import Problem


@functools.cache
def ahead(bent: str, least_time: bool, push: float, time: float, unit: float) -> Problem:
    """A thrust at an angle in some unit, x'' = push cos(angle): as far as it goes, or as fast as it gets there."""
    x, v, angle = tx.State("x"), tx.State("v"), tx.Control("angle")
    share = np.cos(angle / unit) if bent == "cosine" else 1.0 - (angle / unit) ** 2
    ends = {"final_time": (0.1 * time, 10.0 * time), "final": {x: push * time**2}} if least_time else {}
    return Problem(
        tx.compile(tx.System(rates={x: v, v: push * share})),
        tx.Minimize(tx.Time()) if least_time else tx.Maximize(x),
        nodes=21,
        initial={x: 0.0, v: 0.0},
        **{"final_time": time} | ends,
    )


def check(problem: Problem, best: float, unit: float, bent: str) -> None:
    """From angles far from zero and near it."""
    for angle in (0.5, -0.1, 0.01, 0.9):
        result = problem.solve(guess={"angle": angle * unit})
        assert result.solved, (angle, result.message)
        assert result.cost == pytest.approx(best, rel=1e-6), angle
        turned = result.us["angle"] / unit
        np.testing.assert_allclose(np.cos(turned) if bent == "cosine" else 1.0 - turned**2, 1.0, atol=1e-5)


@pytest.mark.parametrize("least_time", [False, True])
def test_a_thrust_straight_ahead_is_found(least_time: bool) -> None:
    """The way is push time^2 / 2, and sqrt(2) time takes push time^2."""
    best = np.sqrt(2.0) if least_time else 0.5e-6
    check(ahead("cosine", least_time, 1e-6, 1.0, 1e6), best, 1e6, "cosine")


@pytest.mark.parametrize("least_time", [False, True])
@pytest.mark.parametrize("bent", ["cosine", "square"])
@pytest.mark.parametrize(("push", "time", "unit"), [(1.0, 1.0, 1.0), (1e-6, 1.0, 1e6), (1e6, 1e-6, 1e-6)])
def test_it_is_in_other_units(bent: str, least_time: bool, push: float, time: float, unit: float) -> None:
    best = np.sqrt(2.0) * time if least_time else 0.5 * push * time**2
    check(ahead(bent, least_time, push, time, unit), best, unit, bent)
