"""The state at any time of a flight."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..jax_inside import is_traced
from ..lowering.dynamics import Arrays
from .charts.whole import Blocks
from .course import Trail
from .stepper import Stepper

__all__ = ["Dense"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Dense:
    """A flight with the start of every step kept. A pytree.

    Between two of them the state is one shorter step of the same method, so it stays in its group and is as accurate as
    the flight; an interpolating polynomial would cost order and leave the group.

    Attributes:
        stepper: what takes the steps.
        trail: the starts of all steps.
    """

    stepper: Stepper
    trail: Trail

    def evaluate(self, t: Any) -> Arrays:
        """The states at a time () or at times (n,), on a leading axis then; see `Solution.evaluate`."""
        ts = jnp.asarray(t, self.trail.t.dtype)
        if ts.ndim > 1:
            raise InputError(f"evaluate expects a time or times with shape (n,), got shape {ts.shape}")
        if not is_traced((ts, self.trail)):
            flown = np.asarray(self.trail.t)
            start, end = float(flown[0]), float(flown[int(self.trail.steps)])
            room = 1e-6 * (end - start)
            times = np.asarray(ts).reshape(-1)
            outside = ~((times >= start - room) & (times <= end + room))
            if outside.any():
                wrong = float(times[int(np.argmax(outside))])
                raise InputError(f"evaluate expects times in [{start:g}, {end:g}], which was flown, got {wrong:g}")
        found = _states(self, ts.reshape(-1))
        return {name: value[0] for name, value in found.items()} if ts.ndim == 0 else found


@jax.jit
def _states(dense: Dense, ts: jax.Array) -> Arrays:
    trail, stored = dense.trail, dense.stepper.stored
    last = jnp.maximum(trail.steps - 1, 0)
    before = jnp.searchsorted(trail.t, ts, side="right").astype(last.dtype) - 1
    k = jnp.clip(before, 0, last)

    def state(t: jax.Array, start: jax.Array, y: Blocks) -> Arrays:
        return stored.value(dense.stepper.advance(start, y, t - start))

    return jax.vmap(state)(ts, trail.t[k], jax.tree.map(lambda a: a[k], trail.y))
