"""Crossings of events that do not end an integration: the table that the loop over steps fills, and its rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from ..charts.coordinates import Blocks
from ..method import Stepper

#: Numbers and tags of a row of a table.
Row: TypeAlias = tuple[jax.Array, jax.Array]

#: The place of the time of a crossing since the start of its step in the numbers of a row, and that of the state.
_SINCE, _STATE = 2, 3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Crossed:
    """Crossings in the order of their times, rows (n, ...)."""

    steps: Any  # the accepted steps before
    t: Any  # the start of the step in which it lies
    h: Any  # the length of that step
    y: Any  # the stored state at the crossing
    s: Any  # how far into the step it lies
    which: Any  # the number of the event; -1 for rows without one
    rises: Any  # whether the condition rises


def row_of(steps: Any, t: jax.Array, h: jax.Array, s: jax.Array, y: jax.Array, which: Any, rises: Any) -> Row:
    """A row of a table from the fields of `Crossed`; the state is packed."""
    tags = [jnp.asarray(a, jnp.result_type(int)) for a in (steps, which, rises)]
    return jnp.concatenate([jnp.stack([t, h, s]), y]), jnp.stack(tags)


class CrossingTable(NamedTuple):
    """Crossings in the loop over steps, in the order of their times. Few arrays compile fast."""

    numbers: jax.Array  # (n, 3 + width) t, h and s of a row, and the packed state
    tags: jax.Array  # (n, 3) steps, which and rises
    used: jax.Array  # rows in use

    @classmethod
    def begun(cls, room: int, t: jax.Array, h: jax.Array, y: jax.Array, tags: jax.Array, used: jax.Array) -> Any:
        """With room for so many rows, of which the first `used` are crossings at the start, of tags (k, 3)."""
        numbers, empty = row_of(0, t, h, jnp.zeros_like(t), y, -1, 0)
        rest = jnp.broadcast_to(empty, (max(room - len(tags), 0), len(empty)))
        tags = jnp.concatenate([tags[:room], rest])
        return cls(jnp.broadcast_to(numbers, (room, len(numbers))), tags, jnp.minimum(used, room))

    def with_one(self, row: Row, before: jax.Array) -> tuple[CrossingTable, Row, jax.Array]:
        """With one more crossing of the current step; if there is no room, without the latest one.

        Args:
            before: how many crossings earlier steps have.
        Returns:
            The table; the row that is left out; whether one is.
        """
        last, used, s = len(self.tags) - 1, self.used, row[0][_SINCE]
        latest = self.numbers[last], self.tags[last]
        full = used > last
        evicts = full & (before <= last) & (latest[0][_SINCE] > s)
        left_out = jax.tree.map(lambda a, b: jnp.where(evicts, a, b), latest, row)
        takes = ~full | evicts

        def goes_on(now: tuple[jax.Array, Any]) -> jax.Array:
            place, (numbers, _) = now
            return takes & (place > before) & (numbers[jnp.maximum(place - 1, 0), _SINCE] > s)

        def moved(now: tuple[jax.Array, Any]) -> tuple[jax.Array, Any]:
            place, rows = now
            return place - 1, jax.tree.map(lambda a: _written(a, place, a[jnp.maximum(place - 1, 0)]), rows)

        start = jnp.minimum(used, last), (self.numbers, self.tags)
        place, rows = jax.lax.while_loop(goes_on, moved, start)
        rows = jax.tree.map(lambda a, b: _written(a, place, jnp.where(takes, b, a[place])), rows, row)
        numbers, tags = rows
        return CrossingTable(numbers, tags, used + (~full).astype(used.dtype)), left_out, full

    def rows(self, read: Callable[[jax.Array], Blocks], steps: jax.Array, end: jax.Array) -> Crossed:
        """The rows, those after the end without a crossing.

        Args:
            read: unpacks a state.
            steps, end: the accepted steps, and how far into the step after them the integration ends.
        """
        (t, h, s), (before, which, rises) = self.numbers[:, :_STATE].T, self.tags.T
        there = (jnp.arange(len(self.tags)) < self.used) & ~((before == steps) & (s > end))
        y = jax.vmap(read)(self.numbers[:, _STATE:])
        return Crossed(before, t, h, y, s, jnp.where(there, which, -1), rises > 0)


def state_of(row: Row) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Of a row of a table: the number of the event, the time since the start of its step, and the packed state."""
    numbers, tags = row
    return tags[1], numbers[_SINCE], numbers[_STATE:]


def _written(table: jax.Array, place: jax.Array, row: jax.Array) -> jax.Array:
    return jax.lax.dynamic_update_index_in_dim(table, row, place, 0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class CrossingRows:
    """Crossings in the form of `Solution.crossings`, rows (n, ...): NaN beyond the count."""

    ts: Any  # in s
    xs: Any  # the states by name
    which: Any  # the numbers of the events, -1 beyond the count
    directions: Any  # 1 where the condition rises, else -1; 0 beyond the count
    used: Any  # the count


def crossing_rows(stepper: Stepper, crossed: Crossed) -> CrossingRows:
    """The times in s and the states by name of crossings."""
    there = crossed.which >= 0
    ts = jnp.where(there, stepper.clock(crossed.t + crossed.s), jnp.nan)
    xs = jax.vmap(stepper.stored.value)(crossed.y)
    xs = {k: jnp.where(there.reshape(there.shape + (1,) * (v.ndim - 1)), v, jnp.nan) for k, v in xs.items()}
    directions = jnp.where(there, jnp.where(crossed.rises, 1, -1), 0)
    return CrossingRows(ts, xs, crossed.which, directions, there.sum())
