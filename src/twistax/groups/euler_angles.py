"""Euler angles of all sequences of axes: rotations from angles, and angles from rotations."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from twistax.errors import InputError

#: The sequence of roll, pitch, yaw: successive rotations about the fixed axes x, y, z.
ROLL_PITCH_YAW = "xyz"


class Turns(NamedTuple):
    """R = E_i(a) E_j(b) E_l(c) with E_n(t) the rotation by t about axis n, and the positions of a, b, c among the three
    angles.
    """

    axes: tuple[int, int, int]
    places: tuple[int, int, int]

    @property
    def other(self) -> int:
        """The axis that is neither i nor j."""
        return 3 - self.axes[0] - self.axes[1]

    @property
    def sign(self) -> float:
        """1.0 where i, j and the other axis are right-handed, else -1.0."""
        return 1.0 if (self.axes[1] - self.axes[0]) % 3 == 1 else -1.0


def turns(sequence: str) -> Turns:
    """The rotations of a sequence: "xyz" about fixed axes, first x; "ZYX" about body axes, first z.

    Raises:
        InputError: not three letters of one case, or an axis that is repeated immediately.
    """
    axes = tuple("xyz".find(letter) for letter in str(sequence).lower())
    one_case = isinstance(sequence, str) and sequence in (sequence.lower(), sequence.upper())
    if len(axes) != 3 or -1 in axes or not one_case or axes[1] in (axes[0], axes[2]):
        raise InputError(
            "a sequence of Euler angles consists of three axes in one case, without an immediate "
            f"repetition, got {sequence!r}.\n"
            '  fix: use lower-case letters for fixed axes, "xyz", or capital letters for body axes, "ZYX" or "ZXZ"'
        )
    return Turns(axes, (0, 1, 2)) if sequence.isupper() else Turns(axes[::-1], (2, 1, 0))


@functools.partial(jax.jit, static_argnames="sequence", inline=True)
def rotation(angles: Array, sequence: str) -> Array:
    """The rotation matrix of three angles in rad, in the order of the sequence."""
    axes, places = turns(sequence)
    columns = list(jnp.eye(3, dtype=angles.dtype))
    for axis, place in zip(axes, places, strict=True):
        k, m = (axis + 1) % 3, (axis + 2) % 3
        c, s = jnp.cos(angles[place]), jnp.sin(angles[place])
        columns[k], columns[m] = c * columns[k] + s * columns[m], c * columns[m] - s * columns[k]
    return jnp.stack(columns, axis=1)


@functools.partial(jax.jit, static_argnames="sequence", inline=True)
def angles(R: Array, sequence: str) -> Array:
    """Three angles in rad, in the order of the sequence, of a rotation matrix.

    The middle angle is in [-pi/2, pi/2], or for a sequence such as "ZXZ" in [0, pi]; the others are in [-pi, pi]. If it
    is at an end of its range (gimbal lock), the axes of the two others coincide, and only their sum or difference is
    defined: then c, the first angle about fixed axes and the last one about body axes, is 0, and its derivative and
    that of the middle angle are 0, too. Otherwise a is computed after c has been removed, so that the angles reproduce
    R to round-off also close to gimbal lock.

    Source: the entries of E_i(a) E_j(b) E_l(c), multiplied out.
    """
    (i, j, last), places = turns(sequence)
    k, sign = turns(sequence).other, turns(sequence).sign
    # sin c and cos c times `level`, which is cos b, or sin b where the last axis is the first; and the column that
    # E_l(-c) turns towards e_j.
    if last == i:
        sine, cosine, turned = R[i, j], sign * R[i, k], -sign * R[:, k]
    else:
        sine, cosine, turned = -sign * R[i, j], R[i, i], sign * R[:, i]
    square = sine * sine + cosine * cosine
    locked = square < (4.0 * float(jnp.finfo(R.dtype).eps)) ** 2
    level = jnp.where(locked, 0.0, jnp.sqrt(jnp.where(locked, 1.0, square)))
    c = jnp.where(locked, 0.0, jnp.arctan2(jnp.where(locked, 0.0, sine), jnp.where(locked, 1.0, cosine)))
    b = jnp.arctan2(level, R[i, i]) if last == i else jnp.arctan2(sign * R[i, k], level)
    column = jnp.cos(c) * R[:, j] + jnp.sin(c) * turned
    a = jnp.arctan2(sign * column[k], column[j])
    return jnp.stack([angle for _, angle in sorted(zip(places, (a, b, c), strict=True), key=lambda pair: pair[0])])
