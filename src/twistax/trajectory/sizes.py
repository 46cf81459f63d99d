"""Sizes of states, controls and shared unknowns, measured at a start: how far things move, whatever their units."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from .shooting import Shooting
from .transcribed import Point

#: A turn, in rad, after which a rotation's tangent space looks different.
_TURN = 0.5
#: A value that is constant counts as this share of its size; a spread below this share of the value is rounding.
_CONSTANT, _ROUNDING = 0.1, 1e-9


class Sizes(NamedTuple):
    """Units, of one stage: of all stages alike."""

    d: Array  # (n,)
    u: Array  # (m,)
    border: Array  # (g,)


def measured_sizes(shooting: Shooting, point: Point, moved: Array) -> Sizes:
    """Sizes of states, controls and shared unknowns at a start.

    A leaf's declared scale counts first; then half the spread of a state along the start, half the distance between two
    limits of a control; then what these move, by the derivatives of the intervals.

    Args:
        moved: (intervals, n, n + m + g) derivatives of the ends of intervals.
    """
    n, m = shooting.n, shooting.m
    d, u = np.full(n, np.nan), np.full(m, np.nan)
    for name, part in shooting.dynamics.group.slices.items():
        d[part] = _of_state(shooting.leaves[name], point.xs[name])
    for name, part in shooting.local.controls.slices.items():
        u[part] = _of_control(shooting.leaves[name], point.us[:, part])
    b, free = np.abs(point.border), slice(shooting.border.phases, None)
    low, high = shooting.border.limits.T
    b[free] = np.where(np.isfinite(high - low), np.maximum(b, 0.5 * (high - low)), b)[free]
    reach = np.abs(moved)
    for _ in range(3):
        known = np.concatenate([d, u, b])
        known = np.where(np.isnan(known) | (known <= 0.0), 0.0, known)
        pushed = (reach * known).sum(axis=0)  # (n, size): what each unknown moves each state by, over the horizon
        pushed[np.arange(n), np.arange(n)] = 0.0
        from_others = pushed[:, : n + m].max(axis=1)
        d = np.where(np.isnan(d) & (from_others > 0.0), from_others, d)
        through = reach[:, :, n : n + m].sum(axis=0)  # (n, m)
        with np.errstate(divide="ignore", invalid="ignore"):
            needed = np.where((through > 0.0) & ~np.isnan(d)[:, None], d[:, None] / through, np.inf).min(axis=0)
        u = np.where(np.isnan(u) & np.isfinite(needed), needed, u)
    return Sizes(np.where(np.isnan(d), 1.0, d), np.where(np.isnan(u), 1.0, u), np.where(b > 0.0, b, 1.0))


def _of_state(leaf: State, values: Array) -> Array:
    """Sizes of a state's tangents; NaN where nothing is known."""
    group = leaf.group
    if leaf.scale is not None:
        return np.broadcast_to(np.ravel(leaf.scale), (group.dimension,))
    if group.flat:
        return _spread(values.reshape(len(values), -1), leaf)
    found = np.full(group.dimension, _TURN)
    for piece in group.parts:
        if piece.sized:
            spread = np.ptp(np.reshape(piece.of(values), (len(values), -1)), axis=0).max()
            found[np.array(piece.entries)] = 0.5 * spread if spread > 0.0 else np.nan
    return found


def _of_control(leaf: Control, values: Array) -> Array:
    if leaf.scale is not None:
        return np.broadcast_to(np.ravel(leaf.scale), values.shape[1:])
    sizes = _spread(values, leaf)
    low, high = (np.full(len(sizes), np.nan) if a is None else np.ravel(a) for a in (leaf.min, leaf.max))
    box = 0.5 * (high - low)
    sizes = np.where(np.isfinite(box) & (box > 0.0), box, sizes)
    return np.where(np.isnan(sizes), _one_sided(low, high), sizes)


def _one_sided(low: Array, high: Array) -> Array:
    """The size of the one limit that there is."""
    found = np.where(np.isfinite(low), np.abs(low), np.where(np.isfinite(high), np.abs(high), np.nan))
    return np.where(found > 0.0, found, np.nan)


def _spread(flat: Array, leaf: State | Control) -> Array:
    """Half the spread of values along a start; NaN where they do not move."""
    most = np.abs(flat).max(axis=0, initial=0.0)
    spread = 0.5 * np.ptp(flat, axis=0) if len(flat) else np.zeros(flat.shape[1])
    moves = spread > _ROUNDING * most
    return np.where(moves, np.maximum(spread, _CONSTANT * most), np.nan)
