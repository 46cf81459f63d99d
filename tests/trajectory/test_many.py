"""Many cases at once end as each does alone."""

import functools
import re
from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.trajectory import Problem, Status


@functools.cache
def parking() -> Problem:
    """A mass goes to a place in least time and effort, past no wall, with a limited force."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    mass = tx.Parameter("mass", value=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u / mass}, constraints={"wall": p <= 2.0}))
    return Problem(
        dynamics,
        tx.Minimize(tx.Time(), running=0.1 * u**2),
        nodes=9,
        final_time=(0.5, 20.0),
        initial={p: 0.0, v: 0.0},
        final={p: 1.0, v: 0.0},
        **HEUN,
    )


#: Cases: ordinary ones; the fifth starts beyond the wall, and the seventh has a mass of nothing.
STARTS, MASSES = [0.0, -1.0, 0.5, -3.0, 3.0, 1.2, 0.1], [1.0, 2.0, 0.3, 1.0, 1.0, 0.7, 0.0]


def arguments(case: Any = slice(None)) -> dict[str, Any]:
    return {"initial": {"p": np.array(STARTS)[case]}, "params": {"mass": np.array(MASSES)[case]}}


def test_every_case_ends_as_it_does_alone() -> None:
    problem = parking()
    many = problem.solve_many(**arguments())
    assert len(many) == len(STARTS)
    for case in range(len(STARTS)):
        alone, own = problem.solve(**arguments(case)), many[case]
        assert many.status[case] is own.status is alone.status
        assert many.iterations[case] == alone.iterations
        if alone.solved:
            assert many.cost[case] == own.cost == pytest.approx(alone.cost, rel=1e-9)
            np.testing.assert_allclose(many.us["u"][case], alone.us["u"], atol=1e-6)
            np.testing.assert_allclose(many.xs["p"][case], alone.xs["p"], atol=1e-6)
            assert own.optimality.gap == many.optimality["gap"][case] <= 1e-6
    assert many.status[4] is Status.INFEASIBLE
    assert many.status[6] is Status.NON_FINITE
    assert many.solved.tolist() == [True, True, True, True, False, True, False]
    assert "1 INFEASIBLE (case 4)" in repr(many)


@pytest.mark.parametrize("start", [0.0, -1e4])
@pytest.mark.parametrize("most", [500, 7])
def test_steps_in_a_row_are_steps_one_at_a_time(most: int, start: float) -> None:
    problem, seen = parking(), list[int]()
    own: dict[str, Any] = {"initial": {"p": start}, "final_time": (0.5, 2000.0), "max_iterations": most}
    alone = problem.solve(**own, callback=lambda iteration, cost, violation: seen.append(iteration))
    together = problem.solve(**own)
    assert together.status is alone.status
    assert together.iterations == alone.iterations == len(seen)
    assert together.cost == alone.cost


def test_what_an_argument_shares_and_what_it_has_for_each() -> None:
    problem = parking()
    times, guesses = np.array([[0.5, 20.0]] + [[4.0, 20.0]] * 6), np.linspace(0.0, 1.0, 9) * np.ones((7, 1))
    many = problem.solve_many({"p": guesses}, final={"p": 1.0}, final_time=times)
    assert many.solved.all()
    assert many.final_time[0] < 3.0
    np.testing.assert_allclose(many.final_time[1:], 4.0, rtol=1e-5)


def test_a_case_with_too_little_time_says_so_as_it_does_alone() -> None:
    problem, times = parking(), np.array([[0.5, 20.0]] * 2 + [[0.5, 1.0]])
    many = problem.solve_many(final_time=times)
    assert many.solved.tolist() == [True, True, False]
    assert many.status[2] is Status.INFEASIBLE
    assert many[2].message == problem.solve(final_time=(0.5, 1.0)).message


def test_worst_trajectories_are_left_among_others_too() -> None:
    """The longest way to a place: a straight one is a saddle. The last place is too far, the one before just near."""
    p, u = tx.State("p"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: u}))
    ends = {"initial": {p: 0.0}, "final": {p: 0.0}}
    problem = Problem(dynamics, tx.Minimize(running=-(u**2)), nodes=4, final_time=3.0, **ends, **HEUN)
    places = [0.0, 0.3, -1.0, 2.99, 5.0]
    many = problem.solve_many(final={"p": np.array(places)})
    for case, place in enumerate(places):
        alone = problem.solve(final={"p": place})
        assert many.status[case] is alone.status
        assert many.iterations[case] == alone.iterations
        assert many[case].saddle is alone.saddle
        np.testing.assert_allclose(many.us["u"][case], alone.us["u"], atol=1e-6)
    assert many.status == (Status.SOLVED,) * 4 + (Status.INFEASIBLE,)


BAD: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"initial": {"p": 0.0}}, tx.TrajectoryError, "no argument has an axis of cases"),
    ({"initial": {"p": np.zeros(3)}, "params": {"mass": np.ones(2)}}, tx.ShapeError, r"has 3, params\['mass'\] has 2"),
    ({"initial": {"p": [np.nan, np.nan]}}, tx.TrajectoryError, r"case 0: solve: initial\['p'\] must fix"),
    ({"initial": {"q": np.zeros(2)}}, tx.ModelError, "case 0: initial names 'q'"),
    ({"initial": {"p": []}}, tx.ShapeError, r"initial\['p'\] has no cases"),
    ({"initial": {"p": [[1.0], [1.0, 2.0]]}}, tx.ShapeError, r"initial\['p'\] expects numbers or arrays"),
]


@pytest.mark.parametrize(("case", "error", "text"), BAD, ids=["none", "counts", "free", "name", "empty", "ragged"])
def test_nonsense_is_refused(case: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        parking().solve_many(**case)


@pytest.mark.parametrize(
    ("case", "text"),
    [
        ({"initial": {"p": [0.0, np.nan, 0.5]}}, r"case 1: solve: initial\['p'\] must fix .*, got nan"),
        ({"params": {"mass": [1.0, np.inf, 0.3]}}, r"case 1: params\['mass'\] expects finite numbers"),
        ({"final_time": [(0.5, 20.0), (2.0, 1.0), (0.5, 20.0)]}, "case 1: final_time must be positive"),
    ],
)
def test_a_case_that_does_not_fit_is_refused_alone(case: dict[str, Any], text: str) -> None:
    many = parking().solve_many(**case)
    assert many.solved.tolist() == [True, False, True]
    refused = many[1]
    assert refused.status is many.status[1] is Status.REFUSED
    assert np.isnan([many.cost[1], refused.cost, refused.final_time, *refused.xs["p"], *refused.us["u"]]).all()
    assert re.search(text, refused.message)
    with pytest.raises(tx.TrajectoryError, match="case 1"):
        refused.replay()
    last = {what: {name: own[2] for name, own in given.items()} for what, given in case.items() if what != "final_time"}
    alone = parking().solve(**last)
    assert many[2].cost == pytest.approx(alone.cost, rel=1e-9)
