"""Rollouts by the core, beside those of the integrator."""

from typing import Any

import numpy as np
import pytest
from test_numbers import turned

import twistax as tx
from twistax.trajectory import Collocation, Linear, Mesh
from twistax.trajectory.strategy.integration import CoreRollout

pytest.importorskip("llvmlite")


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
    rollout = CoreRollout(core.staged.parts[0], problem.transcription.rolling(12), core.staged.numbers, data)
    found, expected = rollout.states(result.warm.point), result.replay(steps=12)
    for name, values in expected.xs.items():
        np.testing.assert_allclose(found[name], values, atol=1e-11)
