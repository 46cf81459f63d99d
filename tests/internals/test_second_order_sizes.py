"""Second-order discretizations of batches and in single precision, and those that are too large."""

from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.scalar.graph import TooLarge
from twistax.system import hessian
from twistax.trajectory import discretize

RNG = np.random.default_rng(0)


N, M = 7, 2


X = {"R": np.asarray(tx.lie.so3.exp([0.4, -1.2, 2.0])), "w": np.array([0.5, -0.8, 1.1]), "m": np.array(1.3)}


U, WEIGHTS = {"u": np.array(0.7), "k": np.array(0.2)}, RNG.normal(size=N)


def test_batches_precision_and_what_is_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    R, u, euler = tx.State("R", group=tx.SO3), tx.Control("u"), tx.RKMK(tx.tableaus.EULER)
    system = tx.System(rates={R: u * R[2] + tx.Sin(tx.Time()) * tx.linalg.Cross(R[0], [0.3, 0.1, 0.8])})
    rolling = tx.compile(system)

    def interval(R: Any, dynamics: tx.Dynamics = rolling) -> tuple[jax.Array, jax.Array]:
        step = discretize(dynamics, 0.2, {"R": R}, {"u": U["u"]}, 0.3, method=euler, weights=WEIGHTS[:3])
        return step.hessian, step.A

    Rs = np.array([X["R"], X["R"].T])
    compiled = jax.jit(interval)
    one = [compiled(own)[0] for own in Rs]
    many = jax.jit(jax.vmap(lambda own: interval(own)[0]))(Rs)
    np.testing.assert_allclose(many, one, atol=1e-13)
    assert np.abs(one[0] - one[1]).max() > 1e-2
    single = compiled(np.float32(X["R"]))
    assert single[0].dtype == single[1].dtype == np.float32
    np.testing.assert_allclose(single[0], one[0], atol=1e-5)

    def refused(*arguments: Any) -> Any:
        raise TooLarge("the function takes more than 200000 scalars")

    monkeypatch.setattr(hessian, "columns_of", refused)
    left = jax.jit(lambda own: interval(own, tx.compile(system)))(X["R"])
    np.testing.assert_allclose(left[0], one[0], atol=1e-13)
    np.testing.assert_allclose(left[1], compiled(X["R"])[1], atol=1e-13)
