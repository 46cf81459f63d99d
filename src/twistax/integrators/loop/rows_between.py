"""Rows at saved times between the ends of steps, from what each step leaves for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..charts.coordinates import Blocks
from ..method import Stepper

Read = Callable[[jax.Array], Blocks]


class StepPolynomial(NamedTuple):
    """A step that was tried, for its polynomial. Of one that was taken back the end is its start."""

    end: jax.Array
    begin: jax.Array
    y: jax.Array
    h: jax.Array
    in_s: jax.Array  # the same by time: negative where an integration goes backward
    slopes: Any
    y_end: jax.Array

    def row(self, stepper: Stepper, read: Read, t: jax.Array) -> jax.Array:
        """The packed state at a time up to the end of the step."""
        share = (t - self.begin) / self.h
        moved = stepper.method.between(stepper.dynamics, read(self.y), self.in_s, self.slopes, share)
        at_ends = jnp.where(share <= 0.0, self.y, self.y_end)
        return jnp.where((share > 0.0) & (t < self.end), ravel_pytree(moved)[0], at_ends)


class StepStart(NamedTuple):
    """How far the tries so far came, for a shorter step from the start of the last step."""

    t: jax.Array
    accepted: jax.Array  # how many steps were taken
    y: jax.Array
    last: Any  # time and state at the start of the last step taken

    def before(self, stop: jax.Array) -> tuple[Any, jax.Array]:
        """Time and state from which a stop that was just reached is one step away, or none; and the steps up to it."""
        # A saved time that is the end of a step needs no other one.
        there = self.t <= stop
        start = jax.tree.map(lambda end, before: jnp.where(there, end, before), (self.t, self.y), self.last)
        return start, self.accepted - (~there).astype(self.accepted.dtype)

    def row(self, stepper: Stepper, read: Read, t: jax.Array) -> jax.Array:
        """The start of the shorter step to a time, as `row_of_start` packs it."""
        return row_of_start(*self.before(t))


def rows_from(stepper: Stepper, read: Read) -> Callable[[Any, jax.Array], jax.Array]:
    """What makes the row at a time of what a step left.

    It reads no arrays of the stepper: they may be traced, and rows are made of what a step left alone.
    """
    return lambda step, t: step.row(stepper, read, t)


def row_of_start(start: tuple[jax.Array, jax.Array], steps: jax.Array) -> jax.Array:
    """Time and state of a start, and how many steps come before it, in one row."""
    return jnp.concatenate([jnp.stack([start[0], steps]), start[1]])


def starts_in(table: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The times, the numbers of steps and the states in rows of `row_of_start`."""
    return table[:, 0], table[:, 1].astype(int), table[:, 2:]
