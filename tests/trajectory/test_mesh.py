"""Nodes at any times: exact answers on uneven meshes, and errors for those that are none."""

from typing import Any

import numpy as np
import pytest
from trajectory_systems import double_integrator

import twistax as tx
from twistax.trajectory import Problem

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
    problem = Problem(dynamics, tx.Minimize(running=u**2), nodes=SHARES, final_time=2.0, **ends)
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
