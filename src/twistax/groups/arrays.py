"""What the numeric maps accept, the one place where it becomes arrays, and small vectors as tuples of their components.

Small vectors are unrolled: XLA turns scalar arithmetic into a few instructions, while products of 3x3 arrays inside a
loop become calls. The public maps unpack their arguments here and pack the result once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from twistax.errors import ShapeError

__all__ = [
    "Components",
    "Input",
    "add",
    "cross",
    "dot",
    "floats",
    "matrix",
    "multiply",
    "of_shape",
    "scale",
    "unpack",
    "vector",
]

Input: TypeAlias = ArrayLike | Sequence[Any]

Components: TypeAlias = tuple[Array, ...]

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


def unpack(a: Array) -> Components:
    """The scalars of an array of any shape, row by row."""
    return tuple(jnp.unstack(a if a.ndim == 1 else a.reshape(-1)))


def vector(components: Sequence[Array]) -> Array:
    """The scalars as one vector."""
    return jnp.stack(list(components))


def matrix(rows: Sequence[Sequence[Array]]) -> Array:
    """Rows of scalars as one matrix."""
    return jnp.stack([jnp.stack(list(row)) for row in rows])


def dot(a: Components, b: Components) -> Array:
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Components, b: Components) -> Components:
    """a x b"""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def add(a: Components, *others: Components) -> Components:
    """a + b + ..."""
    for b in others:
        a = tuple(x + y for x, y in zip(a, b, strict=True))
    return a


def scale(s: Array | float, a: Components) -> Components:
    """s a"""
    return tuple(s * x for x in a)
