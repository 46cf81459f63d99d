"""Building poses from the attitudes people write down, and reading them again."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from twistax.errors import InputError, ShapeError
from twistax.groups import quaternions, se3
from twistax.groups.arrays import Input, element, floats, known, of_shape


def _rotation_of(function: str, R: Input) -> Array:
    (R,) = floats(R, names=[f"{function}: R"])
    if R.shape not in ((3, 3), (4, 4)):
        raise ShapeError(f"{function} expects R with shape (3, 3) or (4, 4), got {R.shape}")
    return element(function, "R", R)[:3, :3]


def _from_rotation(R: Array) -> Array:
    return element("pose", "rotation", R, float(np.sqrt(jnp.finfo(R.dtype).eps)))


def _from_quaternion(q: Array) -> Array:
    values = known(q)
    if values is not None and not values.any():
        raise InputError(f"pose expects a quaternion (w, x, y, z) that is not zero, got {values.tolist()}")
    # Dividing by the largest component first keeps the squares from under- or overflowing.
    return quaternions.to_rotation(q / jnp.max(jnp.abs(q)))


def _from_euler(angles: Array) -> Array:
    roll, pitch, yaw = 0.5 * angles
    o = jnp.zeros_like(roll)
    about_z = jnp.stack([jnp.cos(yaw), o, o, jnp.sin(yaw)])
    about_y = jnp.stack([jnp.cos(pitch), o, jnp.sin(pitch), o])
    about_x = jnp.stack([jnp.cos(roll), jnp.sin(roll), o, o])
    return quaternions.to_rotation(quaternions.hamilton(quaternions.hamilton(about_z, about_y), about_x))


_ATTITUDES = {
    "rotation": ((3, 3), _from_rotation),
    "quaternion": ((4,), _from_quaternion),
    "euler": ((3,), _from_euler),
}


def pose(
    position: Input | None = None,
    rotation: Input | None = None,
    quaternion: Input | None = None,
    euler: Input | None = None,
) -> Float[Array, "4 4"]:
    """The pose [R p; 0 1] from a position and at most one attitude; what is left out is zero or the identity.

    rotation: (3, 3), orthonormal, determinant +1. quaternion: (w, x, y, z), normalised here. euler: (roll, pitch, yaw)
    in rad, R = Rz(yaw) Ry(pitch) Rx(roll). The precision follows the inputs.
    Raises ShapeError for a wrong shape, InputError for two attitudes, numbers that are not finite, a zero quaternion or
    a matrix that is not a rotation. Where these are traced the pose is NaN.
    """
    attitudes = {"rotation": rotation, "quaternion": quaternion, "euler": euler}
    given = {name: value for name, value in attitudes.items() if value is not None}
    if len(given) > 1:
        raise InputError(f"pose expects at most one attitude, got {' and '.join(given)}\n  fix: keep one of them")
    place = (0.0, 0.0, 0.0) if position is None else position
    if not given:
        (p,) = of_shape("pose", {"position": (3,)}, place)
        _check_finite("position", p)
        return se3.transform(jnp.eye(3, dtype=p.dtype), p)
    ((name, value),) = given.items()
    shape, build = _ATTITUDES[name]
    p, attitude = of_shape("pose", {"position": (3,), name: shape}, place, value)
    for what, array in (("position", p), (name, attitude)):
        _check_finite(what, array)
    return se3.transform(build(attitude), p)


def _check_finite(what: str, array: Array) -> None:
    values = known(array)
    if values is not None and not np.isfinite(values).all():
        raise InputError(f"pose expects {what} to be finite, got {values.tolist()}")


def quaternion(R: Input) -> Float[Array, "4"]:
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation (3, 3) or a pose (4, 4).

    At exactly a half turn its first non-zero component is positive. Raises ShapeError; InputError for no rotation.
    """
    return quaternions.from_rotation(_rotation_of("quaternion", R))


def euler(R: Input) -> Float[Array, "3"]:
    """(roll, pitch, yaw) in rad with R = Rz(yaw) Ry(pitch) Rx(roll), of a rotation (3, 3) or a pose (4, 4).

    |pitch| <= pi/2. At gimbal lock, where only yaw -+ roll is defined, roll = 0. Yaw is read after roll has been taken
    out, so that the three angles give R back to round-off close to the lock too. Raises ShapeError.
    """
    R = _rotation_of("euler", R)
    level = jnp.hypot(R[2, 1], R[2, 2])
    locked = level < 4.0 * float(jnp.finfo(R.dtype).eps)
    roll = jnp.where(locked, 0.0, jnp.arctan2(jnp.where(locked, 0.0, R[2, 1]), jnp.where(locked, 1.0, R[2, 2])))
    s, c = jnp.sin(roll), jnp.cos(roll)
    pitch = jnp.arctan2(-R[2, 0], jnp.where(locked, 0.0, level))
    yaw = jnp.arctan2(s * R[0, 2] - c * R[0, 1], c * R[1, 1] - s * R[1, 2])
    return jnp.stack([roll, pitch, yaw])


def rotation_from_quaternion(q: Input) -> Float[Array, "3 3"]:
    """The rotation matrix of a quaternion (w, x, y, z) of any length but zero. Raises ShapeError."""
    (q,) = of_shape("rotation_from_quaternion", {"q": (4,)}, q)
    return quaternions.to_rotation(q)


def quaternion_product(p: Input, q: Input) -> Float[Array, "4"]:
    """The Hamilton product p q of (w, x, y, z) quaternions; R(p q) = R(p) R(q). Raises ShapeError."""
    return quaternions.hamilton(*of_shape("quaternion_product", {"p": (4,), "q": (4,)}, p, q))
