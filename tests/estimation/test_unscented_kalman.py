"""The unscented filter: exact for linear systems and for means of squares, and the error-state filter near a point."""

import numpy as np
import pytest

import twistax as tx
from twistax.estimation import ErrorStateKalman, UnscentedKalman

TIMES, VALUES = np.array([0.2, 0.5, 0.6, 1.1]), np.array([0.3, -0.2, np.nan, 0.4])


def test_the_linear_case_is_the_kalman_filter_and_its_smoother() -> None:
    """With a state that is known exactly: its variance is zero."""
    x, c = tx.State("x", shape=(2,)), tx.State("c")
    dynamics = tx.compile(tx.System(rates={x: tx.Concat(x[1], tx.Noise("w", density=0.7) - x[0] + c), c: 0.0}))
    position = tx.Measurement("y", x[0], covariance=0.09)
    unscented, exact = (
        kind(dynamics, [position]).run({"y": (TIMES, VALUES)}, {"x": np.zeros(2), "c": 0.5}, [1.0, 1.0, 0.0], t0=0.0)
        for kind in (UnscentedKalman, ErrorStateKalman)
    )
    np.testing.assert_allclose(unscented.log_likelihood, exact.log_likelihood, rtol=1e-11)
    np.testing.assert_allclose(unscented.xs["x"], exact.xs["x"], atol=1e-12)
    np.testing.assert_allclose(unscented.P, exact.P, atol=1e-12)
    np.testing.assert_allclose(unscented.smooth().xs["x"], exact.smooth().xs["x"], atol=1e-11)
    np.testing.assert_allclose(unscented.smooth().P, exact.smooth().P, atol=1e-11)


def test_the_mean_of_a_square_has_the_variance() -> None:
    """E[x^2] = m^2 + P, where the error-state filter expects m^2."""
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: 0.0}))
    square = tx.Measurement("y", x**2, covariance=0.01)
    update = UnscentedKalman(dynamics, [square]).update("y", 0.0, {"x": 1.5}, 0.3, 4.0)
    np.testing.assert_allclose(update.residual, [4.0 - (1.5**2 + 0.3)], rtol=1e-12)
    # Cov(x^2, x) = 2 m P, and two points have no spread of squares about a line but (2 m)^2 P.
    np.testing.assert_allclose(update.S, [[4.0 * 1.5**2 * 0.3 + 0.01]], rtol=1e-12)


def test_what_a_line_does_not_explain_is_noise() -> None:
    """Of two states the points lie at $+- 2^(1/2)$ deviations, so squares have the variance 4 m^2 P + P^2."""
    x = tx.State("x", shape=(2,))
    square = tx.Measurement("y", x[0] ** 2, covariance=0.01)
    kalman = UnscentedKalman(tx.compile(tx.System(rates={x: np.zeros(2)})), [square])
    update = kalman.update("y", 0.0, {"x": np.array([1.5, 0.0])}, 0.3, 4.0)
    np.testing.assert_allclose(update.S, [[4.0 * 1.5**2 * 0.3 + 0.3**2 + 0.01]], rtol=1e-12)


def test_small_covariances_on_a_group_are_those_of_the_error_state_filter() -> None:
    q = tx.State("q", group=tx.SO3)
    rates = {q: tx.Control("rate", shape=(3,)) + tx.Noise("n", shape=(3,), density=1e-4)}
    field = np.array([0.3, -0.2, 0.9])
    dynamics = tx.compile(tx.System(rates=rates))
    measurements = [tx.Measurement("field", q.T @ field, covariance=1e-6), tx.Measurement("star", q, covariance=1e-6)]
    start = np.asarray(tx.SO3.exp(np.array([0.5, 0.2, -0.8])))
    records = {
        "field": ([0.1, 0.4], start.T @ field + 1e-4 * np.array([[1.0, 2.0, -1.0], [0.0, 1.0, 1.0]])),
        "star": ([0.1], start[None]),
    }
    unscented, extended = (
        kind(dynamics, measurements).run(records, {"q": start}, 1e-6, t0=0.0, u={"rate": np.array([1e-3, 0.0, 2e-3])})
        for kind in (UnscentedKalman, ErrorStateKalman)
    )
    np.testing.assert_allclose(unscented.xs["q"], extended.xs["q"], atol=1e-8)
    np.testing.assert_allclose(unscented.P, extended.P, atol=1e-11)


@pytest.mark.parametrize("deviation", [0.3, 0.6])
def test_the_mean_of_a_vector_seen_with_a_wide_attitude_is_shorter(deviation: float) -> None:
    """Against samples: $E[Exp(-d) f] = f (1 + 2 c) / 3$, c the mean cosine of the angle, for an isotropic spread."""
    q = tx.State("q", group=tx.SO3)
    field = np.array([0.3, -0.2, 0.9])
    dynamics = tx.compile(tx.System(rates={q: np.zeros(3)}))
    kalman = UnscentedKalman(dynamics, [tx.Measurement("field", q.T @ field, covariance=0.01)])
    update = kalman.update("field", 0.0, {"q": np.eye(3)}, deviation**2, np.zeros(3))
    angles = np.linalg.norm(np.random.default_rng(0).normal(size=(400_000, 3)), axis=1) * deviation
    factor = (1.0 + 2.0 * np.cos(angles).mean()) / 3.0
    shorter = np.linalg.norm((1.0 - factor) * field)
    assert np.linalg.norm(-update.residual - factor * field) < 0.1 * shorter
