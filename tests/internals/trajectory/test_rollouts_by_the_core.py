"""Rollouts by the core, beside those of the integrator."""

from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.trajectory import Collocation, Linear, Mesh, Problem
from twistax.trajectory.strategy.integration import CoreRollout

pytest.importorskip("llvmlite")


def turned(inertia: float = 2.0, nodes: Any = 8, reach: float = 1.1, **options: Any) -> Problem:
    """A body turns and passes a ball: a group, a node's condition and a free time."""
    R, w, x = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.State("x", shape=(2,))
    u = tx.Control("u", shape=(3,), min=-3.0, max=3.0)
    J = np.array([[inertia, 0.1, 0.0], [0.1, 1.5, 0.2], [0.0, 0.2, 1.2]])
    rates = {R: w, w: np.linalg.inv(J) @ (u - tx.linalg.Cross(w, J @ w)), x: 0.9 * R[:2, 0]}
    clear = (x - np.array([0.8, 0.1])) @ (x - np.array([0.8, 0.1])) >= 0.01 * reach
    return Problem(
        tx.compile(tx.System(rates=rates, constraints={"clear": clear})),
        tx.Minimize(tx.Time() * 0.3 * reach, running=u @ u),
        **{"nodes": nodes, "final_time": (0.7, 4.0), "final_time_guess": 2.0, "at": {2: x[0] >= 0.1 * reach}}
        | {"initial": {R: np.eye(3), w: np.zeros(3), x: np.zeros(2)}, "final": [R[2, 2] <= 0.7, x[0] == reach]}
        | options,
    )


WAYS: dict[str, dict[str, Any]] = {
    "linear controls": {"controls": Linear()},
    "collocation": {"transcription": Collocation(tx.tableaus.GAUSS_LEGENDRE4)},
    "free nodes": {"nodes": Mesh(7, free=True)},
}


@pytest.mark.parametrize("options", WAYS.values(), ids=WAYS.keys())
def test_rollouts_by_the_core_are_those_of_the_integrator(options: dict[str, Any]) -> None:
    """Of held controls, as `between` looks at them, beside `replay`: of a group, and of free nodes."""
    problem = turned(**options)
    result = problem.solve()
    core, given = problem.core(1e-6, *problem.started()[:2]), problem.started().instance
    data = core.staged.numbers.vector(given)
    rollout = CoreRollout(core.staged.parts[0], problem.transcription.rolling(12), core.staged.border.size, data)
    found, expected = rollout.states(result.warm.point), result.replay(steps=12)
    for name, values in expected.xs.items():
        np.testing.assert_allclose(found[name], values, atol=1e-11)
