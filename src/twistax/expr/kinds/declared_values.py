"""Checks of the declared values of leaves: shape, group, bounds, guess and boundary values."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...checks import reals, short
from ...errors import ModelError, ShapeError
from ...groups import Euclidean, Group, Order
from .kinds import Shape


def shape_of(name: str, shape: Shape | int) -> Shape:
    """A shape as a tuple. Raises ModelError unless it consists of positive whole numbers."""
    sizes = tuple(shape) if isinstance(shape, (tuple, list)) else (shape,)
    if not all(isinstance(n, (int, np.integer)) and not isinstance(n, bool) and n >= 1 for n in sizes):
        raise ModelError(f"{name!r}: shape expects a tuple of positive whole numbers, got {shape!r}")
    return tuple(int(n) for n in sizes)


def group_of(name: str, shape: Shape | int | None, group: Group | None, order: Order | None) -> Group:
    """The group of a state, from its shape, or from its group and order."""
    if group is None:
        if order is not None:
            raise ModelError(
                f"State {name!r}: order= applies to poses, got a state without a group.\n"
                "  fix: pass group=tx.SE3, or leave order out; Lie nodes have a separate order="
            )
        return Euclidean(shape_of(name, () if shape is None else shape))
    if not isinstance(group, Group):
        made = f".\n  fix: give one of them: group={group.__name__}()" if isinstance(group, type) else ""
        raise ModelError(f"State {name!r}: group must be tx.SO3, tx.SE3 or another Group, got {group!r}{made}")
    try:
        hash(group)
    except TypeError:
        raise ModelError(
            f"State {name!r}: group must be comparable and hashable by value, got {group!r}.\n"
            f"  fix: make {type(group).__name__} a frozen dataclass: @dataclasses.dataclass(frozen=True)"
        ) from None
    if shape is not None and shape_of(name, shape) != group.shape:
        raise ShapeError(
            f"State {name!r} on {group.name} has shape {group.shape}, got {shape}",
            hint="leave shape out: the group determines it",
        )
    if order is None:
        return group
    if group.twist_order is None:
        raise ModelError(
            f"State {name!r}: order= applies to poses, got the group {group.name}.\n  fix: leave order out"
        )
    if not isinstance(order, Order):
        raise ModelError(f"State {name!r} expects order=tx.LINEAR_FIRST or tx.ANGULAR_FIRST, got {order!r}")
    return group.with_order(order)


def _value(name: str, what: str, value: Any, shape: Shape, free: float = np.nan) -> np.ndarray | None:
    """A float64 copy broadcast to the shape; entries that are None or NaN become `free`."""
    if value is None:
        return None
    array = reals(f"{name!r}: {what}", value, ModelError, free=True).astype(np.float64)
    try:
        array = np.broadcast_to(array, shape)
    except ValueError:
        raise ShapeError(f"{name!r}: {what} expects shape {shape}, got {array.shape}") from None
    return np.where(np.isnan(array), free, array)


def chosen_values(name: str, group: Group, low: Any, high: Any, guess: Any, scale: Any) -> dict[str, np.ndarray | None]:
    """The bounds, guess and scale of a value on a group."""
    shape = group.shape
    low, high = _value(name, "min", low, shape, -np.inf), _value(name, "max", high, shape, np.inf)
    if low is not None and high is not None and (low > high).any():
        raise ModelError(f"{name!r} expects min below max, got min {low} and max {high}")
    for side, bound, never in (("min", low, np.inf), ("max", high, -np.inf)):
        if bound is not None and (bound == never).any():
            raise ModelError(f"{name!r}: {side} expects a limit that a value can satisfy, got {bound}")
    if guess is not None:
        guess = reals(f"{name!r}: guess", guess, ModelError).astype(np.float64)
        if not np.isfinite(guess).all():
            raise ModelError(f"{name!r}: guess expects finite numbers, got {short(guess)}")
        if guess.shape != shape and guess.shape[1:] != shape:
            raise ShapeError(f"{name!r}: guess expects shape {shape} or (n, *{shape}), got {guess.shape}")
    scale = _value(name, "scale", scale, shape if group.flat else (group.dimension,))
    if scale is not None and not ((scale > 0) & (scale < np.inf)).all():
        raise ModelError(f"{name!r}: scale must be positive and finite, got {scale}")
    return {"min": low, "max": high, "guess": guess, "scale": scale}


#: The largest deviation from orthonormality of an accepted rotation.
_ROTATION_TOLERANCE = 1e-6


def _half_free(name: str, what: str, array: np.ndarray, group: Group) -> np.ndarray:
    """An element with whole parts left free (NaN), such as the position of a pose; single entries cannot be free."""
    parts, rest = group.parts if len(group.parts) > 1 else (), array.copy()
    for part in parts:
        if np.isnan(array[part.place]).all():
            rest[part.place] = 0.0
    if np.isnan(rest).any():
        open_parts = " or ".join(f"the whole {part.name}" for part in parts)
        can_leave = f"{open_parts} free, no other entries" if parts else "none free"
        raise ModelError(
            f"{name!r}: {what} of {group.name} can leave free {can_leave}, got\n{array}\n"
            f"  fix: use constraints on the entries of {name}, e.g. {what}=[{name}[0, 1] == 0.0]"
        )
    return array


def boundary_value(name: str, what: str, value: Any, group: Group) -> np.ndarray | None:
    """A value at the start or the end: a group element, or numbers, of which some may be None."""
    if value is None or group.flat:
        numbers = _value(name, what, value, group.shape)
        if np.ndim(value) and np.shape(value) != group.shape:  # a list that would be repeated is a slip
            raise ShapeError(f"{name!r}: {what} expects shape {group.shape} or a number, got {np.shape(value)}")
        if numbers is not None and np.isinf(numbers).any():
            raise ModelError(f"{name!r}: {what} expects finite numbers, or None for free entries, got {numbers}")
        return numbers
    if np.shape(value) != group.shape:
        raise ShapeError(f"{name!r}: {what} expects shape {group.shape}, got {np.shape(value)}")
    array = reals(f"{name!r}: {what}", value, ModelError, free=True).astype(np.float64)
    if np.isnan(array).any():
        array = _half_free(name, what, array, group)
    defect = group.known_defect(np.where(np.isnan(array), np.asarray(group.identity(), float), array))
    if not defect <= _ROTATION_TOLERANCE:
        off = f"off by {defect:.2g}"
        raise ModelError(f"{name!r}: {what} is not an element of {group.name} ({off}).\n  fix: {group.remedy}")
    return array
