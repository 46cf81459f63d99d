"""The Allan variance of simulated readings, and by its definition."""

import numpy as np
import pytest

import twistax as tx
from twistax.estimation import AllanVariance, allan

PERIOD = 0.01


def test_the_variance_is_that_of_its_definition() -> None:
    """By loops over averages, at some times."""
    values = np.random.default_rng(0).normal(size=300).cumsum()
    result = allan(values, PERIOD)
    for k in (0, 3, len(result.taus) - 1):
        m = round(result.taus[k] / PERIOD)
        means = np.array([values[i : i + m].mean() for i in range(300 - m + 1)])
        squares = [(means[i + m] - means[i]) ** 2 for i in range(300 - 2 * m + 1)]
        np.testing.assert_allclose(result.deviations[k], np.sqrt(0.5 * np.mean(squares)), rtol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_densities_of_a_simulated_gyroscope(seed: int) -> None:
    """White noise and a random walk of half an hour; 3 % and 30 % are three deviations of ten such records."""
    rng, n, density, walk = np.random.default_rng(seed), 200_000, 2e-3, 5e-4
    values = density / np.sqrt(PERIOD) * rng.normal(size=n) + walk * np.sqrt(PERIOD) * rng.normal(size=n).cumsum()
    result = allan(values + 0.3, PERIOD)
    assert abs(result.density / density - 1.0) < 0.03
    assert abs(result.walk / walk - 1.0) < 0.3
    assert result.quantization < 0.1 * density * np.sqrt(PERIOD)
    near = result.taus < 10.0
    np.testing.assert_allclose(result.fitted()[near], result.deviations[near], rtol=0.1)


def test_deviations_of_each_noise() -> None:
    """The lines of IEEE Std 952, annex C."""
    taus = np.array([0.1, 1.0, 10.0])
    lines = {
        "density": 0.7 / np.sqrt(taus),
        "walk": 0.7 * np.sqrt(taus / 3.0),
        "instability": np.full(3, 0.7 * np.sqrt(2.0 * np.log(2.0) / np.pi)),
        "quantization": 0.7 * np.sqrt(3.0) / taus,
    }
    for name, line in lines.items():
        numbers = {**dict.fromkeys(lines, 0.0), name: 0.7}
        np.testing.assert_allclose(AllanVariance(taus, taus, **numbers).fitted(), line, rtol=1e-12)


def test_rounded_readings_are_quantised() -> None:
    """Angles rounded to q, differenced to rates: $Q = q / 12^(1/2)$."""
    rng, q = np.random.default_rng(3), 1e-3
    angle = np.round((1.0 * PERIOD * np.arange(100_001) + 1e-3 * rng.normal(size=100_001).cumsum()) / q) * q
    result = allan(np.diff(angle) / PERIOD, PERIOD)
    assert abs(result.quantization / (q / np.sqrt(12.0)) - 1.0) < 0.05


def test_readings_without_noise_have_none() -> None:
    result = allan(np.full(200, 0.7), PERIOD)
    assert result.density == result.walk == result.instability == result.quantization == 0.0


@pytest.mark.parametrize(
    ("values", "period", "error"),
    [
        (np.zeros(10), PERIOD, tx.ShapeError),
        (np.zeros((200, 2)), PERIOD, tx.ShapeError),
        (np.full(200, np.nan), PERIOD, tx.InputError),
        (np.zeros(200), -1.0, tx.InputError),
    ],
)
def test_bad_readings_are_refused(values: np.ndarray, period: float, error: type[Exception]) -> None:
    with pytest.raises(error):
        allan(values, period)
