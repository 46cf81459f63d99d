"""Periodic motions of joints as Fourier series: as numbers, and as expressions of time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import number, reals
from ...errors import InputError


def fourier_motion(coefficients: Any, period: float, times: Any) -> dict[str, NDArray[Any]]:
    """Positions, velocities and accelerations of joints that follow Fourier series.

    With the coefficients $[c, a_1 .. a_N, b_1 .. b_N]$ of a joint and $w = 2 pi / period$, its position is

        $q(t) = c + sum_k a_k sin(k w t) / (k w) - b_k cos(k w t) / (k w)$.

    Source: J. Swevers, C. Ganseman, D. Tukel, J. De Schutter, H. Van Brussel, Optimal Robot Excitation and
    Identification, IEEE Transactions on Robotics and Automation 13 (1997), equation (3).

    Args:
        coefficients: (n, 2 N + 1): the first in rad or m, the others in rad/s or m/s.
        period: the period, s, positive.
        times: (count,), s.
    Returns: "q", "qd" and "qdd", each (count, n): the records for `identify` except the forces.
    Raises: InputError for arrays of the wrong shape, or entries that are not finite.

    Example: `fourier_motion(result.params["coefficients"], 10.0, np.arange(0.0, 10.0, 0.01))`
    """
    rows = reals("fourier_motion: coefficients", coefficients, InputError).astype(np.float64)
    if rows.ndim != 2 or rows.shape[1] % 2 == 0 or not np.isfinite(rows).all():
        raise InputError(f"fourier_motion expects finite coefficients of shape (n, 2 N + 1), got {rows.shape}")
    number("fourier_motion: period", period, "a positive number", lambda x: 0.0 < x < np.inf)
    t = reals("fourier_motion: times", times, InputError).astype(np.float64)
    if t.ndim != 1 or not np.isfinite(t).all():
        raise InputError(f"fourier_motion expects finite times of shape (count,), got {t.shape}")
    w = frequencies(period, rows.shape[1] // 2)
    ones = np.ones((len(t), 1))
    parts = fourier_rows(w, np.sin(t[:, None] * w), np.cos(t[:, None] * w), ones, lambda *x: np.concatenate(x, axis=1))
    return {name: np.asarray(part @ rows.T) for name, part in zip(("q", "qd", "qdd"), parts, strict=True)}


def frequencies(period: float, harmonics: int) -> NDArray[np.float64]:
    """The angular frequencies k w of a series, (N,), rad/s."""
    return np.asarray(2.0 * np.pi / period * np.arange(1, harmonics + 1), np.float64)


def fourier_rows(w: Any, sine: Any, cosine: Any, one: Any, joined: Callable[..., Any]) -> tuple[Any, Any, Any]:
    """The factors of the coefficients in the position, the velocity and the acceleration.

    Args:
        w: the result of `frequencies`.
        sine, cosine: sine and cosine of $w t$.
        one: the constant function.
        joined: concatenates the parts of a row.
    """
    return (
        joined(one, sine / w, -cosine / w),
        joined(0.0 * one, cosine, sine),
        joined(0.0 * one, -(sine * w), cosine * w),
    )
