"""Equal steps, which are split at the times where rates may jump, so that no step has a jump inside."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import is_traced
from ..controls import row_at

#: A time this close to the end of a step, in steps, counts as on it: far more than round-off, far less than anyone
#: means.
SNAP = 1e-9


def slack(times: Any, h: Any, eps: float) -> Any:
    """How far from the end of a step of length h times count as on it, in s: times may be rounded too.

    Args:
        eps: the relative spacing of floating-point numbers in the precision of the times.
    """
    array: Any = jnp if is_traced((times, h)) else np
    return array.maximum(SNAP * h, 4.0 * eps * abs(times))


class Splits(NamedTuple):
    """Where jumps lie in a sequence of steps: inside of an equal step, which they split, or at its end."""

    slots: Any  # (m,) in order: the number of the step that begins at each jump; beyond all steps for those left out
    times: Any  # (m,) the jumps
    added: Any  # (m,) the steps that the jumps up to and including this one add


class Grid(NamedTuple):
    """Steps from t0 of length h, split at jumps. A pytree: other numbers are another input of the same program.

    Step k begins at $t0 + (k - a) h$, with a the number of steps that jumps have added before it, or at a jump. A jump
    that lies at the end of an equal step replaces that end, so that derivatives with respect to its time are right.
    """

    t0: Any
    h: Any
    splits: Splits | None = None

    def begin(self, k: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The start of step k, computed afresh so that it does not drift; whether it is a jump."""
        if self.splits is None:
            return self.t0 + k.astype(self.t0.dtype) * self.h, jnp.zeros(jnp.shape(k), bool)
        slots, times, added = map(jnp.asarray, self.splits)
        row = row_at(slots, k)
        last = jnp.maximum(row, 0)
        before = jnp.where(row < 0, 0, added[last])
        at_jump = (row >= 0) & (slots[last] == k)
        return jnp.where(at_jump, times[last], self.t0 + (k - before).astype(self.t0.dtype) * self.h), at_jump

    def step(self, k: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Start and length of step k."""
        t, from_jump = self.begin(k)
        if self.splits is None:
            return t, self.h
        end, to_jump = self.begin(k + 1)
        return t, jnp.where(from_jump | to_jump, end - t, self.h)

    def one_step(self, t: jax.Array, h: jax.Array) -> Grid:
        """A grid of the same structure whose first step is that of length h from t."""
        if self.splits is None:
            return Grid(t, h)
        slots = jnp.asarray(self.splits.slots)
        return Grid(t, h, self.splits._replace(slots=jnp.full_like(slots, jnp.iinfo(slots.dtype).max)))


def splits_of(limits: Any, t0: Any, h: Any, steps: int) -> tuple[Splits | None, Any]:
    """The splits of equal steps at sorted times inside of [t0, t0 + steps h], and how many steps they add.

    Times at the ends of the whole split nothing. None where there are no times.
    """
    if not np.size(limits):
        return None, 0
    array: Any = jnp if is_traced((limits, t0, h)) else np
    kind = jax.dtypes.canonicalize_dtype(int)
    fixed = jax.lax.stop_gradient((limits, t0, h)) if array is jnp else (limits, t0, h)
    times, start, length = (array.asarray(value) for value in fixed)
    length = array.where(length > 0.0, length, 1.0)
    near = slack(times, length, float(np.finfo(times.dtype).eps)) / length
    place = (times - start) / length
    nearest = array.rint(place)
    on_end = abs(place - nearest) <= near
    end = array.where(on_end, nearest, array.ceil(place))
    again = (array.diff(end) == 0.0) & on_end[1:] & on_end[:-1] | (array.diff(place) <= near[1:])
    again = array.append(array.zeros(1, bool), again)
    present = (end > 0.0) & ((end < steps) | (~on_end & (end <= steps))) & ~again
    added = array.cumsum(present & ~on_end).astype(kind)
    # Of those that add a step the ones before count, and the equal steps up to the jump.
    slots = end.astype(kind) + array.where(on_end, added, added - 1)
    slots = array.where(present, slots, np.iinfo(kind).max)
    order = array.argsort(slots, **({"stable": True} if array is jnp else {"kind": "stable"}))
    return Splits(slots[order], array.asarray(limits)[order], added[order]), added[-1]
