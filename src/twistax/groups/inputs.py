"""What the numeric maps accept, and the one place where it is turned into arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from twistax.errors import ShapeError

__all__ = ["Input", "floats", "multiply", "of_shape"]

Input: TypeAlias = ArrayLike | Sequence[Any]


_TYPED = (Array, np.ndarray, np.generic)


def floats(*values: Input) -> tuple[Array, ...]:
    """The values as floating point arrays. Lists and plain numbers take the precision of the arrays beside them."""
    typed = [jnp.asarray(value) if isinstance(value, _TYPED) else None for value in values]
    kinds = [array.dtype for array in typed if array is not None and jnp.issubdtype(array.dtype, jnp.floating)]
    common = jnp.result_type(*kinds) if kinds else jnp.result_type(float)
    arrays = (
        jnp.asarray(value, common) if array is None else array for value, array in zip(values, typed, strict=True)
    )
    return tuple(array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(common) for array in arrays)


def of_shape(function: str, shapes: Mapping[str, tuple[int, ...]], *values: Input) -> tuple[Array, ...]:
    """`floats`, after which every array must have the shape that `shapes` gives for its name, in this order."""
    arrays = floats(*values)
    for (name, expected), array in zip(shapes.items(), arrays, strict=True):
        if array.shape != expected:
            raise ShapeError(f"{function} expects {name} with shape {expected}, got {array.shape}")
    return arrays


def multiply(a: Array, b: Array) -> Array:
    """a @ b for a small matrix a and a small matrix or a vector b, as a sum of products.

    XLA fuses it with its surroundings, where a matrix product would be a call; and accelerators round the factors of
    a float32 matrix product to fewer bits, which they never do here.
    """
    if b.ndim == 1:
        return jnp.sum(a * b[None, :], axis=1)
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)
