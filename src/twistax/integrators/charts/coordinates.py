"""Coordinates around the start of a step, for one part of the state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TypeAlias

import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...groups import Euclidean
from ...groups.components import unpack, vector

__all__ = ["Block", "Coordinates", "FlatCoordinates"]

#: Numbers of one part of the state: a tuple of scalars, or one array where scalars would be too many.
Block: TypeAlias = tuple[jax.Array, ...]

#: States without a group are held as scalars up to this size: scalar code runs faster and compiles slower.
_SCALARS = 16


class Coordinates(ABC):
    """How one part of the state is stored between steps, and the coordinates a step uses around its start.

    A step starts at the stored y, where the coordinates z are zero. With omega the rate of the state (the body velocity
    of a rotation or a pose),

        the state at z is `move(y, z)`, and z' = `slope(z, move(y, z), omega)`,

    so that any Runge-Kutta method can run on z. All methods are pure and traceable.
    """

    @abstractmethod
    def enter(self, g: jax.Array) -> Block:
        """What is stored of the value g."""

    @abstractmethod
    def value(self, y: Block) -> jax.Array:
        """The value of the state as expressions see it."""

    @abstractmethod
    def rate(self, omega: jax.Array) -> Block:
        """The rate as the dynamics give it, as numbers."""

    @abstractmethod
    def move(self, y: Block, z: Block) -> Block:
        """What is stored of the state with coordinates z around y. Exact enough for a stage."""

    @abstractmethod
    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        """z' at z; `moved` is move(y, z)."""

    @abstractmethod
    def first_slope(self, y: Block, omega: Block) -> Block:
        """z' at z = 0."""

    def tangent(self, z: Block) -> jax.Array:
        """The tangent d of the move, value(move(y, z)) = value(y) Exp(d), where z holds its entries.

        Raises:
            ModelError: coordinates of another kind.
        """
        raise ModelError(
            "derivatives of steps need exponential coordinates of the whole state.\n"
            "  fix: use tx.RKMK(tableau), or a chart tx.charts.Exponential(...)"
        )

    def deviation(self, e: Block, after: Block) -> Block:
        """The tangent, up to higher order, of a small difference e of coordinates near the end of a step.

        Rotations in rad, positions in their unit; poses as [v; w] whatever their order. Lengths are what counts: the
        axes may be those of the start.
        """
        return e

    @abstractmethod
    def sizes(self, before: Block, after: Block) -> Block:
        """What the entries of a deviation are compared with: 1 rad for a rotation, else the size of the state."""

    def settle(self, moved: Block) -> Block:
        """The end of a step: `moved`, put back into the group to round-off where rounding takes it out."""
        return moved


class FlatCoordinates(Coordinates):
    """A state without a group: its entries, moved by addition."""

    def __init__(self, group: Euclidean) -> None:
        self.shape = group.shape
        self.scalars = group.dimension <= _SCALARS

    def enter(self, g: jax.Array) -> Block:
        return unpack(g) if self.scalars else (g.reshape(-1),)

    def value(self, y: Block) -> jax.Array:
        if not self.scalars:
            return y[0].reshape(self.shape)
        return vector(y).reshape(self.shape)

    def rate(self, omega: jax.Array) -> Block:
        return self.enter(omega)

    def move(self, y: Block, z: Block) -> Block:
        return tuple(a + b for a, b in zip(y, z, strict=True))

    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        return omega

    def first_slope(self, y: Block, omega: Block) -> Block:
        return omega

    def sizes(self, before: Block, after: Block) -> Block:
        return tuple(jnp.maximum(jnp.abs(a), jnp.abs(b)) for a, b in zip(before, after, strict=True))

    def tangent(self, z: Block) -> jax.Array:
        return vector(z) if self.scalars else z[0]
