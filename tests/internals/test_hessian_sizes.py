"""Hessians: operations beside CasADi, and those that are too large."""

from typing import Any

import numpy as np
import pytest
from test_hessian import FALLING, falling

import twistax as tx
from twistax.report.figures import hessians as of_the_arm
from twistax.scalar.graph import TooLarge
from twistax.system import hessian as hessians

RNG = np.random.default_rng(0)


def test_operations_of_the_arm_beside_casadi() -> None:
    """Of the weighted forward dynamics of seven links by positions, velocities and torques: fewer than CasADi's."""
    pytest.importorskip("casadi")
    own, theirs = of_the_arm.operations()
    assert own <= 0.75 * theirs
    assert of_the_arm.in_casadi().nnz_out(0) == of_the_arm.dynamics().hessian_pattern("qd").sum()


def test_what_is_too_large_is_left_to_jax(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same numbers, under jit and batched; there is no pattern."""

    def refused(*arguments: Any) -> Any:
        raise TooLarge("the function takes more than 200000 scalars")

    x = {"g": np.asarray(tx.pose(position=[1.0, -0.4, 0.7], euler=[0.4, -0.9, 2.0])), "V": RNG.normal(size=6)}
    u, weights = {"F": RNG.normal(size=6)}, {"V": RNG.normal(size=6), "reach": RNG.normal(size=3)}
    expected = FALLING.hessian(0.0, x, u, None, weights, wrt=("u", "x"))
    monkeypatch.setattr(hessians, "columns_of", refused)
    plain = falling()
    found = plain.hessian(0.0, x, u, None, weights, wrt=("u", "x"))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    assert np.array_equal(found, found.T)
    with pytest.raises(tx.ModelError, match="the Hessian has no pattern"):
        plain.hessian_pattern(weights)
