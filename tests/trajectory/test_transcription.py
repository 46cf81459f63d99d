"""Collocation on the group: its order, its derivatives, stiff rates, and what is refused."""

from typing import Any

import jax
import numpy as np
import pytest
from core_functions import core_values, staged_of
from trajectory_systems import double_integrator, spinning_ball

import twistax as tx
from twistax.trajectory import Collocation, MultipleShooting, Problem
from twistax.trajectory.transcription.iterate import Instance, Iterate


def tumbling(transcription: Any, nodes: int = 3, final_time: float = 0.8) -> Problem:
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,), max=[3.0, None, None])
    u, t = tx.Control("u", shape=(3,)), tx.Time()
    J = np.array([1.0, 2.0, 3.0])
    rates = {R: w, w: (u + tx.Sin(3.0 * t) * R[:, 0] - tx.linalg.Cross(w, J * w)) / J}
    objective = tx.Minimize(w[0] ** 2, running=u @ u + w @ w + R[0, 1] * t)
    dynamics = tx.compile(tx.System(rates=rates, constraints={"level": R[2, 0] * w[1] <= 2.0}))
    ends: dict[str, Any] = {"initial": {R: np.eye(3)}}
    return Problem(
        dynamics,
        objective,
        nodes=nodes,
        final_time=(0.1, 2.0),
        final_time_guess=final_time,
        transcription=transcription,
        **ends,
    )


def point_of(problem: Problem, final_time: float) -> Iterate:
    rng = np.random.default_rng(0)
    nodes = problem.nodes
    xs = {"R": np.array(jax.vmap(tx.SO3.exp)(0.2 * rng.normal(size=(nodes, 3)))), "w": rng.normal(size=(nodes, 3))}
    return Iterate(xs, rng.normal(size=(nodes - 1, 3)), np.array([final_time]))


@pytest.mark.parametrize(
    ("tableau", "order"),
    [
        (tx.tableaus.GAUSS_LEGENDRE4, 4),
        pytest.param(tx.tableaus.GAUSS_LEGENDRE6, 6, marks=pytest.mark.slow),
        (tx.tableaus.RADAU_IIA5, 5),
    ],
)
def test_the_order_of_an_interval_and_of_its_cost(tableau: Any, order: int) -> None:
    """Against the same system with its cost as a state, integrated to round-off."""
    problem, errors = tumbling(Collocation(tableau), nodes=2), []
    given = Instance({}, {"R": np.eye(3), "w": np.zeros(3)}, problem.border.limits)
    staged = staged_of(problem, given)
    R, w, u, t = *problem.dynamics.states, problem.dynamics.controls[0], tx.Time()
    spent = tx.State("spent")
    rates = {s: problem.dynamics.system.rates[s.name] for s in (R, w)}
    whole = tx.compile(tx.System(rates={**rates, spent: u @ u + w @ w + R[0, 1] * t}))
    for final_time in (0.15, 0.075):
        point = point_of(problem, final_time)
        found = core_values(staged, point, given)
        x0 = {name: a[0] for name, a in point.xs.items()} | {"spent": np.float64(0.0)}
        exact = tx.integrate(whole, x0, t1=final_time, rtol=1e-13, atol=1e-13, u={"u": point.us[0]}).xs
        end = {name: np.asarray(exact[name])[-1] for name in exact}
        gap = np.concatenate([np.asarray(tx.SO3.log(point.xs["R"][1].T @ end["R"])), end["w"] - point.xs["w"][1]])
        cost = point.xs["w"][1][0] ** 2 + end["spent"]
        errors.append([np.abs(np.asarray(found.defects)[0] - gap).max(), abs(float(found.cost) - cost)])
    orders = np.log2(np.array(errors[0]) / np.array(errors[1]))
    np.testing.assert_allclose(orders, order + 1.0, atol=0.7)


def test_stiff_rates() -> None:
    """x' = -1e4 (x - u): explicit steps of 0.1 s would be off by powers of ten; Radau is not."""
    x, u = tx.State("x"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={x: -1e4 * (x - u)}))
    problem = Problem(
        dynamics,
        tx.Minimize(running=(x - 0.5) ** 2),
        nodes=11,
        final_time=1.0,
        initial={x: 0.5},
        transcription=Collocation(tx.tableaus.RADAU_IIA5),
    )
    result = problem.solve()
    assert result.solved
    np.testing.assert_allclose(result.us["u"], 0.5, atol=1e-3)
    assert result.cost < 1e-7


def test_what_is_no_transcription() -> None:
    dynamics = tx.compile(double_integrator())

    def problem(**options: Any) -> Problem:
        return Problem(dynamics, tx.Minimize(tx.Time()), final_time=(1.0, 2.0), **options)

    with pytest.raises(tx.TrajectoryError, match="Collocation expects a tableau"):
        Collocation(tx.tableaus.RK4)
    with pytest.raises(tx.TrajectoryError, match="substeps"):
        Collocation(tx.tableaus.RADAU_IIA5, substeps=0)
    with pytest.raises(tx.TrajectoryError, match="transcription expects"):
        problem(transcription="shooting")
    with pytest.raises(tx.TrajectoryError, match="belong to the transcription"):
        problem(transcription=MultipleShooting(), substeps=3)
    assert problem(substeps=3).transcription == MultipleShooting(substeps=3)
    ball = tx.compile(spinning_ball())
    assert Problem(ball, tx.Minimize(tx.Time()), final_time=1.0).transcription.substeps == 2
