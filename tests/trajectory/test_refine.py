"""Meshes made finer: published and exact optima, errors that are those of an independent integration, statuses."""

from typing import Any

import numpy as np
import pytest
import scipy.integrate
from trajectory_systems import HEUN, double_integrator

import twistax as tx
from twistax.trajectory import Linear, Mesh, Meshed, Problem, Status
from twistax.trajectory.result import refine


def test_a_jump_between_nodes() -> None:
    """Full ahead, full back, T = 2: intervals are split about the jump until that is the final time."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    problem = Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(tx.Time()),
        nodes=8,
        final_time=(0.5, 6.0),
        initial={p: 0.0, v: 0.0},
        final=[{v: 0.0}, p == 1.0],
        at={4: v <= 5.0},
        **HEUN,
    )
    result = problem.solve(refine=1e-6)
    assert result.solved
    assert result.cost == pytest.approx(2.0, rel=1e-6)
    assert abs(result.meshes[0].cost - 2.0) > 1e-2
    assert abs(result.meshes[-1].cost - result.meshes[-2].cost) <= 2e-6
    assert [m.nodes for m in result.meshes] == sorted(m.nodes for m in result.meshes)
    assert isinstance(result.meshes[0], Meshed)
    assert result.compile_seconds + result.solve_seconds == pytest.approx(sum(m.seconds for m in result.meshes))
    assert result.problem.nodes == result.meshes[-1].nodes == len(result.ts)
    assert "mesh of 8 nodes" in result.explain()
    # Where node 4 was there is a node still, and its condition with it.
    (number,) = result.problem.node_rows
    assert result.problem.mesh.shares[number] == pytest.approx(4.0 / 7.0)


def pendulum(**options: Any) -> Problem:
    a, w, u = tx.State("a"), tx.State("w"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={a: w, w: u - 9.81 * tx.Sin(a)}))
    ends: dict[str, Any] = {"initial": {a: 0.0, w: 0.0}, "final": {a: np.pi, w: 0.0}}
    return Problem(dynamics, tx.Minimize(running=u**2), final_time=1.5, **options, **ends)


def test_errors_are_those_of_an_independent_integration(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = pendulum(nodes=5, controls=Linear())
    coarse = problem.solve()
    (errors,) = coarse.accuracy.intervals
    us, ts = coarse.us["u"], coarse.ts
    for k in range(4):
        slope = (us[k + 1] - us[k]) / (ts[k + 1] - ts[k])
        begin = [coarse.xs["a"][k], coarse.xs["w"][k]]

        def rate(t: float, x: Any, k: int = k, slope: float = slope) -> list[float]:
            return [x[1], us[k] + slope * (t - ts[k]) - 9.81 * np.sin(x[0])]

        own = scipy.integrate.solve_ivp(rate, (ts[k], ts[k + 1]), begin, rtol=1e-11, atol=1e-11).y[:, -1]
        gap = np.abs(own - [coarse.xs["a"][k + 1], coarse.xs["w"][k + 1]]) / coarse.warm.scales.d[k + 1, :2]
        assert errors[k] == pytest.approx(gap.max(), rel=1e-3)
    assert errors.max() > 1e-5
    result = problem.solve(refine=1e-3)
    assert result.solved
    assert result.meshes[0].error == pytest.approx(errors.max(), rel=1e-2)
    assert result.accuracy.error <= 1e-3
    assert result.cost == pytest.approx(78.217, rel=1e-3)
    # A mesh that may not grow is said to be coarse.
    monkeypatch.setattr(refine, "_NODES", 6)
    ended = problem.solve(refine=1e-3)
    assert ended.status is Status.COARSE
    assert "could not be refined to 0.001: a finer mesh has more than 6 nodes. On 5 nodes" in ended.message
    assert "Mesh(n, free=True)" in ended.message
    assert not ended.solved


def test_refined_and_held_between_nodes_on_free_nodes() -> None:
    p, v, u = tx.State("p"), tx.State("v", max=0.8), tx.Control("u", min=-1.0, max=1.0)
    problem = Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(tx.Time()),
        nodes=Mesh(4, free=True),
        final_time=(0.5, 6.0),
        initial={p: 0.0, v: 0.0},
        final={p: 1.0, v: 0.0},
        **HEUN,
    )
    result = problem.solve(refine=1e-6, between=1e-6)
    assert result.solved
    assert result.cost == pytest.approx(0.8 + 1.0 / 0.8, rel=1e-6)
    assert max(result.between_nodes.values()) <= 1e-6
    assert len(result.meshes) > 1


@pytest.mark.parametrize("tolerance", [0.0, 1.0, -1e-6, "fine", True])
def test_tolerances_that_are_none(tolerance: Any) -> None:
    problem = Problem(tx.compile(double_integrator()), tx.Minimize(tx.Time()), final_time=(1.0, 2.0))
    with pytest.raises(tx.TrajectoryError, match="refine"):
        problem.solve(refine=tolerance)
