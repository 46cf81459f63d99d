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
from .method import Method

__all__ = ["Stepper"]


@dataclasses.dataclass(frozen=True)
class Stepper:
    """Steps of length h from t0. A pytree: dynamics and method are structure, the rest are inputs.

    Attributes:
        dynamics, method: what is integrated and how.
        signals: the prepared controls.
        params: the prepared parameters.
        t0, h: the start and the length of a step in s.
    """

    dynamics: Dynamics
    method: Method
    signals: Signals
    params: Arrays
    t0: Any
    h: Any

    def time(self, i: jax.Array) -> jax.Array:
        """The start of step i, computed afresh so that it does not drift."""
        return self.t0 + i.astype(self.t0.dtype) * self.h

    def controls(self, t: jax.Array, h: jax.Array) -> Callable[[jax.Array], Arrays]:
        """The controls as a function of the times within the step from t to t + h."""
        return self.signals.during(self.dynamics, t, h)

    @property
    def coordinates(self) -> StateCoordinates:
        """How states are stored between steps."""
        return self.method.coordinates(self.dynamics)

    def step(self, i: jax.Array, y: Blocks, share: jax.Array | float = 1.0) -> Blocks:
        """The stored state after step i, or after a share of it, from the one at its start."""
        t, h = self.time(i), share * self.h
        return self.method.advance(self.dynamics, t, y, self.controls(t, h), self.params, h)


jax.tree_util.register_pytree_node(
    Stepper,
    lambda s: ((s.signals, s.params, s.t0, s.h), (s.dynamics, s.method)),
    lambda structure, inputs: Stepper(*structure, *inputs),
)
