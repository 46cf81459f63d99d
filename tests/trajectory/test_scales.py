"""First scales: what units, the width of limits and padding must not change."""

from typing import Any

import numpy as np
import pytest
from trajectory_systems import EULER

import twistax as tx
from twistax.precision import in_double
from twistax.trajectory import Phase, Problem
from twistax.trajectory.border import times_of
from twistax.trajectory.iterate import Scales


def first_scales(problem: Any) -> Scales:
    """Of the run that begins at the guess."""
    with in_double():
        point, given, *_ = problem.started()
        found: Scales = problem._solver(1e-6, point, given).steps.opened(point, given).state.scales
    return found


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_controls_that_only_pad_a_stage_have_no_part_in_the_scale_of_the_objective(unit: float) -> None:
    """The joint of two phases is a stage without controls, where the other stages have one."""

    def highest(unit: float) -> Problem:
        x, u = tx.State("x"), tx.Control("u", min=-unit, max=unit)
        dynamics = tx.compile(tx.System(rates={x: u}))
        once: dict[str, Any] = {"nodes": 3, "final_time": 1.0, **EULER}
        guess = {"x": unit * np.array([0.0, 1.0, 2.0])}
        first = Phase(dynamics, initial={x: 0.0}, guess=guess, **once)
        return Problem([first, Phase(dynamics, tx.Maximize(x), guess=guess, **once)])

    plain, other = first_scales(highest(1.0)), first_scales(highest(unit))
    np.testing.assert_allclose(other.cost, unit * plain.cost, rtol=1e-9)


@pytest.mark.parametrize("width", [1.0, 1e8])
def test_limits_say_no_more_of_what_rests_than_others_of_its_vector_do(width: float) -> None:
    """Of two arms one moves by 2: what else is known of the one at rest are limits, narrow or wide."""
    q, v = tx.State("q", shape=(2,), min=-3.0 * width, max=3.0 * width), tx.State("v", shape=(2,))
    u = tx.Control("u", shape=(2,), min=-width, max=width)
    ends: dict[str, Any] = {
        "initial": {q: [-1.0, 0.4], v: [0.0, 0.0]},
        "final": {q: [1.0, 0.4], v: [0.0, 0.0]},
    }
    dynamics = tx.compile(tx.System(rates={q: v, v: u}))
    problem = Problem(dynamics, tx.Minimize(tx.Time()), nodes=4, final_time=(0.5, 8.0), **ends, **EULER)
    scales = first_scales(problem)
    moving, resting = scales.d[0].reshape(2, 2).T
    np.testing.assert_allclose(moving[0], 1.0)
    np.testing.assert_allclose(resting, moving)
    np.testing.assert_allclose(scales.u[0, 1], scales.u[0, 0])


def test_a_free_time_starts_between_its_limits_however_far_apart_they_are() -> None:
    assert times_of((2.0, 20.0), None) == ((2.0, 20.0), 11.0)
    assert times_of((0.5, 20_000.0), None) == ((0.5, 20_000.0), pytest.approx(100.0))
    assert times_of((0.5, 20_000.0), 3.0)[1] == 3.0
