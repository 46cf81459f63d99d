"""A method bound to a system and its inputs: the one thing that every loop over steps calls."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax

from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .charts.whole import Blocks, StateCoordinates
from .controls import Signals
from .method import Attempt, Method

__all__ = ["Stepper"]


@dataclasses.dataclass(frozen=True)
class Stepper:
    """A pytree: dynamics and method are structure, the rest are inputs.

    Attributes:
        dynamics, method: what is integrated and how.
        signals: the prepared controls.
        params: the prepared parameters.
    """

    dynamics: Dynamics
    method: Method
    signals: Signals
    params: dict[str, Any]  # not `Arrays`: JAX rebuilds pytrees with stand-ins for arrays

    @property
    def coordinates(self) -> StateCoordinates:
        """How states are stored between steps."""
        return self.method.coordinates(self.dynamics)

    def controls(self, t: jax.Array, h: jax.Array) -> Callable[[jax.Array], Arrays]:
        """The controls as a function of the times within the step from t to t + h."""
        return self.signals.during(self.dynamics, t, h)

    def advance(self, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The stored state after a step of length h."""
        return self.method.advance(self.dynamics, t, y, self.controls(t, h), self.params, h)

    def begin(self, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The rate at the start of a step of about length h."""
        return self.method.begin(self.dynamics, t, y, self.controls(t, h), self.params)

    def attempt(self, t: jax.Array, y: Blocks, rate: Blocks, h: jax.Array) -> Attempt:
        """A step of length h that may be taken back, with its error."""
        return self.method.attempt(self.dynamics, t, y, rate, self.controls(t, h), self.params, h)


jax.tree_util.register_pytree_node(
    Stepper,
    lambda s: ((s.signals, s.params), (s.dynamics, s.method)),
    lambda structure, inputs: Stepper(*structure, *inputs),
)
