"""The smoother against one least-squares problem over all states, in NumPy."""

import numpy as np
import pytest
from scipy.linalg import expm

import twistax as tx
from compilations import compilations
from twistax.estimation import ErrorStateKalman

TIMES = np.array([0.2, 0.5, 0.6, 1.1])


def test_the_linear_case_is_the_least_squares_estimate() -> None:
    """A double integrator: the mode of the joint density of all states, and blocks of the inverse of its Hessian."""
    x = tx.State("x", shape=(2,))
    dynamics = tx.compile(tx.System(rates={x: tx.Concat(x[1], tx.Noise("w", density=0.7))}))
    values = np.array([0.3, -0.2, 0.9, 0.4])
    kalman = ErrorStateKalman(dynamics, [tx.Measurement("y", x[0], covariance=0.09)])
    smoothed = kalman.run({"y": (TIMES, values)}, {"x": np.zeros(2)}, [2.0, 0.5], t0=0.0).smooth()

    times = np.concatenate([[0.0], TIMES])
    n = 2 * len(times)
    hessian, gradient = np.zeros((n, n)), np.zeros(n)
    hessian[:2, :2] += np.diag([0.5, 2.0])
    for k, h in enumerate(np.diff(times)):
        F, Q = np.array([[1.0, h], [0.0, 1.0]]), 0.49 * np.array([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]])
        row = np.zeros((2, n))
        row[:, 2 * k : 2 * k + 2], row[:, 2 * k + 2 : 2 * k + 4] = -F, np.eye(2)
        hessian += row.T @ np.linalg.solve(Q, row)
        hessian[2 * k + 2, 2 * k + 2] += 1.0 / 0.09
        gradient[2 * k + 2] += values[k] / 0.09
    covariance = np.linalg.inv(hessian)
    np.testing.assert_allclose(smoothed.xs["x"].ravel(), covariance @ gradient, atol=1e-12)
    blocks = [covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(times))]
    np.testing.assert_allclose(smoothed.P, blocks, atol=1e-12)


def hat(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def test_a_constant_rotation_is_the_same_at_all_times() -> None:
    """Without noise the smoothed rotations are the last estimate, and so are their covariances."""
    q, n = tx.State("q", group=tx.SO3), tx.State("n")
    dynamics = tx.compile(tx.System(rates={q: np.zeros(3), n: tx.Noise("w", density=0.1)}))
    kalman = ErrorStateKalman(dynamics, [tx.Measurement("star", q, covariance=0.2)])
    values = np.stack([expm(hat(np.array(w))) for w in ([0.3, 0.1, -0.4], [0.9, 0.0, 0.2], [0.1, 0.8, -0.3])])
    run = kalman.run({"star": (TIMES[:3], values)}, {"q": np.eye(3), "n": 0.0}, [0.5, 0.4, 0.3, 0.0], t0=0.0)
    smoothed = run.smooth()
    np.testing.assert_allclose(smoothed.xs["q"], np.broadcast_to(smoothed.xs["q"][-1], (4, 3, 3)), atol=1e-12)
    # J_r(d) J_r(e)^-1 is the identity only where d = e, so the covariances agree exactly too.
    np.testing.assert_allclose(smoothed.P[:, :3, :3], np.broadcast_to(run.P[-1, :3, :3], (4, 3, 3)), atol=1e-12)
    assert np.isfinite(smoothed.P).all()
    with compilations() as compiled:
        run.smooth()
    assert not compiled


@pytest.mark.parametrize("seed", range(2))
def test_smoothing_never_raises_a_variance_of_a_linear_system(seed: int) -> None:
    x = tx.State("x", shape=(2,))
    dynamics = tx.compile(tx.System(rates={x: tx.Concat(x[1], tx.Noise("w", density=0.7) - x[0])}))
    kalman = ErrorStateKalman(dynamics, [tx.Measurement("y", x[0], covariance=0.09)])
    values = np.random.default_rng(seed).normal(size=4)
    run = kalman.run({"y": (TIMES, values)}, {"x": np.zeros(2)}, 1.0, t0=0.0)
    assert (np.linalg.eigvalsh(run.P - run.smooth().P) > -1e-12).all()
