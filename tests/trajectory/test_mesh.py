"""Nodes at any times: exact answers on uneven meshes, and errors for those that are none."""

from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN, double_integrator

import twistax as tx
from twistax.trajectory import Mesh, Problem, TrajectoryResult

SHARES = np.array([0.0, 0.05, 0.3, 0.35, 0.8, 1.0])


def least_energy(widths: np.ndarray) -> np.ndarray:
    """The held controls of least energy that move a double integrator by 1, rest to rest; exact linear algebra."""
    left = widths.sum() - np.cumsum(widths)
    ends = np.stack([widths * (left + widths / 2.0), widths])
    weighted = ends / widths
    return weighted.T @ np.linalg.solve(ends @ weighted.T, [1.0, 0.0])


def test_least_energy_on_uneven_nodes() -> None:
    dynamics = tx.compile(double_integrator())
    u = dynamics.controls[0]
    ends: dict[str, Any] = {"initial": {"p": 0.0, "v": 0.0}, "final": {"p": 1.0, "v": 0.0}}
    problem = Problem(dynamics, tx.Minimize(running=u**2), nodes=SHARES, final_time=2.0, **ends, **HEUN)
    result = problem.solve(tolerance=1e-8)
    assert result.solved
    widths = 2.0 * np.diff(SHARES)
    expected = least_energy(widths)
    np.testing.assert_allclose(result.us["u"], expected, atol=1e-6)
    assert result.cost == pytest.approx(widths @ expected**2, rel=1e-8)
    np.testing.assert_allclose(result.ts, 2.0 * SHARES, atol=1e-15)
    replay = result.replay(steps=3)
    assert replay.misses["p"]["distance"] < 1e-8
    np.testing.assert_allclose(replay.ts[::3], result.ts, atol=1e-15)
    np.testing.assert_allclose(replay.xs["p"][::3], result.xs["p"], atol=1e-8)
    with pytest.raises(tx.TrajectoryError, match="nodes at equal distances"):
        result.shifted()


@pytest.mark.parametrize(
    "nodes", [1, 2.5, True, [0.0, 1.0, 1.0], [0.0, 0.5], [0.1, 1.0], [0.0], [[0.0, 1.0]], [0.0, np.nan, 1.0], "ten"]
)
def test_nodes_that_are_none(nodes: Any) -> None:
    dynamics = tx.compile(double_integrator())
    with pytest.raises(tx.TrajectoryError, match="nodes"):
        Problem(dynamics, tx.Minimize(tx.Time()), nodes=nodes, final_time=2.0)


def test_a_jump_is_found_between_nodes() -> None:
    """Full ahead, full back, T = 2: the node in the middle goes to where the control jumps."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    problem = Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(tx.Time()),
        nodes=Mesh([0.0, 0.2, 1.0], free=True),
        final_time=(0.5, 6.0),
        initial={p: 0.0, v: 0.0},
        final={p: 1.0, v: 0.0},
        **HEUN,
    )
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(2.0, rel=1e-6)
    np.testing.assert_allclose(result.ts, [0.0, 1.0, 2.0], atol=1e-5)
    np.testing.assert_allclose(result.us["u"], [1.0, -1.0], atol=1e-5)
    assert set(result.xs) == {"p", "v"} == set(result.mesh_error)
    assert result.mesh_error["p"]["distance"] < 1e-6


def test_time_and_running_costs_on_free_nodes() -> None:
    """Of least energy against a force that swings: never more than on fixed nodes, and what a rollout costs."""
    p, v, u, t = tx.State("p"), tx.State("v"), tx.Control("u"), tx.Time()
    dynamics = tx.compile(tx.System(rates={p: v, v: u + tx.Sin(4.0 * t)}))
    cost = tx.Minimize(tx.Time() ** 2, running=u**2 + t)
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": [{p: 1.0, v: 0.0}, p == 0.5 * t]}

    def solved(nodes: Any) -> TrajectoryResult:
        return Problem(dynamics, cost, nodes=nodes, final_time=(1.0, 3.0), substeps=8, **ends).solve()

    uneven = np.array([0.0, 0.1, 0.2, 0.3, 1.0])
    fixed, free = solved(uneven), solved(Mesh(uneven, free=(0.5, 4.0)))
    assert fixed.solved
    assert free.solved
    assert free.final_time == pytest.approx(2.0, abs=1e-6)
    assert free.cost < fixed.cost - 1e-2
    steps = np.diff(free.ts)
    assert (steps >= np.diff(uneven) - 1e-6).all()
    assert free.cost == pytest.approx(4.0 + free.us["u"] ** 2 @ steps + 2.0, rel=1e-5)
    x0 = {"p": np.float64(0.0), "v": np.float64(0.0)}
    own = tx.integrate(dynamics, x0, t1=free.final_time, rtol=1e-9, atol=1e-9, u=free.controls)
    assert float(own.xs["p"][-1] if np.ndim(own.xs["p"]) else own.xs["p"]) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("free", [0.5, (1.0, 2.0), (0.5, 1.0), (0.0, 2.0), "yes", None])
def test_limits_of_lengths_that_are_none(free: Any) -> None:
    with pytest.raises(tx.TrajectoryError, match="Mesh: free"):
        Mesh(5, free=free)


def test_free_nodes_after_a_phase_with_others() -> None:
    """Rest to rest in least time, T = 2: the clock of the second phase begins when the first has ended."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    Phase = tx.trajectory.Phase
    first = Phase(dynamics, nodes=2, final_time=(0.1, 3.0), initial={p: 0.0, v: 0.0}, final=[p == 0.3], **HEUN)
    ends: dict[str, Any] = {"final_time": (0.1, 3.0), "final": {p: 1.0, v: 0.0}}
    second = Phase(dynamics, tx.Minimize(tx.Time()), nodes=Mesh(3, free=True), **ends, **HEUN)
    result = Problem([first, second]).solve()
    assert result.solved
    np.testing.assert_allclose(result.phases[1].ts, [np.sqrt(0.6), 1.0, 2.0], atol=1e-5)
