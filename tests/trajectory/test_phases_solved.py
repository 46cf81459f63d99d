"""Problems of phases solved as others are: warm, for other ends, by other solvers, between nodes, many at once."""

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from trajectory_systems import HEUN

import twistax as tx
from twistax.errors import InputError, ModelError, TrajectoryError
from twistax.trajectory import IPOPT, Fatrop, Phase, PhasedResult, Problem
from twistax.trajectory.result import refine
from twistax.trajectory.transcription.evaluation import Evaluated

WALL, NODES = -0.03, 6
STEP = 1.0 / (NODES - 1)
EXACT: dict[str, Any] = {**HEUN, "nodes": NODES}
p, v, u, w = tx.State("p"), tx.State("v"), tx.Control("u", min=-9.0, max=9.0), tx.State("w")


@functools.cache
def problem() -> Any:
    """From a start towards a wall, by 0.3 m after a second, to 1 m after two; w begins anywhere in the second."""
    wall = {"wall": p >= WALL}
    first = tx.compile(tx.System(rates={p: v, v: u}, constraints=wall))
    second = tx.compile(tx.System(rates={p: v, v: u, w: v}, constraints=wall))
    cost, last = tx.Minimize(running=u**2), tx.Parameter("last", value=0.7)
    return Problem(
        [
            Phase(first, cost, final_time=1.0, initial={p: 0.0, v: -0.4}, final=[p == 0.3], name="a", **EXACT),
            Phase(second, cost, final_time=1.0, final=[{p: 1.0}, w == 0.0, v == last], name="b", **EXACT),
        ]
    )


def best(begin: float = 0.0, end: float = 1.0, last: float = 0.7) -> float:
    """The least cost, by SciPy: its unknowns are the held controls alone."""
    count = 2 * (NODES - 1)
    rows = np.zeros((count + 1, 2, count))
    drift = np.array([[begin, -0.4]] * (count + 1))
    for k in range(count):
        step = np.array([[1.0, STEP], [0.0, 1.0]])
        rows[k + 1], drift[k + 1] = step @ rows[k], step @ drift[k]
        rows[k + 1, :, k] += [0.5 * STEP**2, STEP]
    at = np.concatenate([rows[[NODES - 1, count], 0], rows[[count], 1]])
    offset = np.array([drift[NODES - 1, 0] - 0.3, drift[count, 0] - end, drift[count, 1] - last])
    found = minimize(
        lambda z: STEP * z @ z,
        np.zeros(count),
        jac=lambda z: 2.0 * STEP * z,
        constraints=[
            {"type": "eq", "fun": lambda z: at @ z + offset, "jac": lambda z: at},
            {"type": "ineq", "fun": lambda z: rows[:, 0] @ z + drift[:, 0] - WALL, "jac": lambda z: rows[:, 0]},
        ],
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert found.success
    return float(found.fun)


@functools.cache
def solved() -> PhasedResult:
    result: PhasedResult = problem().solve()
    return result


def test_warm_and_for_other_ends() -> None:
    result = solved()
    assert result.solved
    assert result.cost == pytest.approx(best(), rel=1e-6)
    again = problem().solve(warm=result)
    assert again.solved
    assert again.iterations <= 2 < result.iterations
    assert again.cost == pytest.approx(result.cost, rel=1e-7)
    other = problem().solve(warm=result, initial={"a": {p: 0.05}}, final={"b": {p: 1.1}}, params={"last": 0.6})
    assert other.cost == pytest.approx(best(0.05, 1.1, 0.6), rel=1e-6)
    assert other.phases[0].xs["p"][0] == 0.05
    assert other.phases[1].xs["p"][-1] == pytest.approx(1.1, abs=1e-9)
    assert problem().solve(guess={"b": {u: 1.0}}, guesses=2).cost == pytest.approx(result.cost, rel=1e-6)


@pytest.mark.parametrize("solver", [IPOPT(), pytest.param(Fatrop(), marks=pytest.mark.slow)])
def test_by_solvers_of_others(solver: Any) -> None:
    pytest.importorskip("casadi")
    result = problem().solve(solver=solver)
    assert result.solved
    ours = problem().solve(tolerance=1e-7)
    assert result.cost == pytest.approx(ours.cost, rel=5e-7)  # they relax limits by 1e-8
    for own, other in zip(result.phases, ours.phases):
        np.testing.assert_allclose(own.xs["p"], other.xs["p"], atol=1e-5)
    np.testing.assert_allclose(result.phases[1].xs["w"], ours.phases[1].xs["w"], atol=1e-5)


def lowest(result: PhasedResult) -> float:
    """The lowest place of all, of parabolas between the nodes."""
    found = []
    for phase in result.phases:
        for x, speed, push in zip(phase.xs["p"], phase.xs["v"], phase.us["u"]):
            turn = np.clip(-speed / push, 0.0, STEP)
            found.append(x + speed * turn + 0.5 * push * turn**2)
    return float(min(found))


def test_limits_between_nodes() -> None:
    assert lowest(solved()) < WALL - 1e-4
    held = problem().solve(between=1e-6)
    assert held.solved
    assert lowest(held) > WALL - 1e-6
    assert held.between_nodes["a: wall"] < 1e-6
    assert held.cost > solved().cost


def test_a_finer_mesh_begins_where_the_coarse_one_ended() -> None:
    """Halves of intervals have the same controls, so the dynamics hold; each phase has nodes of its own."""
    result = solved()
    errors = result.accuracy.intervals
    assert [own.shape for own in errors] == [(NODES - 1,)] * 2
    assert np.max(errors) < 1e-9
    finer, warm = refine._finer(result, errors, 1e-3, is_settled=False) or (None, None)
    assert finer is not None
    assert all(part.nodes > NODES for part in finer.parts)
    staged = finer.core(1e-6, warm.point, finer.started().instance).staged
    values = Evaluated(staged.transcription, staged.flat(warm.point))
    np.testing.assert_allclose(values.c, 0.0, atol=1e-9)
    assert values.cost[0] == pytest.approx(result.cost, rel=1e-9)
    again = dataclasses.replace(result, problem=finer, warm=warm)
    for old, new in zip(result.phases, refine._trajectories(again)):
        np.testing.assert_allclose(np.interp(old.ts, new.ts, new.xs["v"]), old.xs["v"], atol=1e-9)
    # What the ends of the whole are worth.
    rows = [
        s.rows_of(s.segments[1], r) for s, r in ((finer.shooting, warm.rows), (problem().shooting, result.warm.rows))
    ]
    np.testing.assert_array_equal(rows[0][-3:], rows[1][-3:])


def refused(kind: type[Exception], word: str, **options: Any) -> None:
    with pytest.raises(kind, match=word):
        problem().solve(**options)


def test_what_does_not_fit_is_refused() -> None:
    refused(ModelError, "dict from names of phases", final_time=3.0)
    refused(ModelError, "the phases are: 'a', 'b'", initial={p: 0.0})
    refused(ModelError, "the phases are: 'a', 'b'", final_time={"c": 1.0})
    refused(TrajectoryError, "a: .*must fix the entries", initial={"a": {p: None}})
    refused(TrajectoryError, "b: .*a number, because it is fixed", final_time={"b": (1.0, 2.0)})
    refused(ModelError, "b: guess names 'x'", guess={"b": {"x": 1.0}})
    refused(ModelError, "leaves free: none", free={"last": (0.0, 1.0)})
    refused(InputError, "unknown key 'x'", params={"x": 1.0})
    refused(TrajectoryError, "leave out guess", warm=solved(), guess={"b": {u: 1.0}})
    with pytest.raises(TrajectoryError, match="several phases"):
        solved().shifted()


@pytest.mark.slow
def test_many_cases() -> None:
    starts = np.array([0.0, 0.02, 0.05])
    many = problem().solve_many(initial={"a": {p: starts}}, params={"last": np.array([0.7, 0.7, 0.6])})
    np.testing.assert_allclose(many.cost, [best(x, 1.0, last) for x, last in zip(starts, (0.7, 0.7, 0.6))], rtol=1e-6)
    assert many.solved.all()
    assert many.xs["b"]["w"].shape == (3, NODES)
    np.testing.assert_allclose(many.params["last"], [0.7, 0.7, 0.6])
    np.testing.assert_allclose(many.durations["b"], 1.0)
    assert many[1].phases[0].xs["p"][0] == 0.02
    with pytest.raises(InputError, match="index of a case must be from 0 to 2, got 5"):
        many[5]
