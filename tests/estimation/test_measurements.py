"""Noise and measurements as parts of the language: their shapes, covariances and errors."""

import pickle
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.estimation import ErrorStateKalman

g, v = tx.State("g", group=tx.SE3), tx.State("v", shape=(6,))
w = tx.Noise("w", shape=(6,), density=0.1)
SYSTEM = tx.System(rates={g: v, v: w})
DYNAMICS = tx.compile(SYSTEM)


def test_noise_is_zero_in_a_compiled_system() -> None:
    rates = DYNAMICS(0.0, {"g": np.eye(4), "v": np.ones(6)})
    np.testing.assert_array_equal(rates["v"], np.zeros(6))
    assert SYSTEM.noises == (w,)
    assert [noise.name for noise in pickle.loads(pickle.dumps(SYSTEM)).noises] == ["w"]


def test_noise_has_a_name_of_its_own() -> None:
    with pytest.raises(tx.ModelError, match="two leaves are named 'v'"):
        tx.System(rates={v: tx.Noise("v", shape=(6,), density=1.0)})


@pytest.mark.parametrize(
    ("density", "error", "message"),
    [
        (-1.0, tx.ModelError, "not negative"),
        (np.nan, tx.ModelError, "finite"),
        (np.ones(2), tx.ShapeError, r"expects a number, shape \(3,\) or \(3, 3\), got \(2,\)"),
        (v[:3], tx.ModelError, "numbers or parameters"),
    ],
)
def test_a_density_is_checked(density: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        tx.Noise("w", shape=(3,), density=density)


def test_a_measurement_has_the_group_of_its_value() -> None:
    assert tx.Measurement("star", g[:3, :3], covariance=1e-6).group is tx.SO3
    assert tx.Measurement("pose", g, covariance=1e-6).group is g.group
    assert tx.Measurement("gps", g[:3, 3], covariance=1.0).group == tx.Euclidean((3,))


def test_values_of_a_group_are_checked() -> None:
    """A matrix of zeros is no pose, and one of NaN is a missing measurement."""
    kalman = ErrorStateKalman(DYNAMICS, [tx.Measurement("pose", g, covariance=1e-6)])
    x = {"g": np.eye(4), "v": np.zeros(6)}
    with pytest.raises(tx.InputError, match=r"update: 'pose' expects elements of SE3"):
        kalman.update("pose", 0.0, x, 1.0, 2.0 * np.eye(4))
    with pytest.raises(tx.InputError, match=r"records\['pose'\] expects elements of SE3"):
        kalman.run({"pose": ([0.0, 1.0], np.stack([np.eye(4), np.zeros((4, 4))]))}, x, 1.0)
    np.testing.assert_array_equal(kalman.update("pose", 0.0, x, 1.0, np.full((4, 4), np.nan)).P, np.eye(12))


def test_a_prediction_goes_forward() -> None:
    with pytest.raises(tx.InputError, match="h must be a finite number of s that is not negative, got -1"):
        ErrorStateKalman(DYNAMICS, []).predict(0.0, {"g": np.eye(4), "v": np.zeros(6)}, 1.0, -1.0)


def test_units_of_noise_and_measurements_are_checked() -> None:
    """A position in m has a rate in m/s and a covariance in m2."""
    q, T = tx.State("q", unit="m"), tx.State("T", unit="s")
    with pytest.raises(tx.KindError, match="one unit, got m and s"):
        tx.Measurement("y", q + T, covariance=1.0)
    for covariance in (4.0 * tx.units.metres, tx.Parameter("R", unit="m")):
        with pytest.raises(
            tx.KindError, match="covariance expects the unit m2, the square of that of the value, got m"
        ):
            tx.Measurement("y", q, covariance=covariance)
    with pytest.raises(tx.KindError, match="m/s"):
        tx.System(rates={q: tx.Noise("w", density=1.0, unit="m")})
    cart = tx.compile(tx.System(rates={q: tx.Noise("w", density=1.0, unit="m/s")}))
    noisy = q + tx.Noise("n", density=1.0, unit="m")
    kalman = ErrorStateKalman(cart, [tx.Measurement("y", noisy, covariance=4.0 * tx.units.metres**2, period=0.5)])
    np.testing.assert_allclose(kalman.update("y", 0.0, {"q": 0.0}, 1.0, 0.0).S, [[7.0]], rtol=1e-14)


INDEFINITE = np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({}, tx.ModelError, "pass covariance=..., or use a tx.Noise"),
        ({"covariance": 0.0}, tx.ModelError, "positive definite"),
        ({"covariance": INDEFINITE}, tx.ModelError, "positive definite"),
        ({"covariance": tx.Parameter("R", value=INDEFINITE)}, tx.ModelError, "positive definite"),
        ({"covariance": np.eye(3) + np.eye(3, k=1)}, tx.ModelError, "symmetric"),
        ({"covariance": np.ones(2)}, tx.ShapeError, r"got \(2,\)"),
        ({"covariance": 1.0, "period": -1.0}, tx.ModelError, "period"),
        ({"covariance": 1.0, "group": tx.SO3}, tx.ShapeError, "SO3"),
    ],
)
def test_a_covariance_is_checked(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        tx.Measurement("gps", g[:3, 3], **options)


def test_units_apart_by_magnitudes_are_definite() -> None:
    """Entries in rad^2 and in Pa^2: the least eigenvalue is far below the round-off of the largest."""
    tx.Measurement("both", g[:2, 3], covariance=np.diag([1e-20, 1e10]))


def test_noise_in_a_measurement_needs_a_period() -> None:
    noisy = g[:3, 3] + tx.Noise("n", shape=(3,), density=0.5)
    with pytest.raises(tx.ModelError, match=r"period=\.\.\., in s"):
        tx.Measurement("gps", noisy)
    sampled = ErrorStateKalman(DYNAMICS, [tx.Measurement("gps", noisy, period=0.25)])
    direct = ErrorStateKalman(DYNAMICS, [tx.Measurement("gps", g[:3, 3], covariance=1.0)])
    arguments: Any = ("gps", 0.0, {"g": np.eye(4), "v": np.ones(6)}, np.eye(12), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(sampled.update(*arguments).S, direct.update(*arguments).S, rtol=1e-14)


@pytest.mark.parametrize(
    ("measurements", "message"),
    [
        ([tx.Measurement("a", g[:3, 3], covariance=1.0)] * 2 + [tx.Measurement("a", v, covariance=1.0)], "two meas"),
        ([tx.Measurement("a", tx.State("y"), covariance=1.0)], "reads the state 'y'; the system has: 'g', 'v'"),
        ([tx.Measurement("a", tx.Control("y"), covariance=1.0)], "reads the control 'y'"),
        ([tx.Measurement("a", v + w, covariance=1.0, period=1.0)], "in rates and in a measurement"),
        ([3], r"expects tx\.Measurement"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_measurements_fit_the_system(measurements: list[Any], message: str) -> None:
    with pytest.raises(tx.ModelError, match=message):
        ErrorStateKalman(DYNAMICS, measurements)
