"""Whether a kernel does what its program says, on this machine: asked once, before anything relies on it."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from .kernel import Kernel
from .machine_code import BuildError

__all__ = ["check_kernel"]

#: Relative to the largest entry of a result: what is wrong differs by far more than rounding.
_TOLERANCE = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 1e-3}

#: Arguments are of size one: of a result smaller than this nothing but rounding may be left, as of a compensated sum.
_LEAST = 1e-3

#: Whether a call through JAX was right in this process.
_CALLED = False


def check_kernel(kernel: Kernel) -> None:
    """Computes one more row than a vector has lanes, at random, and compares; the first time through JAX too.

    Raises:
        BuildError: they differ.
    """
    random = np.random.default_rng(0)
    # What reads no arguments gives one row by itself.
    tile, rows = kernel.tile, kernel.tile.lanes + 1 if kernel.signature.arguments else 1
    arguments = tile.exercised([_drawn(random, rows, math.prod(shape), dtype) for shape, dtype in tile.arguments])
    given = [arguments[k] for k in kernel.signature.arguments]
    expected = _needed(kernel, tile.plain(arguments))
    beside = _needed(kernel, tile.plain([_moved(a) for a in arguments]))
    found = kernel.run(given)
    for own, other, near in zip(found, expected, beside, strict=True):
        if not _agree(own, other, near):
            raise BuildError("its results differ from those of NumPy")
    global _CALLED
    if not _CALLED:
        with jax.ensure_compile_time_eval(), jax.default_device(jax.local_devices(backend="cpu")[0]):
            shaped = [a.reshape(rows, *shape) for a, (shape, _) in zip(arguments, tile.arguments, strict=True)]
            called = jax.jit(lambda *values: kernel(rows, *values))(*shaped)
        for k, own in zip(kernel.signature.results, found, strict=True):
            if not np.array_equal(np.asarray(called[k]).reshape(own.shape), own, equal_nan=own.dtype.kind == "f"):
                raise BuildError("JAX calls it otherwise than expected")
        _CALLED = True


def _needed(kernel: Kernel, results: list[NDArray[Any]]) -> list[NDArray[Any]]:
    return [results[k] for k in kernel.signature.results]


def _drawn(random: np.random.Generator, rows: int, size: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype.kind == "f":
        return random.normal(size=(rows, size)).astype(dtype)
    return random.integers(0, 2, (rows, size)).astype(dtype)


def _moved(values: NDArray[Any]) -> NDArray[Any]:
    """The next numbers: how far results move by that tells how much rounding may do."""
    return np.nextafter(values, np.inf, dtype=values.dtype) if values.dtype.kind == "f" else values


def _agree(own: NDArray[Any], other: NDArray[Any], near: NDArray[Any]) -> bool:
    if own.dtype.kind != "f":
        # A comparison of nearly equal numbers may fall either way.
        return bool(np.mean(own == other) >= 0.5)
    finite = np.isfinite(other) & np.isfinite(near)
    if not finite.any():
        return True
    size = np.max(np.abs(other[finite]), initial=_LEAST) * _TOLERANCE[own.dtype]
    rounding = 1e3 * np.abs(near - other, where=finite, out=np.zeros_like(other))
    return bool(np.mean(np.abs(own - other)[finite] <= (size + rounding)[finite]) >= 0.9)
