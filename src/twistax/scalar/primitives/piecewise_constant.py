"""Values in the other real precision that are piecewise constant in the arguments of a program.

In float32 programs these are the float64 numbers of `jnp.where(x > 0, 0.5, 1.0)`, before their conversion.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from .entry import Convert, Entry
from .interface import Graph, Nodes, Reader, each, flat
from .operations import OPERATIONS

_STOP = OPERATIONS["stop_gradient"]
#: Equations that are read. Others, such as powers and norms, are simplified in the precision of the program.
_READ = {o.name for o in OPERATIONS.values() if o.written is None and not o.is_power}
_READ |= {"select_n", "square", "add_any", "reduce_sum"}
_PRECISIONS = np.dtype(np.float32), np.dtype(np.float64)


def piecewise_constant(reader: Reader, entry: Entry, eqn: Any, arrays: list[Nodes]) -> list[Nodes] | None:
    """The results of an equation whose real operands come from numbers, truth values and integers alone.

    Their derivatives are zero, and are not propagated through them. None for other equations.
    """
    g, variables = reader.graph, [*eqn.invars, *eqn.outvars]
    real = {v.aval.dtype for v in variables if jnp.issubdtype(v.aval.dtype, jnp.inexact)}
    operands = [a for v, a in zip(eqn.invars, arrays, strict=True) if v.aval.dtype in real]
    if (
        entry.name not in _READ
        or not real.issubset(_PRECISIONS)
        or not all(_has_no_slope(g, i) for i in flat(*operands))
    ):
        return None
    results = entry.scalars(reader, eqn, *arrays)
    if results is None:
        return None
    stop = _STOP.on(g)
    return [each(stop, a) if v.aval.dtype in real else a for v, a in zip(eqn.outvars, results, strict=True)]


def _has_no_slope(g: Graph, node: int) -> bool:
    """Whether a node is a number, the result of such an equation, or was a truth value or an integer."""
    operation = g.operation(node)
    from_whole = isinstance(operation, Convert) and g.dtypes[g.arguments(node)[0]].kind in "iub"
    return g.numbers[node] is not None or operation is _STOP or from_whole
