"""Coordinates: the stored form of each part of a state between steps, and its coordinates
around the start of a step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ...errors import ModelError
from ...groups import Group, Product
from ...groups.arrays import add, unpack, vector
from ...system.dynamics import Arrays

#: Numbers of one part of the state: a tuple of scalars, or one array if there would be too many scalars.
Block: TypeAlias = tuple[jax.Array, ...]

#: Numbers by the name of the state: stored states, coordinates or rates. A pytree.
Blocks: TypeAlias = dict[str, Block]

#: States without a group are stored as scalars up to this size: scalar code runs faster but compiles more slowly.
_SCALARS = 16


class Coordinates(ABC):
    """The representation of one part of the state between steps, and the coordinates of a step around its start.

    A step starts at the stored y, where the coordinates z are zero. With omega the rate of the state (the body velocity
    of a rotation or a pose),

        the state at z is `move(y, z)`, and z' = `slope(z, move(y, z), omega)`,

    so any Runge-Kutta method can integrate z. All methods are pure and traceable. The non-abstract methods implement
    states without a group, to which increments are added.
    """

    @abstractmethod
    def enter(self, g: jax.Array) -> Block:
        """The stored form of the value g."""

    @abstractmethod
    def value(self, y: Block) -> jax.Array:
        """The value of the state in expressions."""

    def rate(self, omega: jax.Array) -> Block:
        """The rate from the dynamics, as numbers."""
        return self.enter(omega)

    def velocity(self, omega: Block) -> jax.Array:
        """The rate of the dynamics, from the numbers of `rate`."""
        return self.value(omega)

    def move(self, y: Block, z: Block) -> Block:
        """The stored state at coordinates z around y, accurate enough for a stage."""
        return add(y, z)

    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        """The derivative z' at z; `moved` is move(y, z)."""
        return self.first_slope(moved, omega)

    def first_slope(self, y: Block, omega: Block) -> Block:
        """The derivative z' at z = 0: the rate itself, as in all exponential coordinates."""
        return omega

    def tangent(self, z: Block) -> jax.Array:
        """The tangent d of the move, value(move(y, z)) = value(y) Exp(d); `z` contains its entries.

        Raises:
            ModelError: coordinates of another kind.
        """
        raise ModelError(
            "derivatives of steps need exponential coordinates of the whole state.\n"
            "  fix: use tx.RKMK(tableau), or a chart tx.charts.Exponential(...)"
        )

    def deviation(self, e: Block, after: Block) -> Block:
        """The tangent, up to higher order, for a small difference e of coordinates near the end of a step.

        Rotations in rad, positions in their unit; poses as [v; w] whatever the order of the group. Only its norm is
        used, so the axes may be those of the start of the step.
        """
        return e

    @abstractmethod
    def sizes(self, before: Block, after: Block) -> Block:
        """The sizes that entries of a deviation are compared to: 1 rad for a rotation, else the size of the state."""

    def settle(self, moved: Block) -> Block:
        """The end of a step: `moved`, projected back to the group if round-off has moved it away."""
        return moved

    # ---- moves as increments, for compensated summation ----

    #: The number of stored arrays if a move adds an increment to each of them, else None.
    numbers: int | None = None

    def shift(self, y: Block, z: Block) -> Block:
        """The increment that `move` adds to y, accurate to round-off of its own size."""
        return z

    def settling(self, moved: Block) -> Block:
        """The increment that `settle` adds; () for none."""
        return ()


class FlatCoordinates(Coordinates):
    """A state without a group: its entries, moved by addition."""

    def __init__(self, group: Group) -> None:
        self.shape = group.shape
        self.scalars = group.dimension <= _SCALARS
        self.numbers = group.dimension if self.scalars else 1

    def enter(self, g: jax.Array) -> Block:
        return unpack(g) if self.scalars else (g.reshape(-1),)

    def value(self, y: Block) -> jax.Array:
        return self.tangent(y).reshape(self.shape)

    def sizes(self, before: Block, after: Block) -> Block:
        return tuple(jnp.maximum(jnp.abs(a), jnp.abs(b)) for a, b in zip(before, after, strict=True))

    def tangent(self, z: Block) -> jax.Array:
        return vector(z) if self.scalars else z[0]


class GroupCoordinates(Coordinates):
    """Exponential coordinates g = g_0 Exp(z), z' = J_r(z)^-1 Omega, by the maps of a group for which no chart has
    formulas.
    """

    def __init__(self, group: Group) -> None:
        self.group = group

    def enter(self, g: jax.Array) -> Block:
        return (g,)

    def value(self, y: Block) -> jax.Array:
        return y[0]

    def move(self, y: Block, z: Block) -> Block:
        return (self.group.retract(y[0], z[0]),)

    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        return (self.group.right_jacobian_inv_apply(z[0], omega[0]),)

    def sizes(self, before: Block, after: Block) -> Block:
        return (jnp.maximum(self.group.sizes(before[0]), self.group.sizes(after[0])),)

    def tangent(self, z: Block) -> jax.Array:
        return z[0]

    def settle(self, moved: Block) -> Block:
        return (self.group.tighten(moved[0]),)


# ---- compensated summation in single precision: without it, a million steps in float32 lose 1 % of the time, because
# each adds a small number to a large one with a systematic rounding error. It is used in every step, so that the number
# of steps remains an input.

#: Numbers with a coarser round-off than this use compensated summation: those of float32, not those of float64.
_COARSE = 1e-10


class Compensated(Coordinates):
    """Coordinates with compensated summation: numbers are stored as (y, r), with r the accumulated round-off of y.

    A step that moves y by d computes s = fl(y + (d + r)), and r becomes the exact error of that sum. The numbers of a
    rotation are those of its quaternion, with d = q (Exp(z) - 1); its normalisation is such a sum, too. In double
    precision r is omitted.

    Source: Neumaier, Rundungsfehleranalyse einiger Verfahren zur Summation endlicher Summen (1974); Knuth, The Art of
    Computer Programming 2 (1997), section 4.2.2, theorem B, for the error of a sum.
    """

    def __init__(self, plain: Coordinates, count: int) -> None:
        self._plain, self._count = plain, count

    def _high(self, y: Block) -> Block:
        return y[: self._count]

    def enter(self, g: jax.Array) -> Block:
        y = self._plain.enter(g)
        coarse = float(jnp.finfo(g.dtype).eps) > _COARSE
        return (*y, *map(jnp.zeros_like, y)) if coarse else y

    def value(self, y: Block) -> jax.Array:
        return self._plain.value(self._high(y))

    def move(self, y: Block, z: Block) -> Block:
        return self._added(y, lambda high: self._plain.shift(high, z), lambda: self._plain.move(y, z))

    def settle(self, moved: Block) -> Block:
        return self._added(moved, self._plain.settling, lambda: self._plain.settle(moved))

    def _added(self, y: Block, shift: Callable[[Block], Block], plain: Callable[[], Block]) -> Block:
        """y plus an increment of its numbers; `plain` for parts without compensation."""
        high, low = self._high(y), y[self._count :]
        if not low:
            return plain()
        moved = shift(high)
        if not moved:
            return y
        pairs = [_sum(a, b + r) for a, b, r in zip(high, moved, low, strict=True)]
        return (*(s for s, _ in pairs), *(r for _, r in pairs))

    def rate(self, omega: jax.Array) -> Block:
        return self._plain.rate(omega)

    def tangent(self, z: Block) -> jax.Array:
        return self._plain.tangent(z)

    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        return self._plain.slope(z, self._high(moved), omega)

    def first_slope(self, y: Block, omega: Block) -> Block:
        return self._plain.first_slope(self._high(y), omega)

    def deviation(self, e: Block, after: Block) -> Block:
        return self._plain.deviation(e, self._high(after))

    def sizes(self, before: Block, after: Block) -> Block:
        return self._plain.sizes(self._high(before), self._high(after))


def _sum(a: jax.Array, b: jax.Array) -> tuple[jax.Array, jax.Array]:
    """fl(a + b), and its round-off error, which has no derivative."""
    s = a + b
    fixed_a, fixed_b, fixed_s = jax.lax.stop_gradient((a, b, s))
    rest = fixed_s - fixed_a
    return s, (fixed_a - (fixed_s - rest)) + (fixed_b - rest)


# ---- a whole state ------------------------------------------------------------------------------------------------


class StoredState(ABC):
    """The stored form of a system's states between steps. Its methods are pure and traceable."""

    @abstractmethod
    def enter(self, x: Arrays) -> Blocks:
        """The stored form of a state."""

    @abstractmethod
    def value(self, y: Blocks) -> Arrays:
        """The state as expressions see it."""


def _part_by_part(method: str) -> Callable[..., Any]:
    """A method of `Coordinates`, applied to every part of a state."""

    def of_all(self: StateCoordinates, *blocks: Any) -> dict[str, Any]:
        return {name: getattr(part, method)(*(block[name] for block in blocks)) for name, part in self.parts.items()}

    return of_all


class StateCoordinates(StoredState):
    """`Coordinates` of all parts of a state: the same methods on dicts by name. Pure and traceable."""

    def __init__(self, parts: Mapping[str, Coordinates]) -> None:
        self.parts = dict(parts)

    enter, value, rate = map(_part_by_part, ("enter", "value", "rate"))
    move, slope, first_slope, settle = map(_part_by_part, ("move", "slope", "first_slope", "settle"))
    tangent, deviation, sizes = map(_part_by_part, ("tangent", "deviation", "sizes"))

    def still(self, y: Blocks, group: Product) -> Blocks:
        """The slope of a state at rest."""
        dtype = jax.tree.leaves(y)[0].dtype
        rates = {name: jnp.zeros(factor.dimension, dtype) for name, factor in group.factors.items()}
        return self.first_slope(y, self.rate(rates))

    def packed(self, y: Blocks, group: Product) -> tuple[jax.Array, Callable[[jax.Array], Blocks]]:
        """The coordinates of the stored state itself, as one vector, and the function that unpacks such vectors."""
        zero, read = ravel_pytree(self.still(y, group))
        return jnp.zeros_like(zero), read
