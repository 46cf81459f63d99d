"""Preintegrated readings as the process of filters and smoothers, against graphs of GTSAM and integrated rates."""

from typing import Any

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag, expm

import twistax as tx
from twistax.estimation import (
    BatchSmoother,
    ErrorStateKalman,
    FixedLagSmoother,
    HuberLoss,
    PreintegratedNavigation,
    Preintegration,
)

GYRO, FORCE, GYRO_WALK, FORCE_WALK = 2e-3, 2e-2, 1e-3, 1e-2
IMU = Preintegration(GYRO, FORCE, gyro_walk=GYRO_WALK, accelerometer_walk=FORCE_WALK)
NAVIGATION = PreintegratedNavigation(IMU, [0.0, 0.0, -9.81])
GPS = tx.Measurement("gps", NAVIGATION.position, covariance=0.01)
STAR = tx.Measurement("star", NAVIGATION.rotation, covariance=1e-4)
INTERVALS, PER_INTERVAL, STEP = 4, 4, 0.05
KEYFRAMES = STEP * PER_INTERVAL * np.arange(INTERVALS + 1)


def hat(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


START: dict[str, Any] = {
    "rotation": expm(hat(np.array([0.3, -0.2, 0.5]))),
    "velocity": np.array([1.0, 0.0, 0.0]),
    "position": np.zeros(3),
    "gyro_bias": np.array([0.01, -0.02, 0.005]),
    "accelerometer_bias": np.array([0.1, -0.05, 0.02]),
}
P0 = np.repeat([1e-4, 0.1, 0.1, 1e-6, 1e-4], 3)


def flight(seed: int) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Readings of both sensors, and records of GPS, with an outlier, and of a star tracker."""
    rng, ts = np.random.default_rng(seed), STEP * np.arange(INTERVALS * PER_INTERVAL)
    rates = 0.5 * np.stack([np.sin(3.0 * ts), np.cos(2.0 * ts), np.ones_like(ts)], axis=1)
    forces = np.stack([np.sin(ts), np.cos(ts), np.full_like(ts, 9.81)], axis=1)
    rates, forces = rates + 0.01 * rng.normal(size=rates.shape), forces + 0.1 * rng.normal(size=rates.shape)
    positions = np.outer(KEYFRAMES, [1.0, 0.0, 0.0]) + 0.1 * rng.normal(size=(INTERVALS + 1, 3))
    positions[2] += 2.0
    star = START["rotation"] @ expm(hat(0.02 * rng.normal(size=3)))
    return rates, forces, {"gps": (KEYFRAMES, positions), "star": (KEYFRAMES[:1], star[None])}


def readings(rates: Any, forces: Any, pieces: int = 1) -> dict[str, Any]:
    """The readings as tables, each of them in equal pieces."""
    ts = STEP / pieces * np.arange(pieces * len(rates))
    tables = {"gyro": rates, "accelerometer": forces}
    return {name: tx.ZeroOrderHold(ts, jax.numpy.repeat(rows, pieces, axis=0)) for name, rows in tables.items()}


def by_gtsam(gtsam: Any, seed: int, pieces: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The optimum of the factor graph, and the covariance of the last position, from readings in equal pieces."""
    rates, forces, records = flight(seed)
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    params.setGyroscopeCovariance(GYRO**2 * np.eye(3))
    params.setAccelerometerCovariance(FORCE**2 * np.eye(3))
    params.setIntegrationCovariance(1e-20 * np.eye(3))
    params.setBiasOmegaCovariance(GYRO_WALK**2 * np.eye(3))
    params.setBiasAccCovariance(FORCE_WALK**2 * np.eye(3))
    bias = gtsam.imuBias.ConstantBias(START["accelerometer_bias"], START["gyro_bias"])
    pose = gtsam.Pose3(gtsam.Rot3(START["rotation"]), START["position"])
    poses, velocities, biases = ([gtsam.symbol(c, k) for k in range(INTERVALS + 1)] for c in "xvb")
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    same, diagonal = gtsam.noiseModel.Isotropic.Variance, gtsam.noiseModel.Diagonal.Variances
    graph.add(gtsam.PriorFactorPose3(poses[0], pose, diagonal(np.repeat([1e-4, 0.1], 3))))
    graph.add(gtsam.PriorFactorVector(velocities[0], START["velocity"], same(3, 0.1)))
    graph.add(gtsam.PriorFactorConstantBias(biases[0], bias, diagonal(np.repeat([1e-4, 1e-6], 3))))
    star = gtsam.Rot3(records["star"][1][0])
    graph.add(gtsam.PoseRotationPrior3D(poses[0], gtsam.Pose3(star, np.zeros(3)), same(3, 1e-4)))
    for k in range(INTERVALS):
        relative = gtsam.PreintegratedCombinedMeasurements(params, bias)
        for i in range(k * PER_INTERVAL, (k + 1) * PER_INTERVAL):
            for _ in range(pieces):
                relative.integrateMeasurement(forces[i], rates[i], STEP / pieces)
        ends = poses[k], velocities[k], poses[k + 1], velocities[k + 1], biases[k], biases[k + 1]
        graph.add(gtsam.CombinedImuFactor(*ends, relative))
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.5), same(3, 0.01))
    for k, position in enumerate(records["gps"][1]):
        graph.add(gtsam.GPSFactor(poses[k], position, robust))
        values.insert(poses[k], pose)
        values.insert(velocities[k], START["velocity"])
        values.insert(biases[k], bias)
    options = gtsam.LevenbergMarquardtParams()
    options.setRelativeErrorTol(1e-15)
    options.setAbsoluteErrorTol(1e-15)
    options.setMaxIterations(200)
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values, options).optimize()
    for _ in range(20):
        optimum = gtsam.GaussNewtonOptimizer(graph, optimum).optimize()
    states = {
        "rotation": np.stack([optimum.atPose3(key).rotation().matrix() for key in poses]),
        "velocity": np.stack([optimum.atVector(key) for key in velocities]),
        "position": np.stack([optimum.atPose3(key).translation() for key in poses]),
        "gyro_bias": np.stack([optimum.atConstantBias(key).gyroscope() for key in biases]),
        "accelerometer_bias": np.stack([optimum.atConstantBias(key).accelerometer() for key in biases]),
    }
    R = states["rotation"][-1]
    return states, R @ gtsam.Marginals(graph, optimum).marginalCovariance(poses[-1])[3:, 3:] @ R.T


def test_the_optimum_is_that_of_a_factor_graph_of_gtsam() -> None:
    """GTSAM has one step of Euler's method for each piece of a reading: its optimum is extrapolated to no length."""
    gtsam = pytest.importorskip("gtsam")
    smoother = BatchSmoother(NAVIGATION, [GPS, STAR], losses={"gps": HuberLoss(1.5)}, tolerance=1e-10)
    guess = {name: np.broadcast_to(x, (INTERVALS + 1, *np.shape(x))) for name, x in START.items()}

    def run(rates: Any, forces: Any, positions: Any, star: Any) -> Any:
        records = {"gps": (KEYFRAMES, positions), "star": (KEYFRAMES[:1], star)}
        return smoother.run(records, START, P0, u=readings(rates, forces, 32), guess=guess)

    flights = [(rates, forces, records["gps"][1], records["star"][1]) for rates, forces, records in map(flight, (0, 1))]
    estimates = jax.jit(jax.vmap(run))(*(np.stack(rows) for rows in zip(*flights, strict=True)))
    assert estimates.result == "successful"
    assert (estimates.weights["gps"][:, 2] < 0.2).all()
    for seed in (0, 1):
        (coarse, _), (fine, covariance) = (by_gtsam(gtsam, seed, pieces) for pieces in (200, 400))
        for name, states in estimates.xs.items():
            exact = 2.0 * fine[name] - coarse[name]
            np.testing.assert_allclose(states[seed], exact, atol=3e-7)
        np.testing.assert_allclose(estimates.P[seed, -1, 6:9, 6:9], covariance, rtol=1e-3, atol=1e-6)


def test_filter_and_smoothers_are_those_of_integrated_rates() -> None:
    rates, forces, records = flight(2)
    u = readings(rates, forces, 4)
    one, other = (
        ErrorStateKalman(dynamics, [GPS, STAR]).run(records, START, P0, u=u)
        for dynamics in (NAVIGATION, NAVIGATION.dynamics)
    )
    np.testing.assert_array_equal(one.ts, KEYFRAMES)
    rows = np.searchsorted(np.asarray(other.ts), KEYFRAMES)
    smoothed = one.smooth()
    for a, b in ((one, other), (smoothed, other.smooth())):
        for name in START:
            np.testing.assert_allclose(a.xs[name], b.xs[name][rows], atol=1e-5)
        np.testing.assert_allclose(a.P, b.P[rows], atol=1e-5)
    lagged = one.smooth(FixedLagSmoother(INTERVALS))
    np.testing.assert_allclose(lagged.xs["velocity"], smoothed.xs["velocity"], atol=1e-12)


def test_the_joint_covariance_is_that_of_the_differential_equation() -> None:
    """Of errors [phi; dv; dp; db], with a constant rate and force."""
    rate, force, end, count = np.array([0.4, -0.7, 1.1]), np.array([1.0, 0.5, 9.0]), 0.8, 400
    densities = np.repeat([GYRO, FORCE, GYRO_WALK, FORCE_WALK], 3) ** 2

    def slope(t: float, flat: np.ndarray) -> np.ndarray:
        P, R, F, G = flat.reshape(15, 15), expm(hat(rate) * t), np.zeros((15, 15)), np.zeros((15, 12))
        F[:3, :3], F[3:6, :3], F[6:9, 3:6] = -hat(rate), -R @ hat(force), np.eye(3)
        F[:6, 9:] = G[:6, :6] = -block_diag(np.eye(3), R)
        G[9:, 6:] = np.eye(6)
        return np.asarray(F @ P + P @ F.T + G @ np.diag(densities) @ G.T).ravel()

    exact = solve_ivp(slope, (0.0, end), np.zeros(225), rtol=1e-9, atol=1e-15).y[:, -1].reshape(15, 15)
    relative = IMU.integrate(np.tile(rate, (count, 1)), np.tile(force, (count, 1)), end / count)
    scale = np.sqrt(np.diag(exact))
    np.testing.assert_allclose(
        relative.joint_covariance / np.outer(scale, scale), exact / np.outer(scale, scale), atol=2e-5
    )
    np.testing.assert_array_equal(relative.covariance, relative.joint_covariance[:9, :9])


TABLES = readings(*flight(0)[:2])


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: PreintegratedNavigation(IMU, 9.81), tx.ModelError, "gravity expects three"),
        (lambda: Preintegration(0.1, 0.1, gyro_walk=-1.0), tx.ModelError, "gyro_walk"),
        (
            lambda: ErrorStateKalman(NAVIGATION, [GPS], method=tx.RKMK(tx.tableaus.RK4)),
            tx.ModelError,
            "method expects None",
        ),
        (
            lambda: BatchSmoother(NAVIGATION, [tx.Measurement("rate", tx.Control("gyro", shape=(3,)), covariance=1.0)]),
            tx.ModelError,
            "'rate' reads the control 'gyro'",
        ),
        (lambda: ErrorStateKalman(NAVIGATION, [GPS]).to_c("unused"), tx.ModelError, "no C code"),
        (
            lambda: ErrorStateKalman(NAVIGATION, [GPS]).predict(
                0.0, START, P0, 0.1, u={"gyro": np.zeros(3), "accelerometer": np.zeros(3)}
            ),
            tx.ModelError,
            "needs the readings of a run",
        ),
        (
            lambda: BatchSmoother(NAVIGATION, [GPS]).run(
                {"gps": flight(0)[2]["gps"]}, START, P0, u={**TABLES, "gyro": np.zeros(3)}
            ),
            tx.InputError,
            "readings 'gyro' as a table",
        ),
    ],
)
def test_bad_arguments_are_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()
