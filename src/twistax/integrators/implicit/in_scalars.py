"""What is worked out at one point of a loop, written out as scalars."""

from __future__ import annotations

from collections.abc import Callable

import jax

from ...jax_inside import ClosedJaxpr, is_traced, jaxpr_as_fun
from ...lowering import XLA

__all__ = ["in_scalars"]

#: As arrays beyond this many scalars: they would take seconds to compile.
_LARGEST = 2000


def in_scalars(function: Callable[[], list[jax.Array]]) -> list[jax.Array]:
    """function(), zeros and repeated parts left out where it is small enough: no array has more than 128 entries.

    It may close over traced values.
    """
    closed = jax.make_jaxpr(function)()
    held = [i for i, value in enumerate(closed.consts) if is_traced(value)]

    def of(*values: jax.Array) -> list[jax.Array]:
        consts = list(closed.consts)
        for i, value in zip(held, values, strict=True):
            consts[i] = value
        return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, consts))()

    values = [closed.consts[i] for i in held]
    return XLA(least=0, largest=_LARGEST).emit(jax.make_jaxpr(of)(*values)).function(*values)
