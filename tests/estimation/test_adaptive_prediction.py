"""Predictions whose steps follow from tolerances, against predictions with many short steps."""

import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.estimation import ErrorStateKalman, Filter, InvariantKalman, SquareRootKalman, UnscentedKalman

angle, speed = tx.State("angle"), tx.State("speed")
PUSH = tx.Noise("push", density=tx.Parameter("density", value=0.1))
PENDULUM = tx.compile(tx.System(rates={angle: speed, speed: PUSH - 100.0 * tx.Sin(angle)}))
READING = tx.Measurement("reading", angle, covariance=1e-2)
RECORDS = {"reading": (np.arange(3.0), np.array([0.5, 0.3, 0.2]))}
START: dict[str, Any] = {"angle": 0.5, "speed": 0.0}
P0 = np.array([0.01, 0.1])
TOLERANCES = {"rtol": 1e-8, "atol": 1e-10}


@pytest.mark.parametrize(
    ("kind", "accuracy"),
    [
        (ErrorStateKalman, 2e-6),
        pytest.param(SquareRootKalman, 2e-6, marks=pytest.mark.thorough),
        pytest.param(InvariantKalman, 2e-6, marks=pytest.mark.thorough),
        pytest.param(UnscentedKalman, 1e-3, marks=pytest.mark.thorough),
    ],
)
def test_a_fast_pendulum_with_slow_records_is_predicted_as_by_short_steps(kind: type[Filter], accuracy: float) -> None:
    adaptive = kind(PENDULUM, [READING], **TOLERANCES).run(RECORDS, START, P0)
    short = kind(PENDULUM, [READING], max_step=1e-3).run(RECORDS, START, P0)
    assert adaptive.result == "successful"
    assert (np.asarray(adaptive.steps[1:]) > 20).all()
    assert adaptive.steps[0] == 0
    for name in START:
        np.testing.assert_allclose(adaptive.xs[name], short.xs[name][::1000], atol=accuracy)
    np.testing.assert_allclose(adaptive.P, short.P[::1000], atol=accuracy)
    products = [functools.reduce(np.matmul, np.asarray(short.transitions[k + 1000 : k : -1])) for k in (0, 1000)]
    transitions = [np.eye(2), *products]
    np.testing.assert_allclose(adaptive.transitions, transitions, atol=100.0 * accuracy)


@pytest.mark.thorough
def test_runs_in_a_batch_and_derivatives_are_those_of_single_runs_and_of_differences() -> None:
    kalman = ErrorStateKalman(PENDULUM, [READING], **TOLERANCES)

    def likelihood(z: jax.Array) -> jax.Array:
        x0 = {"angle": z[0], "speed": z[1]}
        return kalman.run(RECORDS, x0, P0 * z[2], params={"density": z[3]}).log_likelihood

    z = jnp.array([0.5, 0.1, 1.0, 0.1])
    # A start at rest next to a fast one: the runs of the batch have other numbers of steps.
    several = jnp.stack([z, jnp.array([0.0, 0.0, 1.0, 0.1]), z + 1.0])
    alone = [likelihood(row) for row in several]
    np.testing.assert_allclose(jax.jit(jax.vmap(likelihood))(several), alone, rtol=1e-10)
    forward, reverse = jax.jit(jax.jacfwd(likelihood))(z), jax.jit(jax.grad(likelihood))(z)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    shifts = 3e-4 * np.eye(4)
    differences = [(likelihood(z + d) - likelihood(z - d)) / 6e-4 for d in shifts]
    np.testing.assert_allclose(reverse, differences, rtol=1e-3, atol=1e-3)


def test_a_prediction_that_cannot_meet_its_tolerances_is_named() -> None:
    kalman = ErrorStateKalman(PENDULUM, [READING], **TOLERANCES, control=tx.StepControl(max_steps=8))
    with pytest.raises(tx.EstimationError, match=r"prediction at t = 1 s, MAX_STEPS(.|\n)*control=tx.StepControl"):
        kalman.run(RECORDS, START, P0)
    run = jax.jit(lambda x0: kalman.run(RECORDS, x0, P0))(START)
    assert run.result.startswith("stopped in the prediction at t = 1 s, MAX_STEPS")
    assert np.isfinite(run.P[0]).all()
    assert np.isnan(run.P[1:]).all()
    assert np.isnan(run.xs["speed"][1:]).all()
    diverging = tx.compile(tx.System(rates={angle: angle**3}))
    prediction = ErrorStateKalman(diverging, [READING], rtol=1e-3).predict(1.0, {"angle": 1.0}, 0.01, 1.0)
    assert prediction.code in (tx.Result.STEP_TOO_SMALL, tx.Result.NON_FINITE)
    assert np.isnan(prediction.x["angle"])


def test_what_does_not_go_with_tolerances_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(tx.ModelError, match=r"embedded solution, got RK4(.|\n)*TSIT5"):
        ErrorStateKalman(PENDULUM, [READING], rtol=1e-6, method=tx.RKMK(tx.tableaus.RK4))
    with pytest.raises(tx.InputError, match="rtol must be a positive number"):
        ErrorStateKalman(PENDULUM, [READING], rtol=-1.0)
    with pytest.raises(tx.InputError, match="requires rtol"):
        UnscentedKalman(PENDULUM, [READING], control=tx.StepControl())
    with pytest.raises(tx.ModelError, match=r"rtol has no form in C(.|\n)*without rtol"):
        ErrorStateKalman(PENDULUM, [READING], rtol=1e-6).to_c(tmp_path)


@pytest.mark.thorough
def test_a_tumbling_body_in_single_precision() -> None:
    """Rotations, with an order of tangents, and tolerances by state."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    J = np.diag([1.0, 2.0, 3.0])
    torque = tx.Noise("torque", shape=(3,), density=0.01)
    body = tx.compile(tx.System(rates={R: w, w: np.linalg.inv(J) @ (tx.linalg.Cross(J @ w, w) + torque)}))
    star = tx.Measurement("star", R, covariance=1e-4)
    x0 = {"R": np.eye(3, dtype=np.float32), "w": np.array([0.5, 1.0, 3.0], np.float32)}
    arguments = 0.0, x0, np.float32(1e-4), np.float32(2.0)
    kalman = ErrorStateKalman(body, [star], rtol=1e-5, atol={"R": 1e-5, "w": 1e-5})
    assert "rank 6 of 6" in kalman.explain({"star": [0.0, 2.0]}, x0)
    adaptive = kalman.predict(*arguments)
    short = ErrorStateKalman(body, [star]).run(
        {}, jax.tree.map(np.float64, x0), 1e-4, t0=0.0, save_at=np.linspace(0.0, 2.0, 1001)
    )
    assert adaptive.P.dtype == np.float32
    assert adaptive.code == 0
    np.testing.assert_allclose(adaptive.x["R"], short.xs["R"][-1], atol=1e-3)
    np.testing.assert_allclose(adaptive.x["w"], short.xs["w"][-1], atol=1e-3)
    np.testing.assert_allclose(adaptive.P, short.P[-1], atol=1e-2 * np.abs(short.P[-1]).max())
