"""What a chart says: how every part of a state is stored between steps, and its coordinates around a step's start."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...groups import Euclidean, Group, Product, SpecialEuclidean, SpecialOrthogonal, quaternions
from ...groups.arrays import Components, dot, matrix, scale, unpack, vector
from ...lowering.dynamics import Arrays

__all__ = [
    "Block",
    "Blocks",
    "Chart",
    "Coordinates",
    "FlatCoordinates",
    "GroupCoordinates",
    "StateCoordinates",
    "StoredPose",
    "StoredRotation",
    "StoredState",
    "chart_of",
    "coordinates_of",
    "tightened",
    "unit",
]

#: Numbers of one part of the state: a tuple of scalars, or one array where scalars would be too many.
Block: TypeAlias = tuple[jax.Array, ...]

#: Numbers by the name of the state: stored states, coordinates, rates. A pytree.
Blocks: TypeAlias = dict[str, Block]

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

    def first_slope(self, y: Block, omega: Block) -> Block:
        """z' at z = 0: the rate itself, as in all exponential coordinates of the whole."""
        return omega

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

    def sizes(self, before: Block, after: Block) -> Block:
        return tuple(jnp.maximum(jnp.abs(a), jnp.abs(b)) for a, b in zip(before, after, strict=True))

    def tangent(self, z: Block) -> jax.Array:
        return vector(z) if self.scalars else z[0]


class GroupCoordinates(Coordinates):
    """g = g_0 Exp(z), z' = J_r(z)^-1 Omega, with the group's own maps: for groups that a chart does not know."""

    def __init__(self, group: Group) -> None:
        self.group = group

    def enter(self, g: jax.Array) -> Block:
        return (g,)

    def value(self, y: Block) -> jax.Array:
        return y[0]

    def rate(self, omega: jax.Array) -> Block:
        return (omega,)

    def move(self, y: Block, z: Block) -> Block:
        return (self.group.retract(y[0], z[0]),)

    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        return (self.group.right_jacobian_inv_apply(z[0], omega[0]),)

    def sizes(self, before: Block, after: Block) -> Block:
        return (jnp.ones(self.group.dimension, before[0].dtype),)

    def tangent(self, z: Block) -> jax.Array:
        return z[0]

    def settle(self, moved: Block) -> Block:
        return (self.group.tighten(moved[0]),)


# ---- rotations and poses: unit quaternions (and positions) between steps -----------------------------------------
# A quaternion is put back to length one by one scalar, so that its rotation stays orthonormal to round-off for ever; a
# product of two costs 16 multiplications where one of matrices costs 27.


def tightened(q: Components) -> Components:
    """A quaternion whose length is off by round-off, put back to one: one Newton step."""
    return scale(1.5 - 0.5 * _square(q), q)


def unit(q: Components) -> Components:
    """A quaternion of any length but zero, put to length one; NaN where its square overflows."""
    square = _square(q)
    return scale(jnp.where(jnp.isfinite(square), jax.lax.rsqrt(square), jnp.nan), q)


def _square(q: Components) -> jax.Array:
    """|q|^2."""
    return q[0] * q[0] + dot(q[1:], q[1:])


class StoredRotation(Coordinates):
    """(q,): a rotation as a quaternion."""

    def enter(self, g: jax.Array) -> Components:
        return unpack(quaternions.from_rotation(g))

    def value(self, y: Components) -> jax.Array:
        return matrix(quaternions.rotation_rows(y))

    def rate(self, omega: jax.Array) -> Components:
        return unpack(omega)

    def sizes(self, before: Components, after: Components) -> Components:
        return _radians(after)

    def settle(self, moved: Components) -> Components:
        return tightened(moved)


class StoredPose(Coordinates):
    """(q, p): a pose as a quaternion and a position; rates as [v; w] whatever their order."""

    def __init__(self, group: SpecialEuclidean) -> None:
        self.order = group.order

    def enter(self, g: jax.Array) -> Components:
        return (*unpack(quaternions.from_rotation(g[:3, :3])), *unpack(g[:3, 3]))

    def value(self, y: Components) -> jax.Array:
        rows = [[*row, p] for row, p in zip(quaternions.rotation_rows(y[:4]), y[4:], strict=True)]
        zero = jnp.zeros_like(y[0])
        return matrix([*rows, [zero, zero, zero, zero + 1.0]])

    def rate(self, omega: jax.Array) -> Components:
        return unpack(self.order.to_linear_first(omega))

    def sizes(self, before: Components, after: Components) -> Components:
        length = jnp.sqrt(jnp.maximum(dot(before[4:], before[4:]), dot(after[4:], after[4:])))
        return (length, length, length, *_radians(after))

    def settle(self, moved: Components) -> Components:
        return (*tightened(moved[:4]), *moved[4:])


def _radians(y: Components) -> Components:
    one = jnp.ones_like(y[0])
    return (one, one, one)


# ---- a whole state ------------------------------------------------------------------------------------------------


class Chart(ABC):
    """Which coordinates a step uses around its start. A value: equal charts mean the same.

    A new chart subclasses this and gives coordinates for rotations and poses; states without a group are added to, and
    states of other groups move in exponential coordinates.
    """

    def coordinates(self, group: Group) -> Coordinates:
        """The coordinates for one part of the state; exponential ones for groups that are neither SO(3) nor SE(3)."""
        if isinstance(group, Euclidean):
            return FlatCoordinates(group)
        if isinstance(group, SpecialOrthogonal):
            return self.for_rotation()
        if isinstance(group, SpecialEuclidean):
            return self.for_pose(group)
        return GroupCoordinates(group)

    @abstractmethod
    def for_rotation(self) -> Coordinates:
        """Coordinates around a rotation."""

    @abstractmethod
    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        """Coordinates around a pose whose twists have the order of `group`."""


def chart_of(owner: str, given: Any, default: Chart) -> Chart:
    """The chart that was given to a method, or the default one. Raises ModelError where it is none."""
    if given is None:
        return default
    if not isinstance(given, Chart):
        raise ModelError(f"{owner} expects a chart like tx.charts.Exponential(), got {given!r}")
    return given


class StoredState(ABC):
    """How the states of a system are stored between steps. Pure and traceable."""

    @abstractmethod
    def enter(self, x: Arrays) -> Blocks:
        """What is stored of a state."""

    @abstractmethod
    def value(self, y: Blocks) -> Arrays:
        """The state as expressions see it."""


class StateCoordinates(StoredState):
    """`Coordinates` of every part of a state, applied part by part. Pure and traceable."""

    def __init__(self, parts: Mapping[str, Coordinates]) -> None:
        self.parts = dict(parts)

    def enter(self, x: Arrays) -> Blocks:
        return {name: part.enter(x[name]) for name, part in self.parts.items()}

    def value(self, y: Blocks) -> Arrays:
        return {name: part.value(y[name]) for name, part in self.parts.items()}

    def rate(self, rates: Arrays) -> Blocks:
        """The rates of the dynamics, as numbers."""
        return {name: part.rate(rates[name]) for name, part in self.parts.items()}

    def move(self, y: Blocks, z: Blocks) -> Blocks:
        """The stored state with coordinates z around y."""
        return {name: part.move(y[name], z[name]) for name, part in self.parts.items()}

    def slope(self, z: Blocks, moved: Blocks, omega: Blocks) -> Blocks:
        """z' at z; `moved` is move(y, z)."""
        return {name: part.slope(z[name], moved[name], omega[name]) for name, part in self.parts.items()}

    def first_slope(self, y: Blocks, omega: Blocks) -> Blocks:
        """z' at z = 0."""
        return {name: part.first_slope(y[name], omega[name]) for name, part in self.parts.items()}

    def tangent(self, z: Blocks) -> Arrays:
        """The tangents of the move, by name. Raises ModelError where coordinates are of another kind."""
        return {name: part.tangent(z[name]) for name, part in self.parts.items()}

    def deviation(self, e: Blocks, after: Blocks) -> Blocks:
        """The tangents of a small difference of coordinates near the end of a step."""
        return {name: part.deviation(e[name], after[name]) for name, part in self.parts.items()}

    def sizes(self, before: Blocks, after: Blocks) -> Blocks:
        """What the entries of a deviation are compared with."""
        return {name: part.sizes(before[name], after[name]) for name, part in self.parts.items()}

    def settle(self, moved: Blocks) -> Blocks:
        """The end of a step, put back into the group to round-off."""
        return {name: part.settle(moved[name]) for name, part in self.parts.items()}


@functools.lru_cache(maxsize=256)
def coordinates_of(chart: Chart, group: Product) -> StateCoordinates:
    """The coordinates of a state in a chart; the same object for equal arguments."""
    return StateCoordinates({name: chart.coordinates(factor) for name, factor in group.factors.items()})
