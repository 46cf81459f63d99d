"""A method bound to a system and its inputs: the one thing that every loop over steps calls."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ..lowering import JAX, Dynamics
from ..lowering.dynamics import Arrays
from .charts.whole import Blocks, StateCoordinates, StoredState
from .controls import Signals
from .method import Attempt, Carry, Method
from .tolerances import Tolerances

__all__ = ["Stepper"]


def _inward(time: jax.Array, t: jax.Array, h: jax.Array) -> jax.Array:
    """The time, or some units of round-off inside of the step from t to t + h where it is one of its ends."""
    small = 4.0 * jnp.finfo(time.dtype).eps
    hair = jax.lax.stop_gradient(jnp.maximum(small * jnp.abs(t), small * jnp.abs(t + h)))
    first, last = t + hair, t + h - hair
    return jnp.where(time < first, first, jnp.where(time > last, last, time))


@dataclasses.dataclass(frozen=True)
class Stepper:
    """A pytree: dynamics and method are structure, the rest are inputs.

    Attributes:
        dynamics, method: what is integrated and how.
        signals: the prepared controls.
        params: the prepared parameters.
        inward: whether rates see times just inside of a step in place of its ends, because they may jump there: a step
            that ends at a jump must not see the other side.
    """

    dynamics: Dynamics
    method: Method
    signals: Signals
    params: dict[str, Any]  # not `Arrays`: JAX rebuilds pytrees with stand-ins for arrays
    inward: bool = False

    @property
    def coordinates(self) -> StateCoordinates:
        """Coordinates around the start of a step, of methods that have them."""
        return self.method.coordinates(self.dynamics)

    @property
    def stored(self) -> StoredState:
        """How states are stored between steps."""
        return self.method.stored(self.dynamics, self.params)

    @property
    def in_arrays(self) -> Stepper:
        """The same, rates as arrays: for what is written out as scalars as a whole."""
        return dataclasses.replace(self, dynamics=Dynamics(self.dynamics._functions.run_by(JAX())))

    def controls(self, t: jax.Array, h: jax.Array) -> Callable[[jax.Array], Arrays]:
        """The controls as a function of the times within the step from t to t + h."""
        during = self.signals.during(self.dynamics, t, h)
        return (lambda time: during(_inward(time, t, h))) if self.inward else during

    def advance(self, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The stored state after a step of length h."""
        return self.method.advance(self._system(t, h), t, y, self.controls(t, h), self.params, h)

    def follow(self, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> Attempt:
        """A step of fixed length h after another one."""
        return self.method.follow(self._system(t, h), t, y, carry, self.controls(t, h), self.params, h)

    def rate(self, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The rate at the start of a step of about length h."""
        return self.method.rate(self._system(t, h), t, y, self.controls(t, h), self.params)

    def resume(self, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> Carry:
        """What a step of about length h begins with where rates may have jumped."""
        return self.method.resume(self._system(t, h), t, y, carry, self.controls(t, h), self.params)

    def attempt(self, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array, tolerances: Tolerances) -> Attempt:
        """A step of length h that may be taken back, with its error."""
        system, controls = self._system(t, h), self.controls(t, h)
        return self.method.attempt(system, t, y, carry, controls, self.params, h, tolerances)

    def _system(self, t: jax.Array, h: jax.Array) -> Dynamics:
        if not self.inward:
            return self.dynamics
        return Dynamics(self.dynamics._functions.on_clock(lambda time: _inward(time, t, h)))


jax.tree_util.register_pytree_node(
    Stepper,
    lambda s: ((s.signals, s.params), (s.dynamics, s.method, s.inward)),
    lambda structure, inputs: Stepper(*structure[:2], *inputs, inward=structure[2]),
)
