"""What a splitting method asks of the free motion of a part of a system."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import jax

from ...errors import ModelError
from ...expr import State
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from ..charts.whole import Blocks, StoredState

__all__ = ["Flows", "FreeMotion", "name_of"]


class Flows(StoredState):
    """The free motion of a part of a system with its parameters, as a product of exact flows.

    The kinetic energy is a sum; `outer` is the exact flow of its main part, `inner` and `inner_backwards` those of the
    rest in a row. Every method takes the whole state and gives its own part of it, by name. Pure and traceable.
    """

    @abstractmethod
    def at_rest(self, y: Blocks) -> Arrays:
        """The states as expressions see them, every velocity zero."""

    @abstractmethod
    def outer(self, y: Blocks, dt: jax.Array) -> Blocks:
        """The stored states dt later by the main part of the free motion."""

    @abstractmethod
    def inner(self, y: Blocks, dt: jax.Array) -> Blocks:
        """The same by the flows of the rest, in a row."""

    @abstractmethod
    def inner_backwards(self, y: Blocks, dt: jax.Array) -> Blocks:
        """The same in the opposite row."""

    @abstractmethod
    def kick(self, y: Blocks, rates: Arrays, dt: jax.Array) -> Blocks:
        """The stored states after dt under forces that give these rates at rest: momenta change, positions stay."""

    @abstractmethod
    def settle(self, y: Blocks) -> Blocks:
        """The stored states, put back into the group to round-off."""


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
