"""Consistency tests of a covariance: normalised errors over independent runs against their chi-square distribution."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any

import numpy as np

from ..checks import number, reals, whole
from ..errors import InputError


class Verdict(enum.Enum):
    """The result of a consistency test of a covariance.

    CONSISTENT: the errors agree with the covariance. OPTIMISTIC: the errors are larger. PESSIMISTIC: the errors are
    smaller. UNDECIDED: the number of runs is too small.
    """

    CONSISTENT = "consistent"
    OPTIMISTIC = "optimistic"
    PESSIMISTIC = "pessimistic"
    UNDECIDED = "undecided"


@dataclasses.dataclass(frozen=True)
class Consistency:
    """The test of normalised squared errors $e^T P^-1 e$, whose mean is n for a consistent covariance.

    Attributes:
        verdict: a `Verdict`.
        level: the probability of the confidence interval and of the band.
        runs: the number of independent runs.
        ratio: the mean of the statistic divided by n; 1 for a consistent covariance.
        interval: the confidence interval of the ratio, from the spread of the means of the runs.
        mean: (k,) the mean over the runs at each time.
        band: the interval of the mean at a single time with the probability `level`: quantiles of the chi-square
            distribution with (runs n) degrees of freedom, divided by the number of runs.
        inside: the fraction of times at which the mean is in the band.
    """

    verdict: Verdict
    level: float
    runs: int
    ratio: float
    interval: tuple[float, float]
    mean: np.ndarray
    band: tuple[float, float]
    inside: float

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{self.verdict.name} at level {self.level:g} from {self.runs} run{'s' if self.runs > 1 else ''}: "
            f"mean over degrees of freedom {self.ratio:.3f}, interval [{low:.3f}, {high:.3f}]; "
            f"{100.0 * self.inside:.0f} % of times within [{self.band[0]:.2f}, {self.band[1]:.2f}]"
        )


def consistency(statistic: Any, freedom: int, *, level: float = 0.95, tolerance: float = 0.25) -> Consistency:
    """The consistency test of normalised squared errors over independent runs.

    Errors of one run are correlated over time, so each run counts as one sample: its mean over time. The ratio is the
    mean of these samples divided by the degrees of freedom, and its confidence interval follows from Student's
    distribution. If the interval is above 1, the filter is OPTIMISTIC; if it is below 1, PESSIMISTIC. If the interval
    contains 1 and is no wider than $1 +- tolerance$, the filter is CONSISTENT; otherwise, and always with a single run,
    the test is UNDECIDED.

    Args:
        statistic: (runs, k) NEES or NIS, or (k,) for one run; NaN for missing values.
        freedom: n, the dimension of the error.
        level: probability of the confidence interval and of the band.
        tolerance: the largest half width of an interval that counts as evidence.
    Raises:
        InputError: a statistic of another shape, negative values, a level outside of (0, 1).

    Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 5.4.2.
    """
    from scipy.stats import chi2, t

    values = np.atleast_2d(reals("statistic", statistic, InputError).astype(float))
    whole("freedom", freedom)
    number("level", level, "a probability between 0 and 1", lambda p: 0.0 < p < 1.0)
    number("tolerance", tolerance, "a positive number", lambda w: w > 0.0)
    if values.ndim != 2 or not values.size or (values < 0.0).any():
        raise InputError(f"statistic expects non-negative numbers of shape (runs, k), got {values.shape}")
    values = values[:, np.isfinite(values).all(axis=0)]
    if not values.size:
        raise InputError("statistic expects a time at which all runs have a finite value, got none")
    runs = len(values)
    samples = values.mean(axis=1) / freedom
    ratio, half = float(samples.mean()), np.inf
    if runs > 1:
        half = float(t.ppf(0.5 * (1.0 + level), runs - 1) * samples.std(ddof=1) / np.sqrt(runs))
    interval = (max(ratio - half, 0.0), ratio + half)
    tail = 0.5 * (1.0 - level)
    band = tuple(float(chi2.ppf(p, runs * freedom) / runs) for p in (tail, 1.0 - tail))
    mean = values.mean(axis=0)
    inside = float(np.mean((mean >= band[0]) & (mean <= band[1])))
    if runs > 1 and interval[0] > 1.0:
        verdict = Verdict.OPTIMISTIC
    elif runs > 1 and interval[1] < 1.0:
        verdict = Verdict.PESSIMISTIC
    else:
        verdict = Verdict.CONSISTENT if half <= tolerance else Verdict.UNDECIDED
    return Consistency(verdict, level, runs, ratio, interval, mean, (band[0], band[1]), inside)


def gate_limit(gate: float | None, size: int) -> float | None:
    """The quantile of chi-square of a gate."""
    if gate is None:
        return None
    from scipy.stats import chi2

    return float(chi2.ppf(gate, size))
