"""Steps in a row, as many as there is nothing to decide between: a loop of Python costs as much as a small step."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .interior_point import InteriorPoint, largest
from .iterate import State
from .transcribed import Derivatives, Given, Transcribed

#: Scaled multipliers beyond this have run away.
AWAY = 1e6


class Stride(NamedTuple):
    """Where steps in a row have led."""

    slopes: Derivatives
    state: State  # measured
    before: Any  # the barrier parameter before it was
    count: Any  # of the steps


def no_slopes(shooting: Transcribed) -> Derivatives:
    """In place of derivatives, where none are known."""
    count, n, g = shooting.intervals, shooting.n, shooting.border.size
    size, rows = n + shooting.m + g, shooting.rows_per_interval
    at_end = len(shooting.exists) - count * rows
    shapes = (
        *((count, n, size), (count, rows, size), (at_end, n + g)),
        *((count, size), (n + g,), (count, size, size), (n + g, n + g)),
    )
    return jax.device_put(Derivatives(*map(np.zeros, shapes)))  # nothing to compile


def stride(
    method: InteriorPoint, tolerance: float, state: State, slopes: Derivatives, given: Given, most: Any, low: Any
) -> Stride:
    """Steps until one asks for a decision: the barrier parameter fell, it may be the end, or something is wrong.

    Args:
        state: measured, with its derivatives; where `most` is zero it is only measured, with none.
        most: how many steps.
        low: what the objective may not fall below.
    """

    def going(own: Stride) -> jax.Array:
        state, e = own.state, own.state.errors
        error = jnp.stack([e.stationarity, e.feasibility, e.gap])
        calm = (error.max() > tolerance) & jnp.isfinite(error).all() & (state.barrier >= own.before) & ~state.stuck
        tame = (largest((state.dynamics, state.rows)) <= AWAY) & (state.values.cost >= low)
        return (own.count == 0) | (calm & tame & (own.count < most))

    def ahead(own: Stride) -> Stride:
        state = jax.lax.cond(most > 0, lambda: method.step(own.state, own.slopes, given), lambda: own.state)
        slopes, measured = method.looked_at(state, given)
        return Stride(slopes, measured, state.barrier, own.count + 1)

    begin = Stride(slopes, state, state.barrier, jnp.zeros((), int))
    return jax.lax.while_loop(going, ahead, begin)
