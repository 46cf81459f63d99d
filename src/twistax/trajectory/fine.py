"""Every interval of a phase integrated closely again, from its planned start and with its planned controls."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ..lowering.dynamics import Arrays
from .interval import Interval, Slot
from .local import Local
from .smooth import Smooth
from .statement import PathRows
from .transcribed import Closely


@dataclasses.dataclass(frozen=True)
class Look:
    """Integrates closely, and looks at limits on the way.

    Args:
        interval: the maths of an interval in fine steps, all path rows at all its points.
        gap: Log(target^-1 base Exp(eta)), of (eta, base, target).
        times: of the points of an interval, given where it lies.
        params: as a problem is solved for.
        known: with those that were found.
    """

    interval: Interval
    local: Local
    path: PathRows
    gap: Smooth
    times: Callable[[Slot], jax.Array]
    params: Arrays
    known: Arrays

    def at(self, slots: Slot, left: Arrays, right: Arrays, us: jax.Array, border: jax.Array) -> Closely:
        """Of a phase with these first and last nodes of intervals, these controls, and this border."""
        own = jax.vmap(self._one, in_axes=(0, 0, 0, 0, None))(slots, left, right, us, border)
        return own._replace(cost=jnp.sum(own.cost))

    def _one(self, slot: Slot, base: Arrays, target: Arrays, u: jax.Array, border: jax.Array) -> Closely:
        group = self.local.group
        start = jnp.zeros(group.dimension, u.dtype)
        rolled = self.interval.roll(slot, base, start, u, border, self.params)
        rows, cost = self.interval.at_points(slot, base, rolled, u, border, self.params)
        xs = jax.vmap(group.retract, in_axes=(None, 0))(base, rolled.ends)
        as_written = jax.vmap(self.local.shown_rows, in_axes=(0, 0, None, None))
        shown = as_written(self.times(slot), xs, self.local.controls.split(u), self.known)
        return Closely(
            self.gap(rolled.ends[-1], base, target),
            _most(rows.reshape(len(shown), -1), self.path.equality),
            _most(shown, self.path.shown_equality),
            cost,
            {name: a[self.interval.substeps // 2] for name, a in xs.items()},
        )


def _most(rows: jax.Array, equality: Any) -> jax.Array:
    """The largest value of every row, of equalities the largest size."""
    return jnp.where(equality, jnp.abs(rows), rows).max(axis=0)
