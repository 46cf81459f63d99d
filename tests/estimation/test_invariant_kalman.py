"""The invariant filter against GTSAM and against one in NumPy on the right, and the measure of group-affinity."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import twistax as tx
from twistax.estimation import ErrorStateKalman, Invariance, InvariantKalman, group_affinity

GRAVITY = np.array([0.0, 0.0, -9.81])
GROUP = tx.ExtendedPose((("position", "m"), ("velocity", "m/s")))  # the order of GTSAM's NavState
RNG = np.random.default_rng(5)


def hat(d: np.ndarray) -> np.ndarray:
    x, y, z = d[:3]
    matrix = np.zeros((5, 5))
    matrix[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    matrix[:3, 3:] = d[3:].reshape(2, 3).T
    return matrix


def Ad(X: np.ndarray) -> np.ndarray:
    """By the conjugates of a basis."""
    columns = [X @ hat(unit) @ np.linalg.inv(X) for unit in np.eye(9)]
    return np.stack([np.concatenate([[M[2, 1], M[0, 2], M[1, 0]], M[:3, 3:].T.ravel()]) for M in columns], axis=1)


def system(noise: float = 0.0, biases: bool = False) -> tx.System:
    X = tx.State("X", group=GROUP)
    gyro, force = tx.Control("gyro", shape=(3,)), tx.Control("force", shape=(3,))
    R, v = X[:3, :3], X[:3, 4]
    b = tx.State("b", shape=(3,))
    turn = gyro + tx.Noise("n", shape=(3,), density=noise) - (b if biases else 0.0)
    rates: dict[Any, Any] = {X: tx.Concat(turn, R.T @ v, force + R.T @ GRAVITY)}
    return tx.System(rates=rates | ({b: np.zeros(3)} if biases else {}))


POSITION = tx.Measurement("gps", tx.State("X", group=GROUP)[:3, 3], covariance=np.diag([0.1, 0.2, 0.3]))
START = np.asarray(GROUP.exp(RNG.normal(size=9)))
ROOT = 0.3 * RNG.normal(size=(9, 9))
P0 = ROOT @ ROOT.T
IMU: Any = {"gyro": np.array([0.4, -0.7, 1.1]), "force": np.array([0.3, 0.5, 9.0])}
Z = np.array([0.7, -1.5, 0.2])


def test_a_step_with_an_imu_is_that_of_gtsam() -> None:
    """Its reset is that of the invariant error on the right; the step is so short that RK4 is exact to round-off."""
    gtsam = pytest.importorskip("gtsam")
    kalman = InvariantKalman(tx.compile(system()), [POSITION], invariance=Invariance.RIGHT, max_step=0.01)
    run = kalman.run({"gps": ([0.1], Z[None])}, {"X": START}, P0, t0=0.0, u=IMU)
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    nothing = np.zeros((3, 3))
    for set_covariance in (
        params.setGyroscopeCovariance,
        params.setAccelerometerCovariance,
        params.setIntegrationCovariance,
    ):
        set_covariance(nothing)
    state = gtsam.NavState(gtsam.Rot3(START[:3, :3]), START[:3, 3], START[:3, 4])
    peer = gtsam.NavStateImuEKF(state, P0, params)
    peer.predict(IMU["gyro"], IMU["force"], 0.1)
    np.testing.assert_allclose(run.prior_xs["X"][-1, :3, 3], peer.state().position(), atol=1e-9)
    np.testing.assert_allclose(run.prior_P[-1], peer.covariance(), atol=1e-9)
    H = np.zeros((3, 9))
    H[:, 3:6] = peer.state().attitude().matrix()
    peer.updateWithVector(peer.state().position(), H, Z, np.diag([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(run.xs["X"][-1, :3, :3], peer.state().attitude().matrix(), atol=1e-9)
    # GTSAM adds the parts of the correction, v + R d_v, where an exponential of the group is x Exp(d).
    prior, d = np.asarray(run.prior_xs["X"][-1]), GROUP.difference(run.prior_xs["X"][-1], run.xs["X"][-1])
    np.testing.assert_allclose(prior[:3, 3] + prior[:3, :3] @ d[3:6], peer.state().position(), atol=1e-9)
    np.testing.assert_allclose(prior[:3, 4] + prior[:3, :3] @ d[6:], peer.state().velocity(), atol=1e-9)
    # So the covariances of the error on the right are compared, which both leave as they are.
    end = Ad(np.asarray(run.xs["X"][-1])), Ad(peer.state().matrix())
    np.testing.assert_allclose(end[0] @ run.P[-1] @ end[0].T, end[1] @ peer.covariance() @ end[1].T, atol=1e-9)


@pytest.mark.parametrize("invariance", list(Invariance))
def test_the_covariance_of_the_invariant_error_is_left_as_it_is(invariance: Invariance) -> None:
    """An update in NumPy in the tangent space of the invariant error: $P = (I - K H) P$, whatever the correction."""
    right = invariance is Invariance.RIGHT
    update = InvariantKalman(tx.compile(system()), [POSITION], invariance=invariance).update(
        "gps", 0.0, {"X": START}, P0, Z
    )
    moved = (lambda e: expm(hat(e)) @ START) if right else (lambda e: START @ expm(hat(e)))
    to_error = Ad(START) if right else np.eye(9)
    P = to_error @ P0 @ to_error.T
    step = 1e-6
    H = np.stack([(moved(step * e) - moved(-step * e))[:3, 3] / (2.0 * step) for e in np.eye(9)], axis=1)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag([0.1, 0.2, 0.3]))
    X = moved(K @ (Z - START[:3, 3]))
    P = (np.eye(9) - K @ H) @ P
    back = np.linalg.inv(Ad(X)) if right else np.eye(9)
    np.testing.assert_allclose(update.x["X"], X, atol=1e-8)
    np.testing.assert_allclose(update.P, back @ P @ back.T, atol=1e-8)


def test_the_transition_of_errors_is_that_of_every_state() -> None:
    """What group-affine means: errors, however large, move alike about all estimates."""
    dynamics = tx.compile(system())
    kalman = ErrorStateKalman(dynamics, [POSITION])
    other = np.asarray(GROUP.exp(RNG.normal(size=9)))
    transitions = [kalman.predict(0.0, {"X": X}, P0, 0.01, IMU).transition for X in (START, other)]
    np.testing.assert_allclose(transitions[0], transitions[1], atol=1e-10)
    assert group_affinity(dynamics).affine


def test_states_that_break_it_are_named() -> None:
    affinity = InvariantKalman(tx.compile(system(biases=True)), [POSITION]).affinity()
    assert not affinity.affine
    assert affinity.fixed == ("b",)
    assert "not group-affine" in str(affinity)
    assert "with b constant the rest is group-affine" in str(affinity)


def test_linear_systems_are_group_affine_and_squares_are_not() -> None:
    x = tx.State("x", shape=(2,))
    assert group_affinity(tx.compile(tx.System(rates={x: np.ones((2, 2)) @ x + 1.0}))).affine
    square = group_affinity(tx.compile(tx.System(rates={x: x**2})))
    assert not square.affine
    assert square.fixed is None


@pytest.mark.usefixtures("unchecked")
def test_an_invariance_is_one_of_two() -> None:
    with pytest.raises(tx.ModelError, match="Invariance"):
        InvariantKalman(tx.compile(system()), [POSITION], invariance="up")  # type: ignore[arg-type]
