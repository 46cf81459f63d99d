"""What every integration method offers to the loops over steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeAlias

import jax

from ..errors import ModelError
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .charts.whole import Blocks, StateCoordinates

__all__ = ["ControlsAt", "Method"]

#: The prepared controls at a stage time.
ControlsAt: TypeAlias = Callable[[jax.Array], Arrays]


class Method(ABC):
    """A one-step method. A value: methods are equal where they mean the same, and hash accordingly.

    A new method subclasses this; `tx.integrate` takes any. Methods that estimate their own error are `EmbeddedMethod`s.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """How tables call it."""

    @property
    @abstractmethod
    def order(self) -> int:
        """The order of convergence."""

    @property
    @abstractmethod
    def evaluations(self) -> int:
        """Evaluations of the right-hand side in a step of `advance`."""

    def check(self, dynamics: Dynamics) -> None:
        """Refuse a system that the method cannot fly. Raises ModelError with the reason; most methods fly all."""
        return

    @abstractmethod
    def coordinates(self, dynamics: Dynamics) -> StateCoordinates:
        """How the states of a system are stored between steps."""

    @abstractmethod
    def advance(
        self, dynamics: Dynamics, t: jax.Array, y: Blocks, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Blocks:
        """The stored state after one step of length h. Pure and traceable."""

    def increment(
        self, dynamics: Dynamics, t: jax.Array, x: Arrays, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Arrays:
        """The tangent eta of one step, name -> (dimension,), so that the step ends at x Exp(eta). For derivatives.

        Raises:
            ModelError: the method has no such form.
        """
        raise ModelError(
            f"{self.name} gives no tangent of its step, which derivatives of steps need.\n"
            "  fix: use tx.RKMK(tableau), or a chart tx.charts.Exponential(...)"
        )

    def step(
        self, dynamics: Dynamics, t: jax.Array, x: Arrays, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Arrays:
        """The state after one step of length h, from prepared arguments. Pure and traceable."""
        local = self.coordinates(dynamics)
        return local.value(self.advance(dynamics, t, local.enter(x), u_at, params, h))
