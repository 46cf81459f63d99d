"""Which numbers may come in: one rule for values that are declared, baked, guessed, or given to a call."""

from __future__ import annotations

import numbers
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

__all__ = ["reals"]


def reals(place: str, value: Any, error: type[Exception], free: bool = False) -> np.ndarray:
    """A value as an array of real numbers: float64, or bool where all entries are truth values.

    Integers, floats of any precision and truth values may come, as Python's, NumPy's or JAX's, alone or in nested
    lists. What is no real number is refused: text, complex numbers, None, objects, masked entries.

    Args:
        place: names the value in messages.
        error: raised where it is refused.
        free: None stands for an entry that is left open, and becomes NaN.
    """
    if np.ma.is_masked(value):
        raise error(f"{place} expects real numbers, got masked entries.\n  fix: fill them, value.filled(...)")
    try:
        array = np.asarray(value)
    except jax.errors.TracerArrayConversionError:
        raise error(
            f"{place} expects numbers, got a traced JAX value.\n"
            "  fix: declare a tx.Parameter and pass the value through params"
        ) from None
    except (TypeError, ValueError) as wrong:
        raise error(f"{place} is not an array of numbers: {wrong}") from None
    if array.dtype == object:  # Python's own: fractions, long integers, None
        entries = [np.nan if entry is None and free else entry for entry in array.ravel()]
        strangers = [entry for entry in entries if not isinstance(entry, numbers.Real)]
        if strangers:
            raise error(f"{place} is not an array of numbers: got {type(strangers[0]).__name__}: {strangers[0]!r}")
        array = np.array([float(entry) for entry in entries]).reshape(array.shape)
    if array.dtype == bool:
        return array
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise error(f"{place} expects real numbers, got {array.dtype}")
    if not (jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)):
        raise error(f"{place} is not an array of numbers: got {value!r} of dtype {array.dtype}")
    return array.astype(np.float64)
