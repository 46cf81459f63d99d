"""The self-test of a kernel: its results are compared once with those of NumPy before the first use."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from .kernel import Kernel
from .lanes import Array
from .machine_code import BuildError

#: Relative to the largest entry of a result. Wrong code differs by far more than rounding.
_TOLERANCE = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 1e-3}

#: Arguments are of size one. A smaller result may be rounding alone, as that of a compensated sum.
_LEAST = 1e-3

#: The platforms on which a call through JAX has passed in this process.
_CALLED: set[str] = set()


def check_kernel(kernel: Kernel) -> None:
    """Compare a kernel with NumPy on random rows; the first time on a platform in a process also through JAX.

    That it passed is stored with its code, as `kernel.handle.checked`, also for other processes.

    Raises:
        BuildError: they differ.
    """
    body = kernel.body
    random = np.random.default_rng(0)
    # A kernel that reads no arguments gives one row.
    rows = kernel.checked_rows if body.read else 1
    arguments = body.exercised([_drawn(random, (rows, math.prod(a.of_length(body.tried))), a) for a in body.arguments])
    # Both in one go: of a long program NumPy takes its time for each operation, however few the rows.
    both = body.plain([np.concatenate([a, _moved(a)]) for a in arguments])
    expected, nearby = [values[:rows] for values in both], [[values[-rows:] for values in both]]
    results = kernel.run([arguments[k] for k in body.read], body.tried)

    def agrees() -> bool:
        pairs = zip(body.written, results, strict=True)
        return all(_agree(values, expected[k], [near[k] for near in nearby]) for k, values in pairs)

    if not agrees():
        # With nearly singular constants one change of the arguments may not show rounding: each operation is rounded.
        nearby += [body.plain(arguments, functools.partial(_rounded, random)) for _ in range(4)]
        if not agrees():
            raise BuildError("its results differ from those of NumPy")
    if kernel.platform not in _CALLED:
        with jax.ensure_compile_time_eval(), jax.default_device(jax.local_devices(backend=kernel.platform)[0]):
            shapes = ((rows, *a.of_length(body.tried)) for a in body.arguments)
            shaped = [a.reshape(shape) for a, shape in zip(arguments, shapes, strict=True)]
            called = jax.jit(lambda *values: kernel(rows, *values, length=body.tried))(*shaped)
        for k, result in zip(body.written, results, strict=True):
            by_jax = np.asarray(called[k]).reshape(result.shape)
            if not np.array_equal(by_jax, result, equal_nan=result.dtype.kind == "f"):
                raise BuildError("its results differ where JAX calls it")
        _CALLED.add(kernel.platform)
    kernel.handle.keep()


def _drawn(random: np.random.Generator, size: tuple[int, int], array: Array) -> NDArray[Any]:
    drawn = random.normal(size=size) if array.dtype.kind == "f" else random.integers(0, 2, size)
    return drawn.astype(array.dtype)


def _moved(values: NDArray[Any]) -> NDArray[Any]:
    """The next larger floating-point numbers: the change of the results shows the effect of rounding."""
    return np.nextafter(values, np.inf, dtype=values.dtype) if values.dtype.kind == "f" else values


def _rounded(random: np.random.Generator, values: NDArray[Any]) -> NDArray[Any]:
    """The next larger or smaller floating-point numbers, at random."""
    if values.dtype.kind != "f":
        return values
    return np.nextafter(values, random.choice([-np.inf, np.inf], values.shape), dtype=values.dtype)


def _agree(values: NDArray[Any], expected: NDArray[Any], nearby: Sequence[NDArray[Any]]) -> bool:
    if values.dtype.kind != "f":
        # A comparison of nearly equal numbers may fall either way, and one of equal numbers in all rows.
        either = np.any([near != expected for near in nearby], axis=0)
        return bool(np.mean((values == expected) | either) >= 0.5)
    finite = np.isfinite(expected) & np.all(np.isfinite(nearby), axis=0)
    if not finite.any():
        return True
    size = np.max(np.abs(expected[finite]), initial=_LEAST) * _TOLERANCE[values.dtype]
    moved = np.max([np.abs(near[finite] - expected[finite]) for near in nearby], axis=0)
    values, expected = values[finite], expected[finite]
    with np.errstate(invalid="ignore", over="ignore"):  # what is infinite where it should not be does not agree
        return bool(np.mean(np.abs(values - expected) <= size + 1e3 * moved) >= 0.9)
