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
from twistax.trajectory.scaling import unit_scales
from twistax.trajectory.solver import Solver
from twistax.trajectory.steps import unweighed
from twistax.trajectory.transcribed import jitted


def first_scales(problem: Any) -> Scales:
    """Of the run that begins at the guess, by what `Steps.opened` is made of: the steps themselves are not compiled."""
    with in_double():
        point, given, *_ = problem.started()
        solver = Solver(problem.shooting, 1e-6)
        state = unweighed(solver.steps.start(point, given, unit_scales(problem.shooting)))
        slopes, _ = jitted(solver.method.looked_at, 0)(state, given)
        found: Scales = jitted(solver.steps._open, 0)(slopes, state, given).state.scales
    return found


def test_first_scales_are_those_of_a_run() -> None:
    own_scales, problem = first_scales(two_arms(1.0)), two_arms(1.0)
    with in_double():
        point, given, *_ = problem.started()
        run = problem._solver(1e-6, point, given).steps.opened(point, given).state.scales
    for own, other in zip(own_scales, run):
        np.testing.assert_allclose(own, other, rtol=1e-12)


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


def two_arms(unit: float, low: Any = None, high: Any = None, far: float | None = None) -> Problem:
    """Of two arms the first moves by 2, the second rests at 0.4; limits of places and of pushes."""
    q = tx.State("q", shape=(2,), min=low, max=high)
    v, u = tx.State("v", shape=(2,)), tx.Control("u", shape=(2,), min=far and -far, max=far)
    still = unit * np.zeros(2)
    ends: dict[str, Any] = {
        "initial": {q: unit * np.array([-1.0, 0.4]), v: still},
        "final": {q: unit * np.array([1.0, 0.4]), v: still},
    }
    dynamics = tx.compile(tx.System(rates={q: v, v: u}))
    cost = tx.Minimize(tx.Time(), running=u @ u / unit**2)
    return Problem(dynamics, cost, nodes=4, final_time=(0.5, 8.0), **ends, **EULER)


@pytest.mark.parametrize("width", [1.0, 1e8])
def test_limits_say_no_more_of_what_rests_than_others_of_its_vector_do(width: float) -> None:
    scales = first_scales(two_arms(1.0, -3.0 * width, 3.0 * width, width))
    np.testing.assert_allclose(scales.d[:, :2], 1.0)
    np.testing.assert_allclose(scales.u[:, 1], scales.u[:, 0])


def test_limits_say_how_little_what_rests_may_move() -> None:
    scales = first_scales(two_arms(1.0, [-3.0, 0.3], [3.0, 0.5]))
    np.testing.assert_allclose(scales.d[0, :2], [1.0, 0.1])


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_what_rests_without_limits_counts_as_others_of_its_vector_in_every_unit(unit: float) -> None:
    scales = first_scales(two_arms(unit))
    np.testing.assert_allclose(scales.d[:, :2], unit)
    np.testing.assert_allclose(scales.u[:, 1], scales.u[:, 0])


def test_a_free_time_starts_between_its_limits_however_far_apart_they_are() -> None:
    for low in (1.0, 1e-6, 3e-7, 1e-200):
        assert times_of((low, 100.0 * low), None)[1] == pytest.approx(50.5 * low)
        assert times_of((low, 121.0 * low), None)[1] == pytest.approx(11.0 * low)
    assert times_of((0.5, 20_000.0), 3.0)[1] == 3.0


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_axes_of_a_place_that_nothing_moves_count_as_the_one_that_moves(unit: float) -> None:
    """A pose that rests in the guess, pushed along its x alone."""
    g, u = tx.State("g", group=tx.SE3), tx.Control("u", min=-unit, max=unit)
    dynamics = tx.compile(tx.System(rates={g: tx.Concat(u, np.zeros(5))}))
    ends: dict[str, Any] = {"initial": {g: tx.pose()}, "final_time": 1.0}
    problem = Problem(dynamics, tx.Maximize(g[0, 3]), nodes=4, **ends, **EULER)
    d = first_scales(problem).d
    linear = d[:, ~problem.shooting.turns]
    np.testing.assert_allclose(linear / linear.max(axis=1, keepdims=True), 1.0)
    assert linear.max() < 10.0 * unit
