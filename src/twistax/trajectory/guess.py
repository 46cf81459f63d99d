"""Where an optimisation starts, and how big steps of its unknowns and its residuals are."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..checks import listed, reals, short
from ..errors import ModelError, ShapeError
from ..expr import Control, State
from ..groups import Euclidean, Group, SpecialEuclidean
from ..system import name_of

if TYPE_CHECKING:
    from .transcription import Evaluation


def user_guess(
    guess: Mapping[Any, Any] | None, leaves: Mapping[str, State | Control], lengths: Mapping[str, int]
) -> dict[str, Array]:
    """Checked guesses by name: one value, or one for each node (states) or interval (controls)."""
    found = {}
    if guess is not None and not isinstance(guess, Mapping):
        raise ModelError(f"guess must be a dict from names to values, got {type(guess).__name__}")
    for key, value in (guess or {}).items():
        name = name_of(key)
        if name not in leaves:
            raise ModelError(f"guess names {name!r}; the system has: {listed(leaves, name)}")
        array, leaf, length = reals(f"guess[{name!r}]", value, ModelError), leaves[name], lengths[name]
        if array.shape not in (leaf.shape, (length, *leaf.shape)):
            raise ShapeError(
                f"guess[{name!r}] expects shape {leaf.shape} or {(length, *leaf.shape)}, got {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ModelError(f"guess[{name!r}] expects finite numbers, got {short(array)}")
        found[name] = array
    return found


def state_guess(leaf: State, given: Array | None, initial: Array | None, final: Array | None, nodes: int) -> Array:
    """Values of a state at all nodes; fixed ends are put in place.

    Without a guess the state goes from its initial to its final value along a geodesic, or stays where one is known.
    """
    source = given if given is not None else leaf.guess
    if source is None:
        rest = np.zeros(leaf.shape)
        if isinstance(leaf.group, Euclidean):
            rest = _middle(leaf.min, leaf.max, rest)
        elif initial is None and final is None:
            rest = np.asarray(leaf.group.identity(float))
        first, last = _known(initial, _known(final, rest)), _known(final, _known(initial, rest))
        source = np.stack([first, last])
    elif source.shape == leaf.shape:
        source = source[None]
    values = resample(leaf.group, source, nodes)
    values[0], values[-1] = _known(initial, values[0]), _known(final, values[-1])
    return values


def control_guess(leaf: Control, given: Array | None, intervals: int) -> Array:
    """Values of a control in all intervals: what is given, or the middle of its box, or its point nearest zero."""
    source = given if given is not None else leaf.guess
    if source is None:
        source = _middle(leaf.min, leaf.max, np.zeros(leaf.shape))
    if source.shape == leaf.shape:
        source = source[None]
    return resample(Euclidean(leaf.shape), source, intervals)


def resample(group: Group, samples: Array, count: int) -> Array:
    """A curve through samples (k, *shape) at equal distances, read at `count` equal distances: geodesic in between."""
    if len(samples) in (1, count):
        return np.array(np.broadcast_to(samples, (count, *samples.shape[1:])))
    place = np.linspace(0.0, len(samples) - 1.0, count)
    left = np.minimum(place.astype(int), len(samples) - 2)
    share = place - left

    @jax.jit
    @jax.vmap
    def between(a: jax.Array, b: jax.Array, s: jax.Array) -> jax.Array:
        return group.retract(a, s * group.difference(a, b))

    return np.array(between(jnp.asarray(samples[left]), jnp.asarray(samples[left + 1]), jnp.asarray(share)))


def _known(values: Array | None, otherwise: Any) -> Any:
    return otherwise if values is None else np.where(np.isnan(values), otherwise, values)


def _middle(low: Array | None, high: Array | None, otherwise: Any) -> Any:
    """The middle of a box; where it is open, the point of it nearest to another value."""
    low = np.full(otherwise.shape, -np.inf) if low is None else low
    high = np.full(otherwise.shape, np.inf) if high is None else high
    closed = np.isfinite(low) & np.isfinite(high)
    inside = np.clip(otherwise, low, high)
    return np.where(closed, 0.5 * (np.where(closed, low, 0.0) + np.where(closed, high, 0.0)), inside)


#: A turn, in rad, after which a rotation's tangent space looks different.
_TURN = 0.5


@dataclasses.dataclass(frozen=True)
class Scales:
    """Sizes by which unknowns, residuals and the objective are divided."""

    columns: Array  # (local,) of the unknowns an interval sees
    rows: Array  # (rows,) of the residuals
    cost: float  # of the objective

    @staticmethod
    def measured(columns: Array, dimension: int, evaluations: list[Evaluation]) -> Scales:
        """Residuals and objective are divided by their steepest slope along scaled unknowns at some sample points.

        A defect is divided by the scale of its state instead. A row that is flat everywhere keeps its own size.
        """
        slopes = np.max([np.linalg.norm(e.slopes * columns, axis=2).max(axis=0) for e in evaluations], axis=0)
        sizes = np.max([np.abs(e.rows).max(axis=0) for e in evaluations], axis=0)
        rows = np.where(slopes > 1e-9 * sizes, slopes, np.maximum(sizes, 1.0))
        rows[:dimension] = columns[:dimension]
        steepest = max(float(np.abs(e.gradient * columns).max()) for e in evaluations)
        return Scales(columns, rows, steepest if steepest > 0.0 else 1.0)


def column_scales(leaves: Mapping[str, State | Control], landmarks: Mapping[str, list[Array]]) -> Array:
    """The scales of the leaves' tangents in one vector: what the leaf declares, or a guess from its landmarks."""
    parts = [np.zeros(0)]
    for name, leaf in leaves.items():
        group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
        parts.append(typical_change(group, landmarks[name]) if leaf.scale is None else np.ravel(leaf.scale))
    return np.concatenate(parts)


def typical_change(group: Group, landmarks: list[Array]) -> Array:
    """Half the spread of the known values (bounds, ends, guess) of a leaf; 1, or the common size, where they agree.

    Angles get half a radian. Landmarks are elements of the group; entries that are NaN or infinite say nothing.
    """
    if isinstance(group, SpecialEuclidean):
        positions = np.array([landmark[:3, 3] for landmark in landmarks])
        length = float(_half_spread(positions).max()) if len(positions) else 1.0
        return np.asarray(group.order.from_linear_first(np.array([length] * 3 + [_TURN] * 3)))
    if not isinstance(group, Euclidean):
        return np.full(group.dimension, _TURN)
    return _half_spread(np.array([landmark.ravel() for landmark in landmarks]).reshape(-1, group.dimension))


def _half_spread(values: Array) -> Array:
    known = np.isfinite(values)
    low = np.where(known, values, np.inf).min(axis=0, initial=np.inf)
    high = np.where(known, values, -np.inf).max(axis=0, initial=-np.inf)
    size = np.where(known, np.abs(values), 0.0).max(axis=0, initial=0.0)
    spread = np.where(high > low, 0.5 * (high - low), size)
    return np.where(spread > 0.0, spread, 1.0)
