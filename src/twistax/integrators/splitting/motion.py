"""What a splitting method asks of the free motion of a part of a system, and of sums of very many small numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...expr import State
from ...groups.arrays import Components
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from ..charts import Blocks, StoredState


class Flows(StoredState):
    """The free motion of a part of a system with its parameters, as a product of exact flows.

    The kinetic energy is a sum; `outer` is the exact flow of its main part, `inner` those of the rest. `enter`, `value`
    and `at_rest` give the part's own states; the flows give all stored states back. Pure and traceable.
    """

    @abstractmethod
    def at_rest(self, y: Blocks) -> Arrays:
        """The states as expressions see them, every velocity zero."""

    @abstractmethod
    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        """The stored states dt later by the main part of the free motion."""

    def inner(self, y: Blocks, dt: jax.Array, backwards: bool) -> Blocks:
        """The same by the flows of the rest, one after the other; backwards in the opposite order."""
        return y

    @abstractmethod
    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        """The stored states after dt under forces that give these rates at rest: momenta change, positions stay."""

    def settle(self, y: Blocks) -> Blocks:
        """The stored states, put back into the group to round-off."""
        return y


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


# ---- sums: values, then what of their last increments is not in them, which is added the next time -----------------


def begun(values: Components) -> Components:
    """A sum that starts at these values."""
    return (*values, *(jnp.zeros_like(value) for value in values))


def value(total: Components) -> Components:
    """The values of a sum."""
    return total[: len(total) // 2]


def increased(total: Components, increments: Components) -> Components:
    """The sum with increments added.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section VIII.5 (compensated summation).
    """
    values, lost = value(total), total[len(total) // 2 :]
    wanted = tuple(d + e for d, e in zip(increments, lost, strict=True))
    new = tuple(x + d for x, d in zip(values, wanted, strict=True))
    return (*new, *(d - (y - x) for d, y, x in zip(wanted, new, values, strict=True)))
