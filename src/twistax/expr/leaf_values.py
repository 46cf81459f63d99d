"""What leaves are given: shapes, groups, values and bounds, checked and made read-only."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from ..errors import ModelError, ShapeError
from ..groups import Euclidean, Group, Order, SpecialEuclidean
from .node import Shape


def constant_of(value: Any) -> tuple[Shape, np.ndarray]:
    """The shape and the read-only array of a Constant. Raises ModelError for what is no real number or array."""
    try:
        array = np.array(value)
    except jax.errors.TracerArrayConversionError:
        raise ModelError(
            "a traced JAX value cannot become a Constant of an expression.\n"
            "  fix: declare a tx.Parameter and pass the value through params"
        ) from None
    except ValueError as error:
        raise ModelError(f"cannot make a Constant of {value!r}: {error}") from None
    if array.dtype != bool:
        if array.dtype.kind not in "iuf":
            raise ModelError(
                f"a Constant must be a real number or array, got {type(value).__name__} of dtype {array.dtype}.\n"
                "  fix: collect expressions with tx.Stack or tx.Concat"
            )
        array = array.astype(np.float64)
    array.setflags(write=False)
    return array.shape, array


def shape_of(name: str, shape: Shape | int) -> Shape:
    """A shape as a tuple. Raises ModelError."""
    shape = (shape,) if isinstance(shape, (int, np.integer)) else tuple(shape)
    if not all(isinstance(n, (int, np.integer)) and n >= 1 for n in shape):
        raise ModelError(f"{name!r}: a shape is a tuple of positive whole numbers, got {shape}")
    return tuple(int(n) for n in shape)


def group_of(name: str, shape: Shape | int | None, group: Group | None, order: Order | None) -> Group:
    """The group of a state, in its order. Raises ModelError, ShapeError."""
    if group is None:
        if order is not None:
            raise ModelError(f"State {name!r}: order= is for pose states (group=tx.SE3); the Lie nodes carry their own")
        return Euclidean(shape_of(name, () if shape is None else shape))
    if not isinstance(group, Group):
        raise ModelError(f"State {name!r}: group must be tx.SO3 or tx.SE3, got {group!r}")
    if shape is not None and shape_of(name, shape) != group.shape:
        raise ShapeError(
            f"State {name!r} on {group.name} has shape {group.shape}, got {shape}",
            hint="leave shape out: the group brings its own",
        )
    if order is None:
        return group
    if not isinstance(group, SpecialEuclidean):
        raise ModelError(f"State {name!r}: order= concerns poses (tx.SE3), not {group.name}")
    return group.with_order(order)


def value_of(name: str, what: str, value: Any, shape: Shape) -> np.ndarray | None:
    """A float64 copy broadcast to the shape, read-only; None entries become NaN (free)."""
    if value is None:
        return None
    array = np.asarray(value)
    if array.dtype == object:
        array = np.array([np.nan if v is None else v for v in array.ravel()], float).reshape(array.shape)
    try:
        array = np.broadcast_to(array.astype(np.float64), shape).copy()
    except (ValueError, TypeError):
        raise ShapeError(f"{name!r}: {what} expects shape {shape}, got {np.shape(value)}") from None
    array.setflags(write=False)
    return array


_FREE_ENDS = {"min": -np.inf, "max": np.inf}


def bounds_of(name: str, shape: Shape, low: Any, high: Any) -> dict[str, np.ndarray | None]:
    """min and max; entries that are None are free. Raises ShapeError, ModelError."""
    found = {}
    for what, value in (("min", low), ("max", high)):
        array = value_of(name, what, value, shape)
        if array is not None and np.isnan(array).any():
            array = np.where(np.isnan(array), _FREE_ENDS[what], array)
            array.setflags(write=False)
        found[what] = array
    low, high = found["min"], found["max"]
    if low is not None and high is not None and (low > high).any():
        raise ModelError(f"{name!r}: min {low} is above max {high}")
    return found


#: How far a given rotation may be from orthonormal before it is refused.
_ROTATION_TOLERANCE = 1e-6


#: How far a constant may be from orthonormal to count as a rotation in rewrites.
ROUND_OFF = 1e-12


@functools.cache
def _compiled_defect(group: Group) -> Callable[..., jax.Array]:
    # Compiled as one, once: a dozen eager operations would each be compiled alone.
    return jax.jit(group.defect)


def defect_of(value: np.ndarray, group: Group) -> float:
    """How far a value is from its group."""
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        return float(_compiled_defect(group)(jax.numpy.asarray(value)))


def boundary_of(name: str, what: str, value: Any, group: Group) -> np.ndarray | None:
    """A start or an end: an element of a group, or numbers of which some may be None. Raises ShapeError, ModelError."""
    if value is None or isinstance(group, Euclidean):
        return value_of(name, what, value, group.shape)
    if np.shape(value) != group.shape:
        raise ShapeError(f"{name!r}: {what} expects shape {group.shape}, got {np.shape(value)}")
    array = np.array(value, dtype=np.float64)
    defect = defect_of(array, group)
    if not defect <= _ROTATION_TOLERANCE:
        raise ModelError(
            f"{name!r}: {what} is not an element of {group.name} (off by {defect:.2g}).\n"
            "  fix: build it with tx.pose(position=..., euler=... or quaternion=...)"
        )
    array.setflags(write=False)
    return array


def guess_of(name: str, value: Any, shape: Shape) -> np.ndarray | None:
    """A guess, or n of them. Raises ShapeError."""
    if value is None:
        return None
    array = np.array(value, dtype=np.float64)
    if array.shape != shape and array.shape[1:] != shape:
        raise ShapeError(f"{name!r}: guess expects shape {shape} or (n, *{shape}), got {array.shape}")
    array.setflags(write=False)
    return array


def scale_of(name: str, value: Any, group: Group) -> np.ndarray | None:
    """Positive sizes by tangent entry. Raises ShapeError, ModelError."""
    shape = group.shape if isinstance(group, Euclidean) else (group.dimension,)
    array = value_of(name, "scale", value, shape)
    if array is not None and not (array > 0).all():
        raise ModelError(f"{name!r}: scale must be positive, got {array}")
    return array
