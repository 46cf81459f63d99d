"""Noise densities from readings of a sensor at rest: the Allan variance."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...checks import number, reals
from ...errors import InputError, ShapeError

#: The number of iterations in which the weights of the fit are recomputed with the fitted variance; after three it
#: changes by less than 1 %.
_FITS = 5


@dataclasses.dataclass(frozen=True)
class AllanVariance:
    """The Allan variance of readings, and the noise parameters that explain it.

    Attributes:
        taus: (k,) averaging times of the readings, s.
        deviations: (k,) roots of the variances, in the unit of the readings.
        density: density S of white noise in the readings, in their unit per $Hz^(1/2)$: the density of a `tx.Noise`.
        walk: density K of their random walk, in their unit per s per $Hz^(1/2)$: the density of the Noise that drives a
            bias.
        instability: coefficient B of flicker noise, in the unit of the readings.
        quantization: coefficient Q of quantisation noise, in their unit times s.
    """

    taus: np.ndarray
    deviations: np.ndarray
    density: float
    walk: float
    instability: float
    quantization: float

    def fitted(self) -> np.ndarray:
        """The deviations (k,) predicted at `taus` by the four fitted coefficients."""
        squares = np.array([self.density, self.walk, self.instability, self.quantization]) ** 2
        return np.sqrt(_terms(self.taus) @ squares)


def allan(readings: Any, period: Any) -> AllanVariance:
    """The overlapping Allan variance of readings at rest, and noise densities by a fit to it.

    The variance over the time tau is half the mean square of the difference of successive averages. The fit is

        $sigma^2(tau) = S^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3 + 3 Q^2 / tau^2$

    with non-negative coefficients, each variance weighted by its degrees of freedom. A coefficient for which the record
    is too short is zero or inaccurate: the random walk needs averaging times at which it exceeds the white noise, $tau
    > 3^(1/2) S / K$.

    Args:
        readings: (n,) readings of one axis, equally spaced, n of 100 or more.
        period: time between readings, s.
    Raises:
        InputError, ShapeError: readings of another shape, too few readings, or numbers that are not finite.

    Example: `tx.Noise("gyro", shape=(3,), density=tx.estimation.allan(rates, 0.01).density)`.

    Source: IEEE Std 952-1997, annex C; the overlapping estimate and its degrees of freedom for white noise are from
    Riley, Handbook of Frequency Stability Analysis, NIST SP 1065 (2008), sec. 5.2 and 5.4.
    """
    from scipy.optimize import nnls

    values = reals("readings", readings, InputError).astype(float)
    step = float(number("period", period, "a positive number of s", lambda T: 0.0 < T < np.inf))
    if values.ndim != 1 or len(values) < 100:
        raise ShapeError(f"readings expects shape (n,) with n of 100 or more, got {values.shape}")
    if not np.isfinite(values).all():
        raise InputError(
            "readings expects finite numbers, got NaN or infinite ones.\n  fix: remove them, or interpolate"
        )
    n = len(values)
    counts = np.unique(np.round(np.geomspace(1, n // 5, 60)).astype(int))
    angle = np.concatenate([[0.0], np.cumsum(values - values.mean())]) * step
    taus = counts * step
    variances = np.array([np.mean((angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]) ** 2) for m in counts])
    variances /= 2.0 * taus**2
    if not variances.any():
        return AllanVariance(taus, variances, 0.0, 0.0, 0.0, 0.0)
    freedom = np.maximum(n / counts - 1.0, 1.0)
    terms, model = _terms(taus), np.maximum(variances, variances.max() * 1e-12)
    for _ in range(_FITS):
        weights = np.sqrt(freedom) / model
        # Columns of size one: squares of densities differ by many orders of magnitude.
        rows = weights[:, None] * terms
        size = np.linalg.norm(rows, axis=0)
        squares = nnls(rows / size, weights * variances)[0] / size
        model = np.maximum(terms @ squares, model.max() * 1e-12)
    density, walk, instability, quantization = np.sqrt(squares)
    return AllanVariance(taus, np.sqrt(variances), *map(float, (density, walk, instability, quantization)))


def _terms(taus: np.ndarray) -> np.ndarray:
    """The variances of white noise, random walk, flicker noise and quantisation of coefficient one, (k, 4)."""
    flicker = np.full_like(taus, 2.0 * np.log(2.0) / np.pi)
    return np.stack([1.0 / taus, taus / 3.0, flicker, 3.0 / taus**2], axis=1)
