"""The same system as a plain ODE in quaternions or matrices, as one would write it without groups; diffrax's args."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..errors import InputError, ModelError
from ..groups import Euclidean, Group, SpecialEuclidean, SpecialOrthogonal, quaternions, se3, so3
from ..groups.arrays import unpack, vector
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .controls import OfTime, Signals, controls_of

__all__ = ["Ambient", "Arguments", "read_arguments"]


class Ambient:
    """A system's state and rates in numbers that a general ODE solver can add and scale.

    Poses become [quaternion, position] (7,), rotations quaternions (4,), w first, or both stay matrices; states
    without a group are as they are. Quaternions are read with any length, so their drift does no harm.

    Args:
        dynamics: the compiled system.
        quaternion: quaternions (True) or matrices (False).
    Raises:
        ModelError: a group without such numbers.
    """

    def __init__(self, dynamics: Dynamics, quaternion: bool = True) -> None:
        self.dynamics = dynamics
        self.quaternion = quaternion
        self._coordinates = {name: _coordinates(group, quaternion) for name, group in dynamics.group.factors.items()}

    def to_ambient(self, x: Mapping[str, Any]) -> Arrays:
        """The numbers of a state. Raises InputError as a call of the dynamics does."""
        states = self.dynamics._functions.prepare(0.0, x, reads=()).x
        return {name: own.write(states[name]) for name, own in self._coordinates.items()}

    def from_ambient(self, y: Mapping[str, Any]) -> Arrays:
        """The state of one set of numbers; map over saved times with jax.vmap."""
        return {name: own.read(jnp.asarray(y[name])) for name, own in self._coordinates.items()}

    def vector_field(self, t: Any, y: Mapping[str, Any], args: Any = None) -> Arrays:
        """y' at time t with args = (u, params), both as `integrate` takes them, or None. Traceable."""
        given = read_arguments(self.dynamics, t, self.from_ambient(y), args)
        # A solver that picks its own steps has no step to look into: tables are read at t itself.
        now = given.signals.during(self.dynamics, given.t, jnp.zeros_like(given.t))(given.t)
        return self.rates(y, self.dynamics._functions.vector_field(given.t, given.x, now, given.params))

    def rates(self, y: Mapping[str, Any], velocities: Mapping[str, Any]) -> Arrays:
        """y' of the rates that the dynamics give: body velocities of rotations and poses."""
        return {name: own.rate(jnp.asarray(y[name]), velocities[name]) for name, own in self._coordinates.items()}


class _Coordinates(ABC):
    """How one state is written in plain numbers."""

    @abstractmethod
    def write(self, g: jax.Array) -> jax.Array:
        """The numbers of an element."""

    @abstractmethod
    def read(self, y: jax.Array) -> jax.Array:
        """The element of the numbers."""

    @abstractmethod
    def rate(self, y: jax.Array, velocity: jax.Array) -> jax.Array:
        """y' for a body velocity."""


class _Plain(_Coordinates):
    """A state without a group."""

    def write(self, g: jax.Array) -> jax.Array:
        return g

    def read(self, y: jax.Array) -> jax.Array:
        return y

    def rate(self, y: jax.Array, velocity: jax.Array) -> jax.Array:
        return velocity


class _RotationMatrix(_Plain):
    """R' = R hat(w)."""

    def rate(self, y: jax.Array, velocity: jax.Array) -> jax.Array:
        return so3.compose(y, so3.hat(velocity))


class _PoseMatrix(_Plain):
    """T' = T hat(xi)."""

    def __init__(self, group: SpecialEuclidean) -> None:
        self._order = group.order

    def rate(self, y: jax.Array, velocity: jax.Array) -> jax.Array:
        return se3.compose(y, se3.hat(self._order.to_linear_first(velocity)))


class _RotationQuaternion(_Coordinates):
    """A rotation as a quaternion."""

    def write(self, g: jax.Array) -> jax.Array:
        return quaternions.from_rotation(g)

    def read(self, y: jax.Array) -> jax.Array:
        return quaternions.to_rotation(y)

    def rate(self, y: jax.Array, velocity: jax.Array) -> jax.Array:
        return vector(quaternions.rate(unpack(y), unpack(velocity)))


class _PoseQuaternion(_Coordinates):
    """[q, p] with p' = R(q) v."""

    def __init__(self, group: SpecialEuclidean) -> None:
        self._order = group.order
        self._rotation = _RotationQuaternion()

    def write(self, g: jax.Array) -> jax.Array:
        return jnp.concatenate([self._rotation.write(g[:3, :3]), g[:3, 3]])

    def read(self, y: jax.Array) -> jax.Array:
        return se3.transform(self._rotation.read(y[:4]), y[4:])

    def rate(self, y: jax.Array, velocity: jax.Array) -> jax.Array:
        twist = self._order.to_linear_first(velocity)
        return jnp.concatenate([self._rotation.rate(y[:4], twist[3:]), so3.act(self._rotation.read(y[:4]), twist[:3])])


def _coordinates(group: Group, quaternion: bool) -> _Coordinates:
    if isinstance(group, Euclidean):
        return _Plain()
    if isinstance(group, SpecialOrthogonal):
        return _RotationQuaternion() if quaternion else _RotationMatrix()
    if isinstance(group, SpecialEuclidean):
        return _PoseQuaternion(group) if quaternion else _PoseMatrix(group)
    raise ModelError(f"no plain numbers are known for states on {group.name}")


class Arguments(NamedTuple):
    """What diffrax calls args, read as `integrate` reads u and params: what a step needs besides its length.

    Attributes:
        t: the time.
        x: the state.
        signals: the prepared controls.
        params: the prepared parameters.
    """

    t: jax.Array
    x: Arrays
    signals: Signals
    params: Arrays


def read_arguments(dynamics: Dynamics, t: Any, x: Mapping[str, Any], args: Any) -> Arguments:
    """Time, state and args = (u, params), or None, checked and in one precision. Traceable.

    Raises:
        InputError: args of another form; the rest as a call of the dynamics does.
    """
    if args is not None and not (isinstance(args, (tuple, list)) and len(args) == 2):
        raise InputError(f"args must be (u, params), both as tx.integrate takes them, or None; got {args!r}")
    u, params = (None, None) if args is None else args
    controls = controls_of(u)
    inputs = dynamics._functions.prepare(t, x, controls.sample(t), params)
    if isinstance(controls, OfTime):
        controls = controls.opened(inputs.t)
    return Arguments(inputs.t, dict(inputs.x), controls.prepared(inputs.u, inputs.dtype), dict(inputs.params))
