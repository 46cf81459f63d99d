"""Preintegrated readings against an integration at tolerances of 1e-13, bias Jacobians against differences."""

from typing import Any

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import twistax as tx
from twistax.estimation import InertialState, PreintegratedImu, Preintegration

RNG = np.random.default_rng(2)
COUNT, STEP = 12, 0.05
GYRO = np.array([0.4, -0.7, 1.1]) + 0.5 * RNG.normal(size=(COUNT, 3))
FORCE = np.array([0.3, 0.5, 9.0]) + RNG.normal(size=(COUNT, 3))
BIAS = np.array([0.01, -0.02, 0.015, 0.1, 0.05, -0.2])
GRAVITY = np.array([0.0, 0.0, -9.81])
IMU = Preintegration(np.array([0.01, 0.02, 0.03]), 0.1)


def hat(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def integrated(start: InertialState, gravity: np.ndarray, bias: np.ndarray) -> InertialState:
    """By DOP853, restarted at each reading."""
    y = np.concatenate([np.ravel(start.rotation), start.velocity, start.position])
    for w, a in zip(GYRO - bias[:3], FORCE - bias[3:]):

        def rate(_: float, y: np.ndarray, w: np.ndarray = w, a: np.ndarray = a) -> np.ndarray:
            R = y[:9].reshape(3, 3)
            return np.concatenate([(R @ hat(w)).ravel(), R @ a + gravity, y[9:12]])

        y = solve_ivp(rate, (0.0, STEP), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return InertialState(y[:9].reshape(3, 3), y[9:12], y[12:])


START = InertialState(expm(hat(np.array([0.5, 0.2, -0.8]))), np.array([3.0, -1.0, 2.0]), np.array([10.0, 20.0, -5.0]))


def test_the_motion_is_that_of_an_integration() -> None:
    relative = IMU.integrate(GYRO, FORCE, STEP, BIAS)
    at_rest = InertialState(np.eye(3), np.zeros(3), np.zeros(3))
    exact = integrated(at_rest, np.zeros(3), BIAS)
    for name in ("rotation", "velocity", "position"):
        np.testing.assert_allclose(getattr(relative, name), getattr(exact, name), atol=1e-11)
    end = integrated(START, GRAVITY, BIAS)
    for one, other in zip(relative.predict(START, GRAVITY), end, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
    np.testing.assert_allclose(relative.residual(START, end, GRAVITY), np.zeros(9), atol=1e-10)
    np.testing.assert_allclose(relative.duration, COUNT * STEP)


def difference(one: PreintegratedImu, other: PreintegratedImu) -> np.ndarray:
    turn = tx.lie.so3.log(one.rotation.T @ other.rotation)
    return np.concatenate([turn, other.velocity - one.velocity, other.position - one.position])


def test_bias_jacobians_are_those_of_differences() -> None:
    relative, step = IMU.integrate(GYRO, FORCE, STEP, BIAS), 1e-5
    columns = []
    for unit in np.eye(6):
        ahead, behind = (IMU.integrate(GYRO, FORCE, STEP, BIAS + s * unit) for s in (step, -step))
        columns.append((difference(relative, ahead) - difference(relative, behind)) / (2.0 * step))
    np.testing.assert_allclose(relative.jacobian, np.stack(columns, axis=1), atol=1e-8)
    change = 1e-4 * np.array([1.0, -2.0, 0.5, 3.0, 1.0, -1.0])
    anew, moved = IMU.integrate(GYRO, FORCE, STEP, BIAS + change), relative.corrected(BIAS + change)
    np.testing.assert_allclose(moved.rotation, anew.rotation, atol=1e-6)
    np.testing.assert_allclose(moved.position, anew.position, atol=1e-6)


def test_the_covariance_is_that_of_perturbed_readings() -> None:
    """The sum over readings of (derivative by the reading) W / h (its transpose), the derivatives by differences."""
    relative, step = IMU.integrate(GYRO, FORCE, STEP), 1e-5
    intensities = np.array([0.01, 0.02, 0.03, 0.1, 0.1, 0.1]) ** 2 / STEP
    total = np.zeros((9, 9))
    integrate = jax.jit(lambda readings: IMU.integrate(readings[:, :3], readings[:, 3:], STEP))
    readings = np.concatenate([GYRO, FORCE], axis=1)
    for k in range(COUNT):
        for j in range(6):
            moved = np.zeros((COUNT, 6))
            moved[k, j] = step
            ahead, behind = (difference(relative, integrate(readings + s * moved)) for s in (1.0, -1.0))
            column = (ahead - behind) / (2.0 * step)
            total += intensities[j] * np.outer(column, column)
    np.testing.assert_allclose(relative.covariance, total, atol=1e-9)


def test_batches_and_single_precision() -> None:
    stacked = jax.vmap(lambda w, a: IMU.integrate(w, a, STEP))(np.stack([GYRO, 2.0 * GYRO]), np.stack([FORCE, FORCE]))
    np.testing.assert_allclose(stacked.position[0], IMU.integrate(GYRO, FORCE, STEP).position, atol=1e-12)
    single = IMU.integrate(GYRO.astype(np.float32), FORCE.astype(np.float32), STEP)
    assert {leaf.dtype for leaf in jax.tree.leaves(single)} == {np.dtype("float32")}
    assert Preintegration(0.0, 0.0).integrate([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], [2.0]).position[2] == 2.0


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: Preintegration(-1.0, 0.0), tx.ModelError, "gyro"),
        (lambda: Preintegration(0.0, np.ones(2)), tx.ModelError, "accelerometer"),
        (lambda: IMU.integrate(GYRO[0], FORCE, STEP), tx.ShapeError, r"\(k, 3\)"),
        (lambda: IMU.integrate(GYRO, FORCE[:3], STEP), tx.ShapeError, "accelerometer"),
        (lambda: IMU.integrate(GYRO, FORCE, np.ones(3)), tx.ShapeError, "h expects"),
        (lambda: IMU.integrate(GYRO, FORCE, STEP, np.ones(3)), tx.ShapeError, "bias"),
        (lambda: IMU.integrate(GYRO, FORCE, -STEP), tx.InputError, "h expects positive numbers of s, got -"),
        (lambda: IMU.integrate(GYRO, FORCE * np.nan, STEP), tx.InputError, "accelerometer expects finite numbers"),
    ],
)
def test_bad_arguments_are_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()
