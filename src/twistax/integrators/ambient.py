"""A system as a plain ODE in quaternions or matrices, and the arguments `args` of diffrax."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from ..errors import InputError
from ..groups.ambient import ambient_numbers
from ..system.dynamics import Arrays, Dynamics, need_compiled
from .controls import OfTime, controls_of


class AmbientSystem:
    """A system's state and rates as arrays that a general ODE solver can add and scale.

    Poses become [quaternion, position] (7,), and rotations become quaternions (4,), w first; or both remain matrices.
    Other states are unchanged. Quaternions need not have unit length, so their drift has no effect.

    Args:
        dynamics: the compiled system.
        quaternion: quaternions (True) or matrices (False).
    Raises:
        ModelError: a system that is not compiled.
    """

    def __init__(self, dynamics: Dynamics, quaternion: bool = True) -> None:
        need_compiled("ambient_term", dynamics)
        self.dynamics = dynamics
        self._numbers = {name: ambient_numbers(group, quaternion) for name, group in dynamics.group.factors.items()}

    def to_ambient(self, x: Mapping[str, Any]) -> Arrays:
        """The arrays of a state. Raises InputError as a call of the dynamics does."""
        states = self.dynamics.functions.prepare(0.0, x, reads=()).x
        return {name: numbers.write(states[name]) for name, numbers in self._numbers.items()}

    def from_ambient(self, y: Mapping[str, Any]) -> Arrays:
        """The state of one set of arrays; use jax.vmap for saved times."""
        return {name: numbers.read(jnp.asarray(y[name])) for name, numbers in self._numbers.items()}

    def vector_field(self, t: Any, y: Mapping[str, Any], args: Any = None) -> Arrays:
        """y' at time t with args = (u, params), both as `integrate` takes them, or None. Traceable."""
        return self.rates(y, read_arguments(self.dynamics, t, self.from_ambient(y), args).rates(self.dynamics))

    def rates(self, y: Mapping[str, Any], velocities: Mapping[str, Any]) -> Arrays:
        """y' from the rates of the dynamics, which are body velocities for rotations and poses."""
        return {name: numbers.rate(jnp.asarray(y[name]), velocities[name]) for name, numbers in self._numbers.items()}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Arguments:
    """Time, state, controls and parameters: the `args` of diffrax, read as `integrate` reads u and params."""

    t: Any
    x: Any
    signals: Any  # prepared
    params: Any  # prepared

    def rates(self, dynamics: Dynamics, t: jax.Array | None = None, h: jax.Array | None = None) -> Arrays:
        """The rates at this point, for controls within the step from t to t + h.

        A solver that chooses its own step lengths does not know the step; without one, tables are evaluated at the time
        itself.
        """
        start, length = (self.t, jnp.zeros_like(self.t)) if t is None or h is None else (t, h)
        now = self.signals.during(dynamics, start, length)(self.t)
        return dynamics.functions.vector_field(self.t, self.x, now, self.params)


def read_arguments(dynamics: Dynamics, t: Any, x: Mapping[str, Any], args: Any) -> Arguments:
    """Time, state and args = (u, params), or None, checked and in one precision. Traceable. Raises InputError."""
    if args is not None and not (isinstance(args, (tuple, list)) and len(args) == 2):
        raise InputError(f"args expects (u, params), both in the form of tx.integrate, or None; got {args!r}")
    u, params = (None, None) if args is None else args
    controls = controls_of(u)
    inputs = dynamics.functions.prepare(t, x, controls.sample(t), params)
    if isinstance(controls, OfTime):
        controls = controls.opened(inputs.t)
    return Arguments(inputs.t, dict(inputs.x), controls.prepared(inputs.u, inputs.dtype), dict(inputs.params))
