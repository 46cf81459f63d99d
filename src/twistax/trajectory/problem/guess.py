"""Initial guesses of the optimisation, and typical sizes of unknowns and residuals."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ...checks import listed, reals, short
from ...errors import ModelError, ShapeError
from ...expr import Control, State
from ...expr.fields import freeze
from ...groups import Euclidean, Group
from ...solver.kernels import Argument, SmoothKernels
from ...system import name_of


def user_guess(
    guess: Mapping[Any, Any] | None, leaves: Mapping[str, State | Control], lengths: Mapping[str, int]
) -> dict[str, Array]:
    """Checked guesses by name: one value for all nodes (states) or intervals (controls), or one for each."""
    guesses = {}
    if guess is not None and not isinstance(guess, Mapping):
        raise ModelError(f"guess must be a dict from names to values, got {type(guess).__name__}")
    for key, value in (guess or {}).items():
        name = name_of(key)
        if name not in leaves:
            raise ModelError(f"guess names {name!r}; the system has: {listed(leaves, name)}")
        array, leaf = reals(f"guess[{name!r}]", value, ModelError), leaves[name]
        shapes = [leaf.shape, *([(lengths[name], *leaf.shape)] if name in lengths else [])]
        if array.shape not in shapes:
            raise ShapeError(f"guess[{name!r}] expects shape {' or '.join(map(str, shapes))}, got {array.shape}")
        if not np.isfinite(array).all():
            raise ModelError(f"guess[{name!r}] expects finite numbers, got {short(array)}")
        guesses[name] = array
    return guesses


def state_guess(
    leaf: State,
    guess: Array | None,
    initial: Array | None,
    final: Array | None,
    shares: Array,
    end_values: tuple[Array | None, Array | None] = (None, None),
) -> Array:
    """Values of a state at nodes, which are fractions of the final time. Fixed initial and final values replace the
    guess.

    Without a guess, the state follows a geodesic from its initial to its final value; if only one is known, it is
    constant.

    Args:
        end_values: the values that conditions prescribe at both ends, used if neither the guess nor the end fixes a
            value.
    """
    source = guess if guess is not None else leaf.guess
    if source is None:
        rest = np.zeros(leaf.shape)
        if leaf.group.flat:
            rest = _middle(leaf.min, leaf.max, rest)
        else:
            rest = np.asarray(leaf.group.identity(float))
        begin, end = (with_stated(side, value) for side, value in zip((initial, final), end_values, strict=True))
        first, last = _known(begin, _known(end, rest)), _known(end, _known(begin, rest))
        source = np.stack([first, last])
    elif source.shape == leaf.shape:
        source = source[None]
    values = resample(leaf.group, source, shares)
    values[0], values[-1] = _known(initial, values[0]), _known(final, values[-1])
    return values


def control_guess(leaf: Control, guess: Array | None, intervals: int) -> Array:
    """Values of a control in all intervals: the guess; else the middle of its limits, or the admissible value nearest
    to zero.
    """
    source = guess if guess is not None else leaf.guess
    if source is None:
        source = _middle(leaf.min, leaf.max, np.zeros(leaf.shape))
    if source.shape == leaf.shape:
        source = source[None]
    return resample(Euclidean(leaf.shape), source, np.linspace(0.0, 1.0, intervals))


def resample(group: Group, samples: Array, shares: Array) -> Array:
    """A curve through equally spaced samples (k, *shape), evaluated at fractions of its length by geodesic
    interpolation.

    If there are as many samples as fractions, the samples themselves are returned.
    """
    if len(samples) in (1, len(shares)):
        return np.array(np.broadcast_to(samples, (len(shares), *samples.shape[1:])))
    place = shares * (len(samples) - 1.0)
    left = np.minimum(place.astype(int), len(samples) - 2)
    share = place - left

    first, last = samples[left], samples[left + 1]
    if group.flat:
        return np.array(first + share.reshape(-1, *[1] * len(group.shape)) * (last - first))
    size = math.prod(group.shape)
    arguments = {Argument.SHARE: 1, Argument.BASE: size, Argument.TARGET: size}
    kernels = SmoothKernels(functools.partial(_geodesic, group), arguments, 0, ("geodesic", type(group), freeze(group)))
    values = [np.reshape(a, (len(shares), -1)) for a in (share, first, last)]
    curve = kernels.kernels[0](len(shares), size, dict(zip(arguments, values, strict=True)))
    return curve.reshape(len(shares), *group.shape)


def _geodesic(group: Group, share: jax.Array, first: jax.Array, last: jax.Array) -> jax.Array:
    """The point at a fraction of the geodesic between two elements."""
    a, b = first.reshape(group.shape), last.reshape(group.shape)
    return group.retract(a, share[0] * group.difference(a, b)).reshape(-1)


def _known(values: Array | None, otherwise: Any) -> Any:
    return otherwise if values is None else np.where(np.isnan(values), otherwise, values)


def with_stated(values: Array | None, end_values: Array | None) -> Array | None:
    """Values whose free entries are replaced by the values that conditions prescribe."""
    return values if end_values is None else _known(values, end_values)


def _middle(low: Array | None, high: Array | None, otherwise: Any) -> Any:
    """The middle of an interval of limits; without two limits, the admissible point nearest to another value."""
    low = np.full(otherwise.shape, -np.inf) if low is None else low
    high = np.full(otherwise.shape, np.inf) if high is None else high
    closed = np.isfinite(low) & np.isfinite(high)
    inside = np.clip(otherwise, low, high)
    return np.where(closed, 0.5 * (np.where(closed, low, 0.0) + np.where(closed, high, 0.0)), inside)
