"""The exponential and what is made of it, against 50 digits."""

from typing import Any

import mpmath
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import processors, program_of, run

from twistax.scalar.primitives.table import OPERATIONS

NAMES = ("exp", "expm1", "tanh", "logistic")


def _exact(name: str, x: mpmath.mpf) -> mpmath.mpf:
    return 1 / (1 + mpmath.exp(-x)) if name == "logistic" else getattr(mpmath, name)(x)


def _numbers(dtype: Any) -> np.ndarray:
    """Of all sizes, near multiples of log 2 and of its half, and where the formulas change."""
    random = np.random.default_rng(0)
    signs = random.choice([-1.0, 1.0], 200)
    sizes = signs * 10.0 ** random.uniform(-12.0, 1.9, 200)
    turns = np.log(2.0) / 2 * np.arange(-130, 130, 7)
    edges = np.array([0.55, 0.27, 20.0, 30.0, 37.0, 43.0, 88.0, 87.0, -87.0])
    return np.concatenate([sizes, turns, edges, -edges, np.nextafter(turns, 100.0)]).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", NAMES)
def test_within_two_units(name: str, dtype: Any) -> None:
    x, least = _numbers(dtype), float(np.finfo(dtype).tiny)
    x = x[np.abs(x) < 85] if dtype == np.float32 else np.concatenate([x, [700.0, -700.0, 709.7, -708.3]])
    for processor in processors():
        (own,) = run(program_of([OPERATIONS[name]], dtype, 1), processor, x)
        assert own.dtype == dtype
        with mpmath.workdps(50):
            for number, value in zip(x, own, strict=True):
                exact = _exact(name, mpmath.mpf(float(number)))
                if least < abs(exact) < np.finfo(dtype).max:
                    unit = float(np.spacing(np.abs(dtype(exact))))
                    assert abs(mpmath.mpf(float(value)) - exact) <= 2 * unit, (processor, number)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_ends_and_signs(dtype: Any) -> None:
    x = np.array([np.inf, -np.inf, np.nan, 0.0, -0.0, 1e5, -1e5, 5e-324, -1e-310], dtype)
    expected = {
        "exp": [np.inf, 0.0, np.nan, 1.0, 1.0, np.inf, 0.0, 1.0, 1.0],
        "expm1": [np.inf, -1.0, np.nan, 0.0, -0.0, np.inf, -1.0, x[7], x[8]],
        "tanh": [1.0, -1.0, np.nan, 0.0, -0.0, 1.0, -1.0, x[7], x[8]],
        "logistic": [1.0, 0.0, np.nan, 0.5, 0.5, 1.0, 0.0, 0.5, 0.5],
    }
    for processor in processors():
        for name, values in expected.items():
            (own,) = run(program_of([OPERATIONS[name]], dtype, 1), processor, x)
            np.testing.assert_array_equal(own, np.array(values, dtype), f"{name} {processor}")
            np.testing.assert_array_equal(np.signbit(own[[3, 4]]), np.signbit(np.array(values)[[3, 4]]))


def test_subnormal_results() -> None:
    x = np.array([-709.0, -720.0, -740.0, -745.0])
    for processor in processors():
        (own,) = run(program_of([OPERATIONS["exp"]], np.float64, 1), processor, x)
        with mpmath.workdps(50):
            exact = [float(mpmath.exp(mpmath.mpf(float(v)))) for v in x]
        np.testing.assert_allclose(own, exact, rtol=0, atol=2 * 5e-324)
