"""Horizons on which explicit steps blow up, against the value functions of the hypersensitive problem."""

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import twistax as tx
from twistax.trajectory import Collocation, MultipleShooting, Phase, Problem, Status, Strategy, solution

HORIZON = 1000.0
x, u = tx.State("x"), tx.Control("u")
DYNAMICS = tx.compile(tx.System(rates={x: u - x**3}))
EFFORT = tx.Minimize(running=0.5 * (x**2 + u**2))
SAID = "Explicit steps are unstable here, an eigenvalue of the rates times a step is "


def at_ends(count: int, seconds: float) -> np.ndarray:
    """Shares of the horizon, dense within so many seconds of both ends."""
    near = seconds / HORIZON * np.linspace(0.0, 1.0, count) ** 1.5
    return np.concatenate([near, 1.0 - near[::-1]])


def hypersensitive(nodes: Any = 25, **options: Any) -> Problem:
    """From 1.5 to near zero, and to 1.

    Source: A. V. Rao and K. D. Mease, Optimal Control Applications and Methods 21 (2000).
    """
    chosen: dict[str, Any] = {"final_time": HORIZON, "initial": {x: 1.5}, "final": {x: 1.0}}
    return Problem(DYNAMICS, EFFORT, nodes=nodes, **chosen | options)


def exact() -> float:
    """V' f + l = 0 at the least u: V' = -x^3 + sqrt(x^6 + x^2) on the way in, x^3 + sqrt(x^6 + x^2) on the way out."""
    both = [quad(lambda x, s=s: s * x**3 + np.sqrt(x**6 + x**2), 0.0, end)[0] for s, end in ((-1.0, 1.5), (1.0, 1.0))]
    return float(sum(both))


def test_collocation_is_tried_and_said() -> None:
    result = hypersensitive(at_ends(40, 15.0)).solve()
    assert result.solved
    assert result.cost == pytest.approx(exact(), rel=5e-3)  # held controls
    assert SAID in result.message
    assert result.message.endswith("solved again by Collocation(tx.tableaus.RADAU_IIA5).")
    assert isinstance(result.problem.transcription, Collocation)
    np.testing.assert_allclose(result.xs["x"][38:42], 0.0, atol=1e-3)


def test_even_nodes_are_too_coarse_and_a_refined_mesh_says_both() -> None:
    stated = hypersensitive()
    result = stated.solve()
    assert result.status is Status.COARSE
    assert SAID in result.message
    again = pickle.loads(pickle.dumps(stated)).solve(guess={u: 0.1})
    assert again.cost == pytest.approx(result.cost, rel=1e-6)
    finer = stated.solve(refine=1e-3)
    assert finer.cost == pytest.approx(exact(), rel=5e-3)
    assert SAID in finer.message


def test_what_others_chose_is_tried_first() -> None:
    nodes = at_ends(40, 15.0)
    radau = hypersensitive(nodes, transcription=Collocation(tx.tableaus.RADAU_IIA5)).solve()
    assert radau.solved
    assert "Explicit" not in radau.message
    explicit = hypersensitive(nodes, transcription=MultipleShooting(tx.RKMK(tx.tableaus.RK4), substeps=4)).solve()
    assert explicit.cost == pytest.approx(radau.cost, rel=1e-6)
    assert SAID in explicit.message


@pytest.mark.parametrize("limit", [{}, {"slow": x <= 1.9}])
def test_a_warm_start_from_such_a_result(limit: dict[str, Any]) -> None:
    """With a limit along the path there are other rows than by explicit steps."""
    dynamics = tx.compile(tx.System(rates={x: u - x**3}, constraints=limit))
    ends: dict[str, Any] = {"final_time": HORIZON, "initial": {x: 1.5}, "final": {x: 1.0}}
    stated = Problem(dynamics, EFFORT, nodes=at_ends(40, 15.0), **ends)
    first = stated.solve()
    for problem, warm in ((stated, first), pickle.loads(pickle.dumps((stated, first)))):
        again = problem.solve(warm=warm)
        assert again.solved
        assert again.iterations <= 1
        assert again.message.endswith("Solved by Collocation(tx.tableaus.RADAU_IIA5), as the start was.")
        assert again.cost == pytest.approx(first.cost, rel=1e-9)


def test_an_optimum_in_programs_is_that_of_implicit_steps() -> None:
    stated = hypersensitive(at_ends(40, 15.0))
    assert float(solution(stated)().cost) == pytest.approx(stated.solve().cost, rel=1e-8)


def test_it_is_a_strategy() -> None:
    stated = hypersensitive()
    for left_out in ((), tuple(it for it in Strategy if it is not Strategy.IMPLICIT_STEPS)):
        result = stated.solve(strategies=left_out)
        assert result.status is Status.NON_FINITE
        assert SAID not in result.message
    assert stated.solve(strategies=(Strategy.IMPLICIT_STEPS,)).status is Status.COARSE
    assert stated.solve(callback=lambda *_: True).status is Status.STOPPED


def test_phases_are_integrated_anew() -> None:
    nodes = at_ends(30, 15.0)
    first = Phase(DYNAMICS, EFFORT, nodes=nodes, final_time=HORIZON, initial={x: 1.5}, name="first")
    last = Phase(DYNAMICS, EFFORT, nodes=nodes, final_time=HORIZON, final={x: 1.0}, name="last")
    result = Problem([first, last]).solve()
    assert result.cost == pytest.approx(exact(), rel=1e-2)
    assert SAID in result.message


def test_a_start_from_which_no_step_is_finite_is_not_infeasible() -> None:
    """Explicit steps grow by 1e30. p follows v at once: the least effort from rest to v = 1 m/s in 2 s costs 1/2."""
    p, v, push = tx.State("p"), tx.State("v"), tx.Control("push", min=-2.0, max=2.0)
    dynamics = tx.compile(tx.System(rates={p: -1e5 * (p - v), v: push}))
    ends: dict[str, Any] = {"final_time": 2.0, "initial": {p: 0.0, v: 0.0}, "final": {p: 1.0}}
    stated = Problem(dynamics, tx.Minimize(running=push**2), nodes=9, **ends)
    assert stated.solve(strategies=()).status is Status.STALLED
    result = stated.solve()
    assert result.solved
    assert SAID in result.message
    assert result.cost == pytest.approx(0.5, rel=1e-4)


def test_failures_for_other_reasons_stay() -> None:
    v = tx.State("v")
    dynamics = tx.compile(tx.System(rates={x: v, v: tx.Control("push", min=-1.0, max=1.0)}))
    ends: Any = {"final_time": 1.0, "initial": {x: 0.0, v: 0.0}, "final": {x: 9.0, v: 0.0}}
    result = Problem(dynamics, tx.Minimize(running=v**2), **ends).solve()
    assert result.status is Status.INFEASIBLE
    assert "Explicit" not in result.message


def test_a_unit_that_is_far_too_large_is_no_optimum() -> None:
    """A control held for most of the horizon made the unit of the objective 1e8 times the objective."""
    dynamics = tx.compile(tx.System(rates={x: u - x**3}, constraints={"slow": x <= 1.9}))
    ends: dict[str, Any] = {"final_time": HORIZON, "initial": {x: 1.5}, "final": {x: 1.0}}
    first = Problem(dynamics, EFFORT, nodes=at_ends(40, 15.0), **ends).solve()
    for start in (1.4, 1.2, 1.8):
        cold = hypersensitive(at_ends(40, 15.0)).solve(initial={x: start})
        warm = first.problem.solve(warm=first, initial={x: start})
        assert warm.solved
        assert warm.iterations <= 10
        assert warm.optimality.excess <= 1e-6
        assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
