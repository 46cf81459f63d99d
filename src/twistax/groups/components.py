"""Vectors as tuples of their scalar components.

Small vectors are written out: XLA turns scalar arithmetic into a few instructions, while products of 3x3 arrays inside
a loop become calls. The public maps unpack their arguments here and pack the result once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import jax.numpy as jnp
from jax import Array

__all__ = ["Components", "add", "cross", "dot", "matrix", "scale", "unpack", "vector"]

Components: TypeAlias = tuple[Array, ...]


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
