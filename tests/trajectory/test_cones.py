"""Bounds on norms as smooth rows: the same sets of points, and the same optimum in every form."""

from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.trajectory import Integral, Problem, Status

Norm = tx.linalg.Norm


#: Of the held controls on 30 intervals, from a solver for second-order cones.
LEAST_FUEL = 1.212619


@pytest.mark.parametrize(
    "form",
    ["a norm as cost", "a norm below a slack", pytest.param("squares below a slack", marks=pytest.mark.slow)],
)
def test_least_fuel_of_a_rendezvous(form: str) -> None:
    """p'' = u, |u| <= 1, at rest at 0 after 8 s; the controls are zero in between, where |u| has no slope."""
    p, v, u = tx.State("p", shape=(3,)), tx.State("v", shape=(3,)), tx.Control("u", shape=(3,))
    s = tx.Control("s", min=0.0)
    constraints = {"thrust": Norm(u) <= 1.0}
    if form != "a norm as cost":
        constraints["slack"] = Norm(u) <= s if form == "a norm below a slack" else u @ u <= s * s
    problem = Problem(
        tx.compile(tx.System(rates={p: v, v: u}, constraints=constraints)),
        tx.Minimize(running=Norm(u) if form == "a norm as cost" else s),
        nodes=31,
        final_time=8.0,
        initial={p: [4.0, -2.0, 1.0], v: [0.0, 0.5, -0.2]},
        final={p: np.zeros(3), v: np.zeros(3)},
        **HEUN,
    )
    result = problem.solve()
    assert result.status is Status.SOLVED
    assert result.cost == pytest.approx(LEAST_FUEL, abs=1e-5)
    fuel = np.linalg.norm(result.us["u"], axis=1).sum() * 8.0 / 30.0
    assert fuel == pytest.approx(LEAST_FUEL, abs=1e-5)
    assert np.linalg.norm(result.us["u"], axis=1).max() <= 1.0 + 1e-6
    if form == "squares below a slack":
        return
    # Multipliers of squares have no limit where the slack is zero: a closer solve of them stalls.
    closer = problem.solve(warm=result, tolerance=1e-9)
    assert closer.status is Status.SOLVED
    assert closer.cost == pytest.approx(1.212618894, rel=1e-9)
    if form == "a norm below a slack":
        assert closer.iterations <= 5


@pytest.mark.parametrize("controls", [None, tx.trajectory.Linear()])
def test_magnitudes_of_controls_in_a_cost(controls: tx.trajectory.Linear | None) -> None:
    """Least fuel over 1 in 3 s with |u| <= 1: 3 - sqrt(5), off by what intervals miss."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}, "controls": controls}
    cost = tx.Minimize(running=2.0 * tx.Abs(u) + 0.0 * v)
    steps = {**HEUN, "substeps": 4 if controls else 1}  # a control that changes its sign within an interval has a kink
    result = Problem(dynamics, cost, nodes=13, final_time=3.0, **ends, **steps).solve()
    assert result.solved
    assert result.iterations < 60
    assert result.cost == pytest.approx(2.0 * (3.0 - np.sqrt(5.0)), rel=5e-2 if controls else 2e-2)
    assert set(result.us) == {"u"}


@pytest.mark.parametrize("kind", ["budget", "cost"])
def test_norms_of_controls_of_which_one_is_linear(kind: str) -> None:
    """No bound of theirs would be tight: it would have to jump at nodes, and to be linear between them."""
    v, held, line = tx.State("v", shape=(2,)), tx.Control("held"), tx.Control("line")
    weight, push = tx.Parameter("weight", value=2.0), held * np.array([1.0, 0.0]) + line * np.array([0.0, 1.0])
    size = tx.linalg.Norm(weight * push)
    objective = tx.Minimize(running=size + (tx.Time() + 1.0) * push @ push)
    if kind == "budget":
        objective = tx.Minimize(-v[0] - v[1], running=0.01 * (tx.Time() + 1.0) * push @ push)
    result = Problem(
        tx.compile(tx.System(rates={v: push})),
        objective,
        nodes=7,
        final_time=3.0,
        initial={v: np.zeros(2)},
        final=[Integral(size) <= 3.0] if kind == "budget" else {v: np.array([1.0, 0.5])},
        controls={line: tx.trajectory.Linear()},
        guess={held: 0.2, line: 0.2},
        **HEUN,
    ).solve()
    assert result.solved
    held_at, line_at = np.asarray(result.us["held"]), np.asarray(result.us["line"])
    # By the quadrature of Heun's method.
    along = lambda f: 0.25 * sum(np.sum(f(0.5 * (k + np.arange(6)), line_at[k : k + 6])) for k in (0, 1))  # noqa: E731
    used = along(lambda _, line: 2.0 * np.hypot(held_at, line))
    if kind == "budget":
        assert used == pytest.approx(3.0, abs=1e-5)
    else:
        assert result.cost == pytest.approx(used + along(lambda t, line: (t + 1.0) * (held_at**2 + line**2)), rel=1e-9)


def test_a_parameter_may_stand_in_the_size_of_a_linear_control_alone() -> None:
    x, u, price = tx.State("x"), tx.Control("u"), tx.Parameter("price", value=3.0)
    result = Problem(
        tx.compile(tx.System(rates={x: u})),
        tx.Minimize(running=tx.Abs(price * u)),
        nodes=4,
        final_time=1.0,
        initial={x: 0.0},
        final={x: 2.0},
        controls=tx.trajectory.Linear(),
        **HEUN,
    ).solve()
    assert result.solved
    assert result.cost == pytest.approx(6.0, rel=1e-5)


# ---- norms that are zero at the optimum ------------------------------------------------------------------------------

P, V, U = tx.State("p", shape=(3,)), tx.State("v", shape=(3,)), tx.Control("u", shape=(3,))


def rendezvous(nodes: int, unit: float = 1.0, **options: Any) -> Problem:
    """p'' = u, |u| <= 1 in a unit, at rest at 0 after 8 s, by the least thrust: in between it is zero."""
    dynamics = tx.compile(tx.System(rates={P: V, V: U}, constraints={"thrust": Norm(U) <= unit}))
    start = {P: unit * np.array([4.0, -2.0, 1.0]), V: unit * np.array([0.0, 0.5, -0.2])}
    rest = {P: np.zeros(3), V: np.zeros(3)}
    return Problem(
        dynamics, tx.Minimize(running=Norm(U)), nodes=nodes, final_time=8.0, initial=start, final=rest, **options
    )


@pytest.mark.parametrize("unit", [1.0, pytest.param(1e4, marks=pytest.mark.slow)])
def test_a_warm_start_from_a_result_with_norms_of_zero_comes_back_as_it_is(unit: float) -> None:
    """A row |a|^2 / s <= s has the unit of s: in one by its derivatives, which s near zero makes 1e8 times as large,
    slacks and violations mean nothing."""
    problem = rendezvous(21, unit)
    result = problem.solve()
    again = problem.solve(warm=result)
    assert result.solved
    assert again.solved
    assert again.iterations == 0
    np.testing.assert_array_equal(again.us["u"], result.us["u"])


def test_a_refinement_goes_on_where_norms_are_zero() -> None:
    """On a finer mesh a warm start is no optimum, though it violates nothing: its slope tells the first barrier."""
    result = rendezvous(11).solve(refine=1e-4)
    assert result.solved
    assert [mesh.status for mesh in result.meshes] == [Status.SOLVED] * len(result.meshes)
    assert len(result.meshes) > 2


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_a_bound_that_falls_to_zero_keeps_its_sign(seed: int | None) -> None:
    """Where the bound of a norm is a state; by rounding of summed steps, or by a step to its limit, searches ended."""
    result = rendezvous(21, controls=tx.trajectory.Linear()).solve(seed=seed)
    assert result.solved
    assert result.cost == pytest.approx(1.2131485, rel=1e-6)


@pytest.mark.parametrize("controls", [None, tx.trajectory.Linear()])
@pytest.mark.parametrize("guess", [0.0, 0.3])
def test_nothing_to_do_costs_nothing(controls: Any, guess: float) -> None:
    """At rest: the objective, its multipliers and all norms vanish. Of one control a norm is its magnitude."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": {p: 0.0, v: 0.0}, "guess": {u: guess}}
    cost = tx.Minimize(running=Norm(u * np.ones(1)))
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    problem = Problem(dynamics, cost, nodes=13, final_time=3.0, controls=controls, **ends, **HEUN)
    result = problem.solve()
    assert result.solved
    assert result.cost < 1e-12
    assert np.abs(result.us["u"]).max() < 1e-9
    assert problem.solve(warm=result).iterations == 0
