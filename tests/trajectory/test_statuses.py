"""What a problem says when it cannot be solved, or not be stated."""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np
import pytest
from trajectory_systems import EULER, HEUN

import twistax as tx
from twistax.trajectory import Problem, Status, TrajectoryResult


@functools.cache
def integrator(limit: float = 1.0) -> tx.Dynamics:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-limit, max=limit)
    return tx.compile(tx.System(rates={p: v, v: u}, constraints={"wall": p <= 2.0}))


def problem(**changes: Any) -> Problem:
    dynamics = changes.pop("dynamics", integrator())
    options: dict[str, Any] = {
        "objective": tx.Minimize(running=dynamics.controls[0] ** 2),
        "nodes": 8,
        "final_time": 3.0,
        "initial": {"p": 0.0, "v": 0.0},
        "final": {"p": 1.0, "v": 0.0},
    }
    return Problem(dynamics, **(options | changes))


@functools.cache
def stated() -> Problem:
    """The problem of this file, compiled once."""
    return problem(**HEUN)


def test_too_little_time_is_infeasible_and_names_what_gives() -> None:
    result = stated().solve(final_time=1.0)
    assert result.status is Status.INFEASIBLE
    assert "'final p' at node 7 is violated by" in result.message
    assert result.violation > 1e-2
    assert not result.solved


def test_an_end_beyond_a_wall_names_the_wall_and_the_node() -> None:
    result = stated().solve(final={"p": 2.5, "v": 0.0})
    assert result.status is Status.INFEASIBLE
    assert "'wall' at node 7 is violated by 0.5" in result.message
    assert result.violations["wall"] == pytest.approx(0.5)


def test_a_start_beyond_a_wall_is_said_at_once() -> None:
    result = stated().solve(initial={"p": 3.0, "v": 0.0})
    assert result.status is Status.INFEASIBLE
    assert "'wall' at node 0 is violated by 1, by the fixed initial and final values alone" in result.message
    assert result.iterations == 1


def test_too_few_iterations_are_said() -> None:
    result = stated().solve(max_iterations=2)
    assert result.status is Status.MAX_ITERATIONS
    assert result.iterations == 2
    assert f"stationarity is {result.optimality.stationarity:.1e}" in result.message


def test_what_goes_back_in_time_has_no_rollout() -> None:
    """Free node times of a solve that has not ended may."""
    times = np.array([0.0, 1.0, 0.75, 1.0, 2.0, 2.5, 2.75, 3.0])
    solved = stated().solve()
    result = dataclasses.replace(solved, phases=(dataclasses.replace(solved.phases[0], ts=times),))
    with pytest.raises(tx.TrajectoryError, match=r"node 2 at 0\.75 s is before node 1"):
        result.replay()
    assert "no finer rollout: replay: the times of nodes must increase, but node 2" in result.explain()


def test_values_that_are_not_finite_are_said() -> None:
    p, u = tx.State("p"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={p: u / p}))
    result = Problem(dynamics, tx.Minimize(p), nodes=4, final_time=1.0, initial={p: 0.0}, **EULER).solve()
    assert result.status is Status.NON_FINITE
    assert "'dynamics of p' between nodes 0 and 1 is nan" in result.message
    assert result.accuracy is None
    for read in ("mesh_error", "between_nodes", "dense", "extremes"):
        with pytest.raises(tx.TrajectoryError, match="a point that is not finite has no rollout"):
            getattr(result, read)
    assert "no finer rollout: a point that is not finite has no rollout" in result.explain()


@functools.cache
def farthest() -> Problem:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    return Problem(dynamics, tx.Maximize(p), nodes=4, final_time=3.0, initial={p: 0.0, v: 0.0}, **HEUN)


def test_an_objective_without_bound_is_said() -> None:
    """Anything meets these ends. A control that is worst has no slope either: from it the search goes on."""
    dynamics = farthest().dynamics
    u, ends = dynamics.controls[0], {"p": 1.0, "v": 0.0}
    start: dict[str, Any] = {"initial": {"p": 0.0, "v": 0.0}}
    result = Problem(
        dynamics, tx.Minimize(running=-(u**2)), nodes=4, final_time=3.0, final=ends, **start, **HEUN
    ).solve()
    assert result.status is Status.UNBOUNDED
    assert "a limit is missing" in result.message
    assert result.iterations < 200


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_an_objective_without_bound_is_said_in_any_unit_and_with_gaps(unit: float) -> None:
    guess = {"p": [0.0, 5.0, -3.0, 0.7], "v": [0.0, 9.0, -4.0, 0.1], "u": [0.3, -0.1, 2.0]}
    result = farthest().solve(guess={name: unit * np.array(values) for name, values in guess.items()})
    assert result.status is Status.UNBOUNDED
    assert result.xs["p"][-1] > 1e10 * unit
    assert result.optimality.feasibility <= 1e-6


def test_double_precision_whatever_the_setting_and_repeatable_seeds() -> None:
    own = problem(**HEUN)
    with jax.enable_x64(False):
        first: TrajectoryResult = own.solve(seed=4)
        rollout = first.replay(steps=5)
    again, other = own.solve(seed=4), own.solve(seed=5)
    assert first.solved
    assert first.xs["p"].dtype == np.float64
    assert rollout.xs["p"].dtype == np.float64
    assert rollout.misses["p"]["distance"] < 1e-6
    assert repr(rollout).startswith(f"Replay({len(rollout.ts)} times until ")
    assert len(repr(rollout)) < 300
    np.testing.assert_array_equal(first.us["u"], again.us["u"])
    assert (first.us["u"] != other.us["u"]).any()
    assert again.compile_seconds < first.compile_seconds


def test_several_guesses_give_the_best_and_warm_starts_work() -> None:
    several = stated().solve(guesses=3)
    assert len(several.tries) == 3
    assert several.cost == min(cost for status, cost, *_ in several.tries if status is Status.SOLVED)
    warm = stated().solve(guess={**several.xs, **several.us})
    assert warm.solved
    assert warm.iterations < stated().solve().iterations


def test_the_path_of_the_optimiser_does_not_hang_on_last_digits() -> None:
    """Where the model expects no more than round-off, no step is tried: gains of 1e-16 are another processor's loss."""
    one, other = (stated().solve(final={"p": 1.0 + moved}) for moved in (0.0, 1e-13))
    assert one.iterations == other.iterations
    np.testing.assert_allclose(one.us["u"], other.us["u"], atol=1e-9)


def test_ends_outside_their_box_are_refused() -> None:
    p = tx.State("p", min=0.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: tx.Control("u")}))
    with pytest.raises(tx.TrajectoryError, match=r"initial value of p must keep its bound, but is 2: 2 > 1\.\n  fix:"):
        Problem(dynamics, tx.Minimize(p), final_time=1.0, initial={p: 2.0})
    Problem(dynamics, tx.Minimize(p), final_time=1.0, initial={p: 1.0 + 1e-12})  # that is rounding
    with pytest.raises(tx.TrajectoryError, match=r"but is 1\.00000001: 1\.00000001 > 1\."):
        Problem(dynamics, tx.Minimize(p), final_time=1.0, initial={p: 1.0 + 1e-8})


def test_an_end_of_another_length_is_not_repeated() -> None:
    q = tx.State("q", shape=(2,))
    dynamics = tx.compile(tx.System(rates={q: tx.Control("u", shape=(2,))}))
    with pytest.raises(tx.ShapeError, match=r"'q': final expects shape \(2,\) or a number, got \(1,\)"):
        Problem(dynamics, tx.Minimize(tx.Time()), final_time=(1.0, 2.0), final={"q": [0.0]})


def test_entries_of_matrices_have_two_numbers() -> None:
    P, U = tx.State("P", shape=(2, 2)), tx.Control("U", shape=(2, 2), max=[[1.0, 2.0], [3.0, 4.0]])
    dynamics = tx.compile(tx.System(rates={P: U}, constraints={"cap": P <= 5.0}))
    final = [{P: np.ones((2, 2))}, P.T <= 9.0]
    own = Problem(dynamics, tx.Minimize(tx.Time()), nodes=2, final_time=(1.0, 2.0), final=final, **EULER)
    assert {"U[0, 1] <= 2", "U[1, 0] <= 3", "cap[0, 1]", "final P[1, 0]"} <= set(own.shooting.names)
    assert any(name.endswith("<= 9.[1, 0]") for name in own.shooting.names)
    assert own.shooting.defect(0, 2) == "'dynamics of P[1, 0]' between nodes 0 and 1"


def test_a_problem_says_what_it_is() -> None:
    assert repr(stated()).startswith("Problem(Minimize(running=(u ** 2.)), 8 nodes, 3 s, Dynamics(states: p ()")


def test_objectives_check_themselves() -> None:
    with pytest.raises(tx.ModelError, match="running"):
        tx.Minimize()
    with pytest.raises(tx.ShapeError, match="scalar"):
        tx.Maximize(tx.State("x", shape=(3,)))


def test_a_baked_parameter_cannot_be_read_by_the_objective() -> None:
    x, u, k = tx.State("x"), tx.Control("u"), tx.Parameter("k", value=2.0)
    dynamics = tx.compile(tx.System(rates={x: k * u}), bake={"k": 3.0})
    with pytest.raises(tx.ModelError, match="constant of the compiled dynamics"):
        Problem(dynamics, tx.Minimize(k * x), final_time=1.0)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda problem: problem.solve(hessian=1),
            r"solve has no argument 'hessian'.*\n  fix: tx.*Problem\(",
        ),
        (lambda problem: problem.solve_many(callbak=print), "solve_many has no argument 'callbak'"),
        (lambda _: Problem(None, guesses=3), r"Problem has no argument 'guesses'.*\n  fix: problem.solve\("),
        (
            lambda problem: problem.solve(callback=tx.trajectory.Progress),
            r"got the class Progress.\n  fix: .*Progress\(",
        ),
    ],
)
def test_arguments_that_stand_elsewhere_say_where(call: Any, text: str) -> None:
    x, u = tx.State("x"), tx.Control("u")
    problem = Problem(tx.compile(tx.System(rates={x: u})), tx.Minimize(running=u**2), nodes=3, final_time=1.0)
    with pytest.raises(tx.TrajectoryError, match=text):
        call(problem)


def test_an_unknown_parameter_is_told_all_that_there_are() -> None:
    x, u, goal = tx.State("x"), tx.Control("u"), tx.Parameter("goal", value=1.0)
    drag, weight = tx.Parameter("drag", value=0.1), tx.Parameter("weight", value=1.0)
    dynamics = tx.compile(tx.System(rates={x: u - drag * x}))
    problem = Problem(dynamics, tx.Minimize(running=weight * u**2), nodes=3, final_time=1.0, final=[x == goal])
    with pytest.raises(tx.InputError, match=r"params; expected: 'drag', 'weight', 'goal'.\n  fix: did you"):
        problem.solve(params={"gaol": 2.0})
