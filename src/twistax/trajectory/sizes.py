"""Typical sizes of states, controls and shared unknowns, measured at a start, so that units do not matter."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from .problem.controls import rate_name
from .transcription.points import Point
from .transcription.shooting import Shooting

#: A turn, in rad, after which a rotation's tangent space looks different.
_TURN = 0.5
#: A value that is constant counts as this share of its size; a spread below this share of the value is rounding.
_CONSTANT, _ROUNDING = 0.1, 1e-9
#: A spread of less than this share of what others move it by counts as zero.
_NOTHING = 1e-4
#: A slack of less is zero.
_ZERO = 1e-6
#: How often what is known says more.
_ROUNDS = 4
#: Limits of a control that are so many times what moves a state by its size say nothing.
_WIDE = 1e3


class Sizes(NamedTuple):
    """The units of one stage: the same for all stages."""

    d: Array  # (n,)
    u: Array  # (m,)
    border: Array  # (g,)
    steers: Array  # (m,) whether controls move states
    reserve: float = np.inf  # how many times as far as needed limited controls move the state that is hardest to move

    def of_one(self) -> Sizes:
        """The same with 1 for all states and controls."""
        return self._replace(d=np.ones_like(self.d), u=np.ones_like(self.u))


@np.errstate(all="ignore")
def measured_sizes(shooting: Shooting, point: Point, moved: Array, gaps: Array) -> Sizes:
    """Sizes of states, controls and shared unknowns at a start.

    A leaf's declared scale counts first; then half the spread of a state along the start, half the distance between two
    limits of a control; then what these move, by the derivatives of the intervals.

    Args:
        moved: (intervals, n, n + m + g) derivatives of the ends of intervals.
        gaps: (intervals, n) how far intervals end from where the next one starts.
    """
    n, m = shooting.n, shooting.m
    d, u, box = np.full(n, np.nan), np.full(m, np.nan), np.full(m, np.nan)
    most, steering = np.full(n, np.inf), np.zeros(n, bool)
    for name, part in shooting.dynamics.group.slices.items():
        leaf = cast(State, shooting.leaves[name])
        d[part], most[part] = _of_state(leaf, point.xs[name]), _most(leaf)
        if isinstance(
            shooting.leaves.get(rate_name(name)), Control
        ):  # a continuous control: its limits say how far it goes
            d[part] = np.where(np.isfinite(most[part]), most[part], d[part])
            steering[part] = np.isfinite(most[part])
    d = np.minimum(d, most)  # NaN: not known
    slices = shooting.local.controls.slices
    for name, part in slices.items():
        u[part], box[part] = _of_control(cast(Control, shooting.leaves[name]), point.us[:, part])
    b, free = np.abs(point.border), slice(shooting.border.phases, None)
    low, high = shooting.border.limits.T
    b[free] = np.where(np.isfinite(high - low), np.maximum(b, 0.5 * (high - low)), b)[free]
    reach, drift = np.abs(moved), 0.5 * np.abs(gaps).sum(axis=0)
    horizon = reach.sum(axis=0)  # (n, n + m + g): how far unknowns move states, over the horizon
    through = horizon[:, n : n + m]
    largest = largest_values(shooting, point)
    rounding = _ROUNDING * largest
    unknown, between = np.isnan(u), _between_ends(shooting, point)
    among = horizon[:, :n] * (1.0 - np.eye(n)) > 0.0  # which states move which
    reserve = _reserve(d, u, box, through, horizon[:, :n], between, steering)
    for number in range(_ROUNDS):
        before = d, u
        sure = (
            d if number > 0 else np.where(between > 0.0, between, np.where(steering, d, np.nan))
        )  # at first others may be noise
        needed = np.nanmin(np.where(through > 0.0, sure[:, None] / through, np.inf), axis=0, initial=np.inf)
        is_bounded = ~np.isnan(box) & ~((box >= _WIDE * needed) & np.isfinite(needed))
        usual = np.where(is_bounded | ~np.isfinite(needed), box, needed)
        u = np.where(unknown | (u < _NOTHING * usual), usual, u)
        known = np.nan_to_num(np.concatenate([d, u, b]), nan=0.0)
        pushed = horizon * known  # what each unknown moves each state by
        pushed[np.arange(n), np.arange(n)] = 0.0
        others_push = pushed[:, : n + m].max(axis=1)
        d = np.where((others_push > 0.0) & (np.isnan(d) | (d < _NOTHING * others_push)), others_push, d)
        d = _drifting(d, drift, among)
        d = np.minimum(np.where(d < rounding, rounding, d), most)
        if number > 0 and all(np.array_equal(a, c, equal_nan=True) for a, c in zip(before, (d, u))):
            break
    # A parameter that is zero counts with what moves a state by its size.
    of_shared = np.nanmin(d[:, None] / horizon[:, n + m :], axis=0, initial=np.inf)
    b = np.where((b > 0.0) | ~np.isfinite(of_shared), b, of_shared)
    d = np.where(np.isnan(d) & (largest > 0.0), largest, d)
    d = np.where(np.isnan(d) & np.isfinite(most), most, d)
    values = np.abs(point.us).max(axis=0, initial=0.0)
    u = np.where(np.isnan(u) & (values > 0.0), values, u)
    # A slack of what holds is rounding, and that is no size of it.
    for name in shooting.slacks:
        u[slices[name]] = np.where(u[slices[name]] < _ZERO, np.nan, u[slices[name]])
    b[free] = np.where(b[free] < 1e-3 * _ZERO, np.nan, b[free])
    d, u, b = (usable(a) for a in (d, u, b))
    return Sizes(d, u, b, (through > 0.0).any(axis=0), reserve)


def _reserve(d: Array, u: Array, box: Array, through: Array, among: Array, between: Array, steering: Array) -> float:
    """The smallest ratio of the change of a state of known size by controls to that size; infinite if none changes."""
    known = np.where(between > 0.0, between, d)
    limited = np.nan_to_num(np.where(np.isnan(u), box, u))
    direct, among = through @ limited, among * (1.0 - np.eye(len(d)))
    pushed = direct
    for _ in range(_ROUNDS):
        pushed = direct + among @ np.where(steering, known, np.fmin(pushed, known))
    ratios = np.where(steering, np.inf, pushed / known)
    return float(np.nanmin(np.where(ratios > 0.0, ratios, np.inf), initial=np.inf))


def usable(sizes: Array) -> Array:
    """Sizes, and 1 in place of those that are not positive numbers."""
    return np.where((sizes > 0.0) & np.isfinite(sizes), sizes, 1.0)


def _most(leaf: State) -> Array:
    """The upper limit of a size: half the distance between limits of a flat state, or a turn; else infinite."""
    group = leaf.group
    if not group.flat:
        most = np.full(group.dimension, _TURN)
        for piece in group.parts:
            if piece.sized:
                most[np.array(piece.entries)] = np.inf
        return most
    if leaf.min is None or leaf.max is None:
        return np.full(group.dimension, np.inf)
    half = 0.5 * np.broadcast_to(np.ravel(np.asarray(leaf.max) - np.asarray(leaf.min)), (group.dimension,))
    return np.where(half > 0.0, half, np.inf)


def largest_values(shooting: Shooting, point: Point) -> Array:
    """The largest value of each flat state, zero of others."""
    largest = np.zeros(shooting.n)
    for name, part in shooting.dynamics.group.slices.items():
        if shooting.dynamics.group.factors[name].flat:
            largest[part] = np.abs(np.reshape(point.xs[name], (shooting.nodes, -1))).max(axis=0)
    return largest


def _between_ends(shooting: Shooting, point: Point) -> Array:
    """Half of how far fixed ends of flat states are apart; zero where one is free."""
    half_distance = np.zeros(shooting.n)
    for name, part in shooting.dynamics.group.slices.items():
        if shooting.dynamics.group.factors[name].flat:
            values = np.reshape(point.xs[name], (shooting.nodes, -1))
            half_distance[part] = 0.5 * np.abs(values[-1] - values[0])
    fixed = np.isin(np.arange(shooting.n), shooting.layout.fixed) & ~shooting.free.d[0]
    return np.where(fixed, half_distance, 0.0)


def _drifting(d: Array, drift: Array, among: Array) -> Array:
    """Sizes, with those of states that only the drift of the guess moves; states that they move come later."""
    unknown = np.isnan(d) & (drift > 0.0)
    first = unknown & ~(among & np.isnan(d)).any(axis=1)
    sizes = np.where(first if first.any() else unknown, drift, d)
    return np.where(sizes < _NOTHING * drift, drift, sizes)


def _of_state(leaf: State, values: Array) -> Array:
    """Sizes of a state's tangents; NaN where nothing is known."""
    group = leaf.group
    if leaf.scale is not None:
        return np.broadcast_to(np.ravel(leaf.scale), (group.dimension,))
    if group.flat:
        return _spread(values.reshape(len(values), -1), leaf)
    sizes = np.full(group.dimension, _TURN)
    for piece in group.parts:
        if piece.sized:
            spread = np.ptp(np.reshape(piece.of(values), (len(values), -1)), axis=0).max()
            sizes[np.array(piece.entries)] = 0.5 * spread if spread > 0.0 else np.nan
    return sizes


def _of_control(leaf: Control, values: Array) -> tuple[Array, Array]:
    """Sizes of a control by itself, and by its limits; NaN where nothing is known."""
    if leaf.scale is not None:
        declared = np.broadcast_to(np.ravel(leaf.scale), values.shape[1:])
        return declared, declared
    low, high = (np.full(values.shape[1], np.nan) if a is None else np.ravel(a) for a in (leaf.min, leaf.max))
    box = 0.5 * (high - low)
    one_sided = np.where(np.isfinite(low), np.abs(low), np.where(np.isfinite(high), np.abs(high), np.nan))
    box = np.where(np.isfinite(box) & (box > 0.0), box, np.where(one_sided > 0.0, one_sided, np.nan))
    spread = _spread(values, leaf)
    # Limits say how far a control goes, if they are not far from all that it needs.
    return np.where(np.isnan(box), spread, np.nan), np.where(np.isnan(box), spread, box)


def _spread(flat: Array, leaf: State | Control) -> Array:
    """Half the spread of values along a start; NaN where they do not move."""
    most = np.abs(flat).max(axis=0, initial=0.0)
    spread = 0.5 * np.ptp(flat, axis=0) if len(flat) else np.zeros(flat.shape[1])
    varies = spread > _ROUNDING * most
    return np.where(varies, np.maximum(spread, _CONSTANT * most), np.nan)
