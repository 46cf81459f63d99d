"""What the core is given of a problem that has every kind of row: rows, values and derivatives."""

import functools
from typing import Any

import jax
import numpy as np
import pytest
from core_functions import (
    assert_derivatives_by_differences,
    assert_derivatives_of_the_core,
    assert_values,
    core_values,
    staged_of,
)

import twistax as tx
from twistax.tableaus import ButcherTableau
from twistax.trajectory import Problem
from twistax.trajectory.transcription.iterate import Instance, Iterate

NODES, M = 4, 4
#: Short steps, for the exponential coordinates in which an interval is differentiated end elsewhere by O(h^5).
FINAL_TIME = 0.12


@functools.cache
def rich_problem(nodes: int = NODES, substeps: int = 2) -> Problem:
    """A ball under torque and a push that changes with time; limits on states, on controls and on both."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,), max=[1.5, None, 2.0])
    u, t = tx.Control("u", shape=(3,), min=-1.0), tx.Time()
    gain = tx.Parameter("gain", value=[1.0, 1.0])
    system = tx.System(
        rates={R: w, w: u + tx.Sin(3.0 * t) * R[:, 0] - gain[0] * tx.linalg.Cross(w, np.array([1.0, 2.0, 3.0]) * w)},
        constraints={
            "spin": tx.linalg.Norm(w) <= 2.0,
            "power": u @ w <= gain[1] ** 2 + t,
            "torque": u @ u <= 4.0,
            "level": R[2, 0] * t == 0.1,
            "gains": gain[0] * gain[1] <= 3.0,
        },
    )
    return Problem(
        tx.compile(system),
        tx.Minimize(
            gain[1] * t**2 + w[0] ** 2 + R[0, 1], running=(gain[0] + t) * (u @ u) + w @ w + 0.3 * tx.linalg.Norm(u)
        ),
        nodes=nodes,
        substeps=substeps,
        final_time=(0.05, 3.0),
        initial=[{"R": np.eye(3)}, w @ w <= gain[0] ** 2],
        at={1: [R[0, 1] * w[1] <= gain[1] ** 3, R[2, 2] ** 2 + t * w[0] == 1.0]},
        final=[{"w": [None, None, 0.3]}, w[1] <= 0.3 * gain[0] ** 3, R[0, 2] == 0.0],
        free={"gain": ([0.2, None], 3.0)},
    )


def random_point(rng: np.random.Generator, nodes: int = NODES, final_time: float = FINAL_TIME) -> Iterate:
    """Its rotations are no half turn from each other, where a logarithm jumps."""
    xs = {"R": np.array(jax.vmap(tx.SO3.exp)(0.4 * rng.normal(size=(nodes, 3)))), "w": rng.normal(size=(nodes, 3))}
    return Iterate(xs, rng.normal(size=(nodes - 1, M)), np.array([final_time, 1.0, 1.0]))


def given_of(problem: Problem) -> Instance:
    return Instance({}, {"R": np.eye(3), "w": np.array([0.0, 0.0, 0.3])}, problem.border.limits)


def test_derivatives_of_the_core_are_those_of_its_values() -> None:
    problem = rich_problem()
    assert_derivatives_by_differences(problem, random_point(np.random.default_rng(0)), given_of(problem))


def test_values_and_derivatives_of_the_core_are_those_of_jax() -> None:
    problem = rich_problem()
    point, given = random_point(np.random.default_rng(0)), given_of(problem)
    assert_values(problem, point, given)
    assert_derivatives_of_the_core(problem, point, given)


def test_there_is_every_kind_of_row() -> None:
    names = set(rich_problem().shooting.names)
    for name in ("spin", "power", "torque", "level", "w[2] <= 2", "u[0] >= -1", "final w[2]"):
        assert name in names
    assert {"final time: lower limit", "final time: upper limit"} < names
    assert [name for name in sorted(names) if name.startswith("gain")] == [
        "gain[0]: lower limit",
        "gain[0]: upper limit",
        "gain[1]: upper limit",
        "gains",
    ]
    for place, count in (("final", 2), ("initial", 1), ("node 1", 2)):
        assert sum(name.startswith(f"{place}: ") for name in names) == count
    bounds = [name for name in sorted(names) if name.startswith("bound on ")]
    assert bounds == [bounds[0], f"{bounds[0]} >= 0"]


def test_rows_are_asked_where_they_matter() -> None:
    shooting = rich_problem().shooting
    asked: dict[str, list[str]] = {name: [] for name in shooting.names}
    for name, place, exists in zip(shooting.names, shooting.places, shooting.exists):
        asked[name] += [place] * bool(exists)
    assert asked["torque"] == ["at node 0", "at node 1", "at node 2"]
    points = ["at node 0", "at node 1", "at node 2", "between nodes 0 and 1", "between nodes 1 and 2"]
    assert sorted(asked["spin"]) == sorted([*points, "between nodes 2 and 3", "at node 3"])
    # With its own control a shared node is asked from both sides.
    assert asked["power"].count("at node 1") == 2
    assert asked["gains"] == ["at node 3"]
    # The start decides this one, and the end another.
    assert "at node 0" not in asked["level"]
    assert set(shooting.names[shooting.determined]) == {"level", "w[2] <= 2"}


@pytest.mark.parametrize("first", [0, 1])
def test_intervals_end_where_an_integration_does(first: int) -> None:
    """To fourth order in the length of the substeps."""
    point = random_point(np.random.default_rng(3), nodes=3, final_time=0.6)
    problem = rich_problem(nodes=3)
    middle, end = (first * 0.3, (first + 1) * 0.3)
    start = {name: a[first] for name, a in point.xs.items()}
    u = {"u": point.us[first, :3]}
    found = tx.integrate(problem.dynamics, start, t0=middle, t1=end, steps=200, u=u)
    for name, values in found.xs.items():
        point.xs[name][first + 1] = values[-1]
    defects = []
    for substeps in (4, 8):
        finer = rich_problem(3, substeps)
        defects.append(core_values(staged_of(finer, given_of(finer)), point, given_of(finer)).defects[first])
    coarse, fine = (float(np.linalg.norm(defect)) for defect in defects)
    assert coarse < 1e-3
    assert 12.0 < coarse / fine < 22.0


def _running_cost(tableau: ButcherTableau, substeps: int, density: tx.Expr, rate: Any, start: float) -> float:
    """Of one interval of 1.3 s from a start, by both forms of the functions."""
    x, u = tx.State("x"), tx.Control("u")
    dynamics, objective = tx.compile(tx.System(rates={x: u + rate})), tx.Minimize(running=density)
    mesh = {"nodes": 2, "method": tx.RKMK(tableau), "substeps": substeps, "final_time": 1.3}
    problem = Problem(dynamics, objective, initial={"x": start}, **mesh)
    point = Iterate({"x": np.array([start, start])}, np.zeros((1, 1)), np.array([1.3]))
    instance = Instance({}, {"x": np.zeros(())}, np.full((1, 2), 1.3))
    assert_values(problem, point, instance)
    return float(core_values(staged_of(problem, instance), point, instance).cost)


@pytest.mark.parametrize(("tableau", "substeps", "power"), [("EULER", 1, 0), ("HEUN", 3, 1), ("RK4", 1, 3)])
def test_the_running_cost_is_exact_for_polynomials(tableau: str, substeps: int, power: int) -> None:
    cost = _running_cost(getattr(tx.tableaus, tableau), substeps, tx.Time() ** power, 0.0, 0.0)
    np.testing.assert_allclose(cost, 1.3 ** (power + 1) / (power + 1), rtol=1e-14)


@pytest.mark.parametrize(("tableau", "order"), [("EULER", 1), ("HEUN", 2), ("RK4", 4), ("DOP853", 8)])
def test_the_running_cost_has_the_order_of_the_tableau(tableau: str, order: int) -> None:
    """Of x' = -x^2, whose integral of x is log(1 + t x0)."""
    x, method = tx.State("x"), getattr(tx.tableaus, tableau)
    exact, counts = np.log(1.0 + 1.3 * 0.8), (4, 8) if order > 4 else (8, 16)
    coarse, fine = (abs(_running_cost(method, n, x, -x * x, 0.8) - exact) for n in counts)
    assert order - 0.4 < np.log2(coarse / fine) < order + 0.8
