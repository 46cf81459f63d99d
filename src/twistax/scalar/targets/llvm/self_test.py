"""Whether a kernel does what its program says: asked once, before anything relies on it."""

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

#: Relative to the largest entry of a result: what is wrong differs by far more than rounding.
_TOLERANCE = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 1e-3}

#: Arguments are of size one: of a result smaller than this nothing but rounding may be left, as of a compensated sum.
_LEAST = 1e-3

#: The platforms on which a call through JAX was right in this process.
_CALLED: set[str] = set()


def check_kernel(kernel: Kernel) -> None:
    """Computes rows of a tile at random, one more than a vector has lanes; compares, the first time through JAX too.

    Once for each kernel: what was seen to be right is kept, also for other processes.

    Raises:
        BuildError: they differ.
    """
    tile = kernel.tile
    if kernel.lease.checked:
        return
    random = np.random.default_rng(0)
    # What reads no arguments gives one row by itself.
    rows = kernel.checked_rows if tile.read else 1
    arguments = tile.exercised([_drawn(random, (rows, math.prod(a.of_length(tile.tried))), a) for a in tile.arguments])
    expected, beside = tile.plain(arguments), [tile.plain([_moved(a) for a in arguments])]
    found = kernel.run([arguments[k] for k in tile.read], tile.tried)

    def agrees() -> bool:
        own = zip(tile.written, found, strict=True)
        return all(_agree(values, expected[k], [each[k] for each in beside]) for k, values in own)

    if not agrees():
        # Of nearly singular constants the arguments, moved once, may say nothing: each operation is moved.
        beside += [tile.plain(arguments, functools.partial(_rounded, random)) for _ in range(4)]
        if not agrees():
            raise BuildError("its results differ from those of NumPy")
    if kernel.platform not in _CALLED:
        with jax.ensure_compile_time_eval(), jax.default_device(jax.local_devices(backend=kernel.platform)[0]):
            shapes = ((rows, *a.of_length(tile.tried)) for a in tile.arguments)
            shaped = [a.reshape(shape) for a, shape in zip(arguments, shapes, strict=True)]
            called = jax.jit(lambda *values: kernel(rows, *values, length=tile.tried))(*shaped)
        for k, own in zip(tile.written, found, strict=True):
            if not np.array_equal(np.asarray(called[k]).reshape(own.shape), own, equal_nan=own.dtype.kind == "f"):
                raise BuildError("JAX calls it otherwise than expected")
        _CALLED.add(kernel.platform)
    kernel.lease.keep()


def _drawn(random: np.random.Generator, size: tuple[int, int], array: Array) -> NDArray[Any]:
    drawn = random.normal(size=size) if array.dtype.kind == "f" else random.integers(0, 2, size)
    return drawn.astype(array.dtype)


def _moved(values: NDArray[Any]) -> NDArray[Any]:
    """The next numbers: how far results move by that tells how much rounding may do."""
    return np.nextafter(values, np.inf, dtype=values.dtype) if values.dtype.kind == "f" else values


def _rounded(random: np.random.Generator, values: NDArray[Any]) -> NDArray[Any]:
    """The next numbers, above or below."""
    if values.dtype.kind != "f":
        return values
    return np.nextafter(values, random.choice([-np.inf, np.inf], values.shape), dtype=values.dtype)


def _agree(own: NDArray[Any], other: NDArray[Any], beside: Sequence[NDArray[Any]]) -> bool:
    if own.dtype.kind != "f":
        # A comparison of nearly equal numbers may fall either way.
        return bool(np.mean(own == other) >= 0.5)
    finite = np.isfinite(other) & np.all(np.isfinite(beside), axis=0)
    if not finite.any():
        return True
    size = np.max(np.abs(other[finite]), initial=_LEAST) * _TOLERANCE[own.dtype]
    moved = np.max([np.abs(near[finite] - other[finite]) for near in beside], axis=0)
    own, other = own[finite], other[finite]
    with np.errstate(invalid="ignore"):  # what is infinite where it should not be does not agree
        return bool(np.mean(np.abs(own - other) <= size + 1e3 * moved) >= 0.9)
