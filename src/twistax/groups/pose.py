"""Poses from several representations of attitude, and inverse conversions."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection
from typing import Any

import jax.numpy as jnp
import numpy as np

from twistax.errors import InputError, ShapeError
from twistax.groups import euler_angles, quaternions, se3, so3
from twistax.groups.annotations import Array, Float
from twistax.groups.arrays import Input, compiled, element, floats, known, of_shape
from twistax.groups.euler_angles import ROLL_PITCH_YAW
from twistax.units import metres, radians, same_unit


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
        raise InputError(f"pose expects a nonzero quaternion (w, x, y, z), got {values.tolist()}")
    return _from_nonzero(q)


@compiled
def _from_nonzero(q: Array) -> Array:
    # Dividing by the largest component first keeps the squares from under- or overflowing.
    return quaternions.to_rotation(q / jnp.max(jnp.abs(q)))


def pose(
    position: Input | None = None,
    rotation: Input | None = None,
    quaternion: Input | None = None,
    euler: Input | None = None,
    rotation_vector: Input | None = None,
    sequence: str = ROLL_PITCH_YAW,
) -> Float[Array, "4 4"]:
    """The pose [R p; 0 1] of numbers; `twistax.pose`, which also accepts expressions, documents the arguments."""
    attitudes: dict[str, tuple[Any, tuple[int, ...], Callable[[Array], Array]]] = {
        "rotation": (rotation, (3, 3), _from_rotation),
        "quaternion": (quaternion, (4,), _from_quaternion),
        "euler": (euler, (3,), functools.partial(euler_angles.rotation, sequence=sequence)),
        "rotation_vector": (rotation_vector, (3,), so3.exp),
    }
    same_unit("pose: position", position, metres)
    same_unit("pose: euler", euler, radians)
    same_unit("pose: rotation_vector", rotation_vector, radians)
    used = {name: entry for name, entry in attitudes.items() if entry[0] is not None}
    one_attitude(used)
    euler_angles.turns(sequence)  # which is checked without angles too
    place = (0.0, 0.0, 0.0) if position is None else position
    if not used:
        (p,) = of_shape("pose", {"position": (3,)}, place)
        _check_finite("position", p)
        return se3.transform(jnp.asarray(np.eye(3), p.dtype), p)
    ((name, (value, shape, build)),) = used.items()
    p, attitude = of_shape("pose", {"position": (3,), name: shape}, place, value)
    for what, array in (("position", p), (name, attitude)):
        _check_finite(what, array)
    return se3.transform(build(attitude), p)


def one_attitude(attitudes: Collection[str]) -> None:
    """Raise InputError for more than one attitude."""
    if len(attitudes) > 1:
        raise InputError(f"pose expects at most one attitude, got {' and '.join(attitudes)}\n  fix: keep one of them")


def _check_finite(what: str, array: Array) -> None:
    values = known(array)
    if values is not None and not np.isfinite(values).all():
        raise InputError(f"pose expects {what} to be finite, got {values.tolist()}")


def quaternion(R: Input) -> Float[Array, "4"]:
    """`twistax.lie.quaternion` for numbers."""
    return quaternions.from_rotation(_rotation_of("quaternion", R))


def euler(R: Input, sequence: str = ROLL_PITCH_YAW) -> Float[Array, "3"]:
    """`twistax.lie.euler` for numbers."""
    return euler_angles.angles(_rotation_of("euler", R), sequence)


def rotation_from_quaternion(q: Input) -> Float[Array, "3 3"]:
    """The rotation matrix of a quaternion (w, x, y, z) of any nonzero length. Raises ShapeError for other shapes."""
    (q,) = of_shape("rotation_from_quaternion", {"q": (4,)}, q)
    return quaternions.to_rotation(q)


def quaternion_product(p: Input, q: Input) -> Float[Array, "4"]:
    """The Hamilton product p q of (w, x, y, z) quaternions; R(p q) = R(p) R(q). Raises ShapeError for other shapes."""
    return quaternions.hamilton(*of_shape("quaternion_product", {"p": (4,), "q": (4,)}, p, q))
