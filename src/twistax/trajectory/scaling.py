"""How big a step of each unknown is, and how steep each residual: what makes a problem's numbers comparable."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from ..groups import Euclidean, Group, SpecialEuclidean
from .transcription import Evaluation

__all__ = ["Scales", "column_scales", "typical_change"]

#: A turn, in rad, after which a rotation's tangent space looks different.
_TURN = 0.5


@dataclasses.dataclass(frozen=True)
class Scales:
    """Sizes by which unknowns, residuals and the objective are divided.

    Attributes:
        columns: (local,) of the unknowns an interval sees.
        rows: (rows,) of the residuals.
        cost: of the objective.
    """

    columns: Array
    rows: Array
    cost: float

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
    parts = []
    for name, leaf in leaves.items():
        group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
        declared = leaf.scale
        scale = typical_change(group, landmarks[name]) if declared is None else np.ravel(declared)
        parts.append(scale)
    return np.concatenate(parts) if parts else np.zeros(0)


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
