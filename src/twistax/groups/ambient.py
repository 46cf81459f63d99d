"""Group elements as plain numbers that an ODE solver can add and scale: quaternions, positions, matrix entries."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from twistax.groups import quaternions, se3, so3
from twistax.groups.arrays import unpack, vector
from twistax.groups.group import Group

#: The suffixes of the numbers of a rotation and of a position, after a state's name and a dot, as in tables.
_QUATERNION, _POSITION = ("qw", "qx", "qy", "qz"), ("x", "y", "z")


class AmbientNumbers(NamedTuple):
    """A state as plain numbers.

    Attributes:
        write: an element as numbers.
        read: numbers as an element; quaternions of any length.
        rate: the rate of numbers for a body velocity.
        labels: names of the numbers; empty if they are the entries of the element.
        shape: shape of the numbers.
    """

    write: Callable[[jax.Array], jax.Array]
    read: Callable[[jax.Array], jax.Array]
    rate: Callable[[jax.Array, jax.Array], jax.Array]
    labels: tuple[str, ...]
    shape: tuple[int, ...]

    def beside(self, y: jax.Array, before: jax.Array) -> jax.Array:
        """The numbers y, or those with the opposite sign of the quaternion, whichever are closer to `before`."""
        if not self.labels:
            return y
        q = jnp.where(jnp.sum(y[:4] * before[:4]) < 0.0, -y[:4], y[:4])
        return jnp.concatenate([q, y[4:]])


def ambient_numbers(group: Group, quaternion: bool = True) -> AmbientNumbers:
    """Rotations as quaternions (w, x, y, z) and poses as [quaternion, position], or both as matrices; other states
    unchanged.
    """
    if not (quaternion and group.rigid):
        return AmbientNumbers(_same, _same, group.entry_rate, (), group.shape)
    if group.dimension == 3:
        return AmbientNumbers(quaternions.from_rotation, quaternions.to_rotation, _turned, _QUATERNION, (4,))
    return AmbientNumbers(
        lambda g: jnp.concatenate([quaternions.from_rotation(g[:3, :3]), g[:3, 3]]),
        lambda y: se3.transform(quaternions.to_rotation(y[:4]), y[4:]),
        lambda y, V: _moved(y, group.to_linear_first(V)),
        (*_QUATERNION, *_POSITION),
        (7,),
    )


def _same(y: jax.Array) -> jax.Array:
    return y


def _turned(q: jax.Array, velocity: jax.Array) -> jax.Array:
    return vector(quaternions.rate(unpack(q), unpack(velocity)))


def _moved(y: jax.Array, twist: jax.Array) -> jax.Array:
    return jnp.concatenate([_turned(y[:4], twist[3:]), so3.act(quaternions.to_rotation(y[:4]), twist[:3])])
