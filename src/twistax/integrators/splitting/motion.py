"""What a splitting method asks of the free motion of a part of a system, and of sums of very many small numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...expr import State
from ...groups.arrays import Components
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from ..charts.coordinates import Blocks, StoredState

__all__ = ["AllFlows", "Flows", "FreeMotion", "Sum", "begun", "increased", "name_of", "value"]


class Flows(StoredState):
    """The free motion of a part of a system with its parameters, as a product of exact flows.

    The kinetic energy is a sum; `outer` is the exact flow of its main part, `inner` those of the rest. Every method
    takes the whole state and gives its own part of it, by name. Pure and traceable.
    """

    @abstractmethod
    def at_rest(self, y: Blocks) -> Arrays:
        """The states as expressions see them, every velocity zero."""

    @abstractmethod
    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        """The stored states dt later by the main part of the free motion."""

    @abstractmethod
    def inner(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        """The same by the flows of the rest, one after the other; backwards in the opposite order."""

    @abstractmethod
    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        """The stored states after dt under forces that give these rates at rest: momenta change, positions stay."""

    @abstractmethod
    def settle(self, y: Blocks) -> Blocks:
        """The stored states, put back into the group to round-off."""


class AllFlows(Flows):
    """The flows of all parts: they share no state, so their flows commute."""

    def __init__(self, parts: Sequence[Flows]) -> None:
        self.parts = tuple(parts)

    def enter(self, x: Arrays) -> Blocks:
        return self._joined(lambda part: part.enter(x))

    def value(self, y: Blocks) -> Arrays:
        return {name: value for part in self.parts for name, value in part.value(y).items()}

    def at_rest(self, y: Blocks) -> Arrays:
        return {name: value for part in self.parts for name, value in part.at_rest(y).items()}

    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        return self._joined(lambda part: part.outer(y, dt))

    def inner(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        return self._joined(lambda part: part.inner(y, dt, backwards))

    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        return self._joined(lambda part: part.kick(y, rates, dt))

    def settle(self, y: Blocks) -> Blocks:
        return self._joined(lambda part: part.settle(y))

    def _joined(self, blocks: Callable[[Flows], Blocks]) -> Blocks:
        return {name: block for part in self.parts for name, block in blocks(part).items()}


class FreeMotion(ABC):
    """Which states of a system move freely between kicks, and how. A value: equal where it means the same, hashable.

    Attributes:
        position: the name of the state that the free motion moves.
        velocity: that of the state that forces change, a velocity or a momentum.
        parameters: the names of the parameters that the free motion reads.
    """

    position: str
    velocity: str
    parameters: tuple[str, ...]

    @abstractmethod
    def check(self, dynamics: Dynamics) -> None:
        """Whether states and parameters are of the right kind. Raises ModelError, which names what is not."""

    @abstractmethod
    def rates(self, dynamics: Dynamics, x: Arrays, params: Arrays) -> Arrays:
        """The rates of the two states in free motion, in plain form: what a system is held against."""

    @abstractmethod
    def flows(self, dynamics: Dynamics, params: Arrays) -> Flows:
        """The flows of the free motion."""


def name_of(leaf: Any) -> str:
    """The name of a state given as such or by its name. Raises ModelError for anything else."""
    if isinstance(leaf, State):
        return leaf.name
    if not isinstance(leaf, str):
        raise ModelError(f"a body expects its states or their names, got {leaf!r}")
    return leaf


# ---- sums: what rounding takes away is kept beside them, and added the next time ----------------------------------

#: Values, and what of their last increments is not in them, as many each.
Sum = Components


def begun(values: Components) -> Sum:
    """A sum that starts at these values."""
    return (*values, *(jnp.zeros_like(value) for value in values))


def value(total: Sum) -> Components:
    """The values of a sum."""
    return total[: len(total) // 2]


def increased(total: Sum, increments: Components) -> Sum:
    """The sum with increments added. Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section
    VIII.5 (compensated summation).
    """
    values, lost = value(total), total[len(total) // 2 :]
    wanted = tuple(d + e for d, e in zip(increments, lost, strict=True))
    new = tuple(x + d for x, d in zip(values, wanted, strict=True))
    return (*new, *(d - (y - x) for d, y, x in zip(wanted, new, values, strict=True)))
