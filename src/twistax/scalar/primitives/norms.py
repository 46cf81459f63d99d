"""Norms, as operations on the scalars of a vector."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .entry import SMALL, Entry, Operation
from .in_range import norm, scales
from .interface import Graph, Nodes, Reader, gathered, nodes
from .operations import OPERATIONS, on


def _number(*x: Any) -> Any:
    least, largest, factor = scales(x[0].dtype, len(x))
    size = functools.reduce(np.maximum, map(np.abs, x))
    unit = np.where(size > largest, 1.0 / factor, np.where(size < least, factor, 1.0)).astype(x[0].dtype)
    return np.sqrt(functools.reduce(np.add, ((entry * unit) ** 2 for entry in x))) / unit


def _array(*x: jax.Array) -> jax.Array:
    run = norm
    for _ in x[0].shape:
        run = jax.vmap(run)
    return run(jnp.stack(x, axis=-1))


def _written(g: Graph, *x: int) -> int:
    """The root of the sum of squares, in units of a power of two that keep these in range."""
    least, largest, factor = map(g.constant, scales(g.dtype, len(x)))
    size = functools.reduce(OPERATIONS["max"].on(g), (on(g, "abs", entry) for entry in x))
    large, small, inverse = on(g, "gt", size, largest), on(g, "lt", size, least), g.div(g.one, factor)
    unit = g.select(large, inverse, g.select(small, factor, g.one))
    scaled = [g.mul(entry, unit) for entry in x]
    root = on(g, "sqrt", functools.reduce(g.add, (g.mul(entry, entry) for entry in scaled)))
    return g.mul(root, g.select(large, factor, g.select(small, inverse, g.one)))


def _slopes(g: Graph, x: tuple[int, ...], y: int) -> Sequence[int]:
    """x_i / y; zero at zero, as are their derivatives."""
    zero = on(g, "eq", y, g.zero)
    divisor = g.select(zero, g.one, y)
    return [g.select(zero, g.zero, g.div(entry, divisor)) for entry in x]


_NORM = Operation(
    name="norm", number=_number, array=_array, partials=_slopes, written=lambda g: functools.partial(_written, g)
)


def _read(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    g, kept = reader.graph, eqn.params["kept"]
    lists, shape = gathered(a, tuple(range(kept, a.ndim)))
    if not a.size:
        return [np.full(shape, g.zero, np.int64)]
    return [nodes([on(g, "abs", x[0]) if len(x) == 1 else g.node(_NORM, *x) for x in lists], shape)]


#: In the table of primitives.
NORM = Entry("norm", _read, "kept", inside=SMALL)
