"""Problems of phases on finer meshes: each phase by itself, an exact optimum, warm from mesh to mesh."""

from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.trajectory import Phase, Problem

pytestmark = pytest.mark.slow

p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)


def problem() -> Any:
    """Least time: from rest over 0.3 m to 0.5 m/s, a jump back by 0.1 m, and from there to rest at 1 m."""
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    times: dict[str, Any] = {"final_time": (0.2, 4.0), **HEUN}
    return Problem(
        [
            Phase(dynamics, initial={p: 0.0, v: 0.0}, final=[p == 0.3, v == 0.5], nodes=4, **times),
            Phase(dynamics, tx.Minimize(tx.Time()), final={p: 1.0, v: 0.0}, nodes=5, name="rest", **times),
        ],
        links=[{p: p - 0.1}],
    )


def exact() -> float:
    """Full ahead and full back in each phase, with a peak of the speed in between."""
    first, second = (np.sqrt(0.5 * (2.0 * way + 0.5**2)) for way in (0.3, 0.8))
    return float(2.0 * first + 2.0 * second - 1.0)


def test_jumps_between_nodes_of_two_phases() -> None:
    coarse = problem().solve()
    assert coarse.solved
    result = coarse.problem.solve(refine=2e-3)
    assert result.solved
    assert result.meshes[0].nodes == 9
    assert result.meshes[0].cost == pytest.approx(coarse.cost, rel=1e-6)
    assert coarse.cost - exact() > 5e-3
    assert 0.0 <= result.cost - exact() < 2e-3
    nodes = [len(phase.ts) for phase in result.phases]
    assert result.meshes[-1].nodes == sum(nodes)
    assert nodes == [part.nodes for part in result.problem.parts]
    # Warm from mesh to mesh, and each phase about its own jump.
    assert result.iterations < 15
    for phase in result.phases:
        steps = np.diff(phase.ts)
        turn = np.flatnonzero(np.abs(np.diff(phase.us["u"])) > 0.1)
        assert steps[turn].max() < steps.max()
    assert "mesh of 9 nodes" in result.explain()


def test_each_phase_by_its_own_error() -> None:
    """A coast without an error keeps its mesh; a pendulum that is pushed is split; a condition stays at its node."""
    a, w = tx.State("a"), tx.State("w")
    swing = tx.compile(tx.System(rates={a: w, w: 4.0 * u - 9.81 * tx.Sin(a)}))
    coast = tx.compile(tx.System(rates={a: w, w: 0.0 * a}))
    push = Phase(
        swing, tx.Minimize(running=u**2), final_time=1.0, initial={a: 0.0, w: 0.0}, at={2: w <= 2.0}, nodes=6, **HEUN
    )
    drift = Phase(coast, final_time=0.5, final={a: 0.6}, nodes=3, **HEUN)
    result = Problem([push, drift]).solve(refine=1e-3)
    assert result.solved
    first, second = result.problem.parts
    assert second.nodes == 3
    assert second.transcription.substeps == 1
    assert first.nodes > 6
    (number,) = first.node_rows
    assert first.mesh.shares[number] == pytest.approx(0.4)
    assert result.meshes[-1].error <= 1e-3 < result.meshes[0].error
    for phase in result.phases:
        assert max(own["distance"] for own in phase.mesh_error.values()) < 1e-2
