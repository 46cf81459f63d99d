"""References and weights with a value for each node, against the same as functions of time."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.errors import InputError, ModelError, ShapeError, TrajectoryError
from twistax.trajectory import Collocation, GaussNewton, Mesh, Phase, Problem, solution

NODES, TIME = 9, 2.0
p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
wanted = tx.Parameter("wanted", shape=(2,), value=[0.0, 0.0])
weight = tx.Parameter("weight", value=1.0)
RATES: Any = {p: v, v: u}
AT_REST = {p: 0.0, v: 0.0}
SHARES = np.linspace(0.0, 1.0, NODES)
PAIR = tx.Concat([p, v])


def rows_at(ts: np.ndarray) -> np.ndarray:
    """A reference, linear between nodes."""
    at = np.interp(ts, TIME * SHARES, np.sin(3.0 * SHARES) + SHARES**2)
    return np.stack([at, np.interp(ts, TIME * SHARES, np.cos(5.0 * SHARES))], axis=1)


ROWS = rows_at(TIME * SHARES)
WEIGHTS = 1.0 + SHARES**3


def follow(**options: Any) -> Problem:
    """Follow the reference."""
    off = PAIR - wanted
    cost = tx.Minimize(3.0 * (off @ off), running=weight * (off @ off) + 0.1 * u**2)
    chosen: dict[str, Any] = {"nodes": NODES, "final_time": TIME, "initial": AT_REST, "by_node": [wanted, weight]}
    return Problem(tx.compile(tx.System(rates=RATES)), cost, **chosen | options)


def by_tables(**options: Any) -> Problem:
    """The same by tables over time."""

    def table(values: np.ndarray) -> tx.Expr:
        return tx.Interp(tx.Time(), axes=TIME * SHARES, values=values)

    off = PAIR - table(ROWS)
    cost = tx.Minimize(3.0 * (off @ off), running=table(WEIGHTS) * (off @ off) + 0.1 * u**2)
    chosen: dict[str, Any] = {"nodes": NODES, "final_time": TIME, "initial": AT_REST}
    return Problem(tx.compile(tx.System(rates=RATES)), cost, **chosen | options)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"substeps": 3},
        {"transcription": Collocation(tx.tableaus.GAUSS_LEGENDRE6)},
        {"controls": tx.trajectory.Linear()},
        {"hessian": GaussNewton()},
    ],
)
def test_rows_are_linear_between_nodes(options: Any) -> None:
    stated = follow(**options)
    found, same = stated.solve(params={wanted: ROWS, weight: WEIGHTS}), by_tables(**options).solve()
    assert found.solved
    assert found.cost == pytest.approx(same.cost, rel=1e-9)
    np.testing.assert_allclose(found.us["u"], same.us["u"], atol=1e-6)
    np.testing.assert_allclose(found.params["wanted"], ROWS)
    assert stated.solve().cost == pytest.approx(0.0, abs=1e-9)  # one value, the parameter's, for all nodes


def test_nodes_at_unequal_distances_and_a_finer_mesh_read_the_same_rows() -> None:
    shares = np.array([0.0, 0.1, 0.4, 0.5, 0.8, 1.0])
    reference = rows_at(TIME * shares)
    stated = follow(nodes=shares)
    found = stated.solve(params={"wanted": reference, "weight": np.ones(6)}, refine=1e-4)
    assert found.solved
    assert len(found.ts) > 6
    expected = np.stack([np.interp(found.ts / TIME, shares, own) for own in reference.T], axis=1)
    np.testing.assert_allclose(found.params["wanted"], expected, atol=1e-12)


def test_many_references_at_once() -> None:
    scales = np.array([0.5, 1.0, 2.0])
    many = follow().solve_many(params={wanted: scales[:, None, None] * ROWS})
    alone = follow().solve(params={wanted: ROWS})
    np.testing.assert_allclose(many.cost, scales**2 * alone.cost, rtol=1e-8)  # least squares from rest


def test_phases_have_rows_of_their_own() -> None:
    other = tx.Parameter("other", value=1.0)
    dynamics = tx.compile(tx.System(rates=RATES))
    first = Phase(
        dynamics,
        tx.Minimize(running=(p - other) ** 2 + u**2),
        nodes=4,
        final_time=1.0,
        initial=AT_REST,
        by_node=[other],
    )
    off = PAIR - wanted
    last = Phase(dynamics, tx.Minimize(running=off @ off + u**2), nodes=6, final_time=1.0, by_node=[wanted])
    rows = np.linspace(0.0, 1.0, 4), np.stack([np.linspace(1.0, 2.0, 6), np.ones(6)], axis=1)
    found = Problem([first, last], params={other: rows[0], wanted: rows[1]}).solve()
    first_table, last_table = tx.Time(), tx.Concat([tx.Time(), 1.0])
    off, other_off = PAIR - last_table, p - first_table
    costs = tx.Minimize(running=other_off**2 + u**2), tx.Minimize(running=off @ off + u**2)
    by_time = [dataclasses.replace(own, objective=cost, by_node=None) for own, cost in zip((first, last), costs)]
    assert found.solved
    assert found.cost == pytest.approx(Problem(by_time).solve().cost, rel=1e-9)


def test_weights_of_soft_constraints_differ_by_node() -> None:
    """The price of a limit from a node on, beside the same as a function of time."""
    steps = (np.arange(NODES) >= 4).astype(float)
    cost, price = tx.Minimize(running=u**2), tx.Interp(tx.Time(), axes=TIME * SHARES, values=5.0 * steps)
    ends: Any = {"nodes": NODES, "final_time": TIME, "initial": AT_REST, "final": {p: 1.0, v: 0.0}}
    costs = []
    for own, by_node in ((weight, [weight]), (price, None)):
        dynamics = tx.compile(tx.System(rates=RATES, constraints={"slow": tx.Soft(v <= 0.6, l1=own)}))
        result = Problem(
            dynamics, cost, by_node=by_node, params={weight: 5.0 * steps} if by_node else {}, **ends
        ).solve()
        assert result.solved
        costs.append(result.cost)
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)


def test_free_times_stretch_the_rows() -> None:
    stated = follow(final_time=(1.0, 4.0), nodes=Mesh(NODES))
    found = stated.solve(params={wanted: ROWS})
    fixed = follow(final_time=float(found.final_time)).solve(params={wanted: ROWS})
    assert found.solved
    assert found.cost == pytest.approx(fixed.cost, rel=1e-8)


def test_an_optimum_has_derivatives_with_rows_in_place() -> None:
    optimum = solution(follow(params={wanted: ROWS, weight: WEIGHTS}))
    cost = lambda speed: optimum(initial={"v": speed}).cost  # noqa: E731
    slope = float(jax.jacfwd(cost)(0.1))
    assert slope == pytest.approx(float(cost(0.1 + 1e-4) - cost(0.1 - 1e-4)) / 2e-4, rel=1e-5)
    assert float(cost(0.0)) == pytest.approx(follow().solve(params={wanted: ROWS, weight: WEIGHTS}).cost, rel=1e-8)
    with pytest.raises(TrajectoryError, match=r"'wanted', which has a value for each node.*\n.*fix: "):
        optimum(params={"wanted": ROWS})


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (
            ROWS[:-1],
            ShapeError,
            r"params\['wanted'\] expects a row for each node \(9, 2\), or one value \(2,\), got \(8, 2\)",
        ),
        (np.full((NODES, 2), np.nan), InputError, r"params\['wanted'\] expects finite numbers"),
    ],
)
def test_other_rows_are_refused(given: Any, error: Any, words: str) -> None:
    with pytest.raises(error, match=words):
        follow().solve(params={wanted: given})


def test_rows_belong_to_the_objective() -> None:
    gain = tx.Parameter("gain", value=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: gain * u}))
    ends: Any = {"final_time": 1.0, "initial": AT_REST}
    with pytest.raises(ModelError, match=r"by_node names 'gain', which a rate, a constraint .* reads"):
        Problem(dynamics, tx.Minimize(running=gain * u**2), by_node=[gain], **ends)
    with pytest.raises(ModelError, match=r"by_node names 'weight', which a rate, a constraint .* reads"):
        Problem(dynamics, tx.Minimize(running=weight * u**2), by_node=[weight], final=[p == weight], **ends)
    with pytest.raises(ModelError, match=r"by_node names 'weight', which the objective does not read"):
        Problem(dynamics, tx.Minimize(running=u**2), by_node=[weight], **ends)
    with pytest.raises(ModelError, match=r"by_node expects a list of parameters"):
        Problem(dynamics, tx.Minimize(running=u**2), by_node=weight, **ends)
    with pytest.raises(ModelError, match=r"by_node and free both name 'weight'"):
        Problem(dynamics, tx.Minimize(running=weight * u**2), by_node=[weight], free=[weight], **ends)
    with pytest.raises(ModelError, match=r"by_node names 'weight' in two phases"):
        Problem([Phase(dynamics, tx.Minimize(running=weight * u**2), by_node=[weight], **ends) for _ in range(2)])
