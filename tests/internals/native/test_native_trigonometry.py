"""Sine and cosine against 50 digits."""

from typing import Any

import mpmath
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import processors, program_of, run

from twistax.scalar.primitives.table import OPERATIONS

BOTH = [OPERATIONS["sin"], OPERATIONS["cos"]]
BAR = 2.0


def _angles(count: int) -> np.ndarray:
    """Of all sizes to 1e9, and those near multiples of pi/2, where most cancels."""
    random = np.random.default_rng(0)
    small = random.uniform(-10.0, 10.0, count)
    large = random.choice([-1.0, 1.0], count) * 10.0 ** random.uniform(-9.0, 9.0, count)
    turns = np.concatenate([np.arange(1, 40), random.integers(1, 600_000_000, count)])
    with mpmath.workdps(50):
        near = np.array([float(mpmath.pi * int(k) / 2) for k in turns])
    return np.concatenate([small, large, near, -near, np.nextafter(near, 0.0), [1e9, -1e9]])


def _worst(x: np.ndarray, found: np.ndarray, function: Any) -> float:
    """The largest error in units in the last place."""
    worst = 0.0
    with mpmath.workdps(50):
        for angle, own in zip(x, found, strict=True):
            exact = function(mpmath.mpf(float(angle)))
            unit = float(np.spacing(np.abs(own.dtype.type(exact))))
            worst = max(worst, float(abs(mpmath.mpf(float(own)) - exact)) / unit)
    return worst


def _check(count: int, dtype: Any) -> None:
    x = _angles(count).astype(dtype)
    x = x[np.abs(x) <= 1e9]
    for processor in processors():
        for own, function in zip(run(program_of(BOTH, dtype, 1), processor, x), (mpmath.sin, mpmath.cos)):
            assert own.dtype == dtype
            assert _worst(x, own, function) <= BAR, (processor, function)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_within_two_units(dtype: Any) -> None:
    _check(300, dtype)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_within_two_units_of_many(dtype: Any) -> None:
    _check(5_000, dtype)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_far_angles_do_not_touch_their_neighbours(dtype: Any) -> None:
    """Those beyond 1e9 and what is not finite are the C library's; all others stay as they are, bit by bit."""
    near = np.random.default_rng(0).uniform(-10.0, 10.0, 40).astype(dtype)
    mixed = near.copy()
    far = np.array([1.1e9, -2e15, 1e30, np.inf, -np.inf, np.nan], dtype)
    places = np.arange(1, 40, 7)
    mixed[places] = far
    for processor in processors():
        program = program_of(BOTH, dtype, 1)
        alone, beside = run(program, processor, near), run(program, processor, mixed)
        rest = np.setdiff1d(np.arange(40), places)
        for before, after, function in zip(alone, beside, (mpmath.sin, mpmath.cos)):
            np.testing.assert_array_equal(before[rest], after[rest])
            assert np.isnan(after[places[3:]]).all()
            assert _worst(far[:3], after[places[:3]], function) <= 1.0


def test_sign_of_zero() -> None:
    for processor in processors():
        sine, cosine = run(program_of(BOTH, float, 1), processor, np.array([0.0, -0.0]))
        np.testing.assert_array_equal(np.signbit(sine), [False, True])
        np.testing.assert_array_equal(cosine, [1.0, 1.0])
