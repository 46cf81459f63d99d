"""Typical sizes of states, controls and shared unknowns, measured at a start; they make the
solve independent of units.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from .problem.controls import rate_name
from .transcription.iterate import Iterate
from .transcription.shooting import Shooting

#: The rotation angle in rad that counts as the typical size of a rotation, at which its tangent space has changed
#: noticeably.
_TURN = 0.5
#: A constant value changes by this fraction of its size; a smaller fraction of a value or of a step is round-off.
_CONSTANT, _ROUNDING = 0.1, 1e-9
#: A spread below this fraction of the effect of other variables counts as zero.
_NOTHING = 1e-4
#: A slack below this value is zero.
_ZERO = 1e-6
#: The maximal number of passes in which known sizes determine further ones.
_ROUNDS = 4
#: Limits of a control that exceed the control that moves a state by its size by more than this factor are ignored.
_WIDE = 1e3


class Sizes(NamedTuple):
    """The units of one stage, which are the same for all stages."""

    d: Array  # (n,)
    u: Array  # (m,)
    border: Array  # (g,)
    steers: Array  # (m,) whether controls affect states
    reserve: float = (
        np.inf
    )  # the ratio by which limited controls can move the least controllable state farther than required

    def rounding(self) -> Sizes:
        """The round-off of steps of these sizes."""
        return self._replace(d=_ROUNDING * self.d, u=_ROUNDING * self.u)

    def of_one(self) -> Sizes:
        """A copy with size 1 for all states and controls."""
        return self._replace(d=np.ones_like(self.d), u=np.ones_like(self.u))


class SizeMeter:
    """Measures the typical sizes of a phase at a start.

    The declared scale of a leaf has priority. Otherwise the size is half the spread of a state along the start, or half
    the distance between the limits of a control. Remaining sizes follow from the effect of these, by the derivatives of
    the intervals.
    """

    def __init__(self, shooting: Shooting) -> None:
        self._shooting, n, m = shooting, shooting.n, shooting.m
        group, self._controls = shooting.dynamics.group, shooting.local.controls.slices
        self._flat = [name for name in group.slices if group.factors[name].flat]
        places = [np.arange(n)[group.slices[name]] for name in self._flat]
        self._columns = np.concatenate([np.zeros(0, int), *places])
        self._curved = [
            (cast(State, shooting.leaves[name]), part)
            for name, part in group.slices.items()
            if name not in self._flat and cast(State, shooting.leaves[name]).scale is None
        ]
        self._declared, self._most, self._paced = np.full(n, np.nan), np.full(n, np.inf), np.zeros(n, bool)
        for name, part in group.slices.items():
            leaf = cast(State, shooting.leaves[name])
            self._most[part] = _most(leaf)
            if leaf.scale is not None:
                self._declared[part] = np.ravel(leaf.scale)
            # For a continuous control, its limits determine its range.
            is_control = isinstance(shooting.leaves.get(rate_name(name)), Control)
            self._paced[part] = is_control & np.isfinite(self._most[part])
        self._u_declared, self._box, self._slack = np.full(m, np.nan), np.full(m, np.nan), np.zeros(m, bool)
        for name, part in self._controls.items():
            leaf_u = cast(Control, shooting.leaves[name])
            self._box[part] = _box(leaf_u, part.stop - part.start)
            self._slack[part] = name in shooting.slacks
            if leaf_u.scale is not None:
                self._u_declared[part] = np.ravel(leaf_u.scale)
        #: Rows |a|^2 / (c s) <= c s have the unit of c s; if s is close to zero their derivatives do not determine it.
        first = {name: part.start for name, part in group.slices.items()}
        first |= {name: n + part.start for name, part in self._controls.items()}
        bounds = enumerate(shooting.path.norm_bounds)
        self._norm_bounds = [(row, first[bound[0]], bound[1]) for row, bound in bounds if bound is not None]
        self._half_limits = 0.5 * np.subtract(*np.reshape(shooting.border.limits, (-1, 2)).T[::-1])
        self._fixed = np.isin(np.arange(n), shooting.layout.fixed) & ~shooting.free.d[0]

    @np.errstate(all="ignore")
    def __call__(
        self, point: Iterate, moved: Array, gaps: Array, least: Sizes | None = None, with_reserve: bool = True
    ) -> Sizes:
        """Sizes of states, controls and shared unknowns.

        Args:
            moved: (intervals, n, n + m + shared unknowns) derivatives of the ends of intervals.
            gaps: (intervals, n) defects, the tangents from the starts of the next intervals to the ends of intervals.
            least: values of states and controls below which they are round-off.
            with_reserve: whether to measure the reserve of limited controls.
        """
        shooting = self._shooting
        n, m, most, steering = shooting.n, shooting.m, self._most, self._paced
        least_d, least_u = (np.zeros(n), np.zeros(m)) if least is None else (least.d, least.u)
        values = self._flat_values(point)
        values = np.where(np.abs(values) > least_d[self._columns], values, 0.0)
        us = np.where(np.abs(point.us) > least_u, point.us, 0.0)
        largest = np.zeros(n)
        largest[self._columns] = np.abs(values).max(axis=0, initial=0.0)
        d = self._of_states(point, values, largest[self._columns])
        u, box = self._of_controls(us)
        b, free = np.abs(point.border), slice(shooting.border.phases, None)
        b[free] = np.where(np.isfinite(self._half_limits), np.maximum(b, self._half_limits), b)[free]
        # (n, number of unknowns): the effect of unknowns on states over the horizon.
        drift, horizon = 0.5 * np.abs(gaps).sum(axis=0), np.abs(moved).sum(axis=0)
        through, rounding = horizon[:, n : n + m], _ROUNDING * largest
        unknown, between = np.isnan(u), self._between_ends(values)
        coupling = horizon[:, : n + m].copy()
        np.fill_diagonal(coupling, 0.0)
        among = coupling[:, :n] > 0.0  # which states affect which
        reserve = _reserve(d, u, box, through, coupling[:, :n], between, steering) if with_reserve else np.inf
        has_box, steers = ~np.isnan(box), through > 0.0
        for number in range(_ROUNDS):
            before = d, u
            sure = (
                d if number > 0 else np.where(between > 0.0, between, np.where(steering, d, np.nan))
            )  # at first other states may be noise
            needed = np.fmin.reduce(np.where(steers, sure[:, None] / through, np.inf), axis=0, initial=np.inf)
            is_finite = needed < np.inf
            is_bounded = has_box & ~((box >= _WIDE * needed) & is_finite)
            usual = np.where(is_bounded | ~is_finite, box, needed)
            u = np.where(unknown | (u < _NOTHING * usual), usual, u)
            known = np.concatenate([d, u])
            known[np.isnan(known)] = 0.0
            pushed = (coupling * known).max(axis=1)  # the effect of other variables on each state
            d = np.where((pushed > 0.0) & (np.isnan(d) | (d < _NOTHING * pushed)), pushed, d)
            d = _drifting(d, drift, among)
            d = np.minimum(np.where(d < rounding, rounding, d), most)
            if number > 0 and all(np.array_equal(a, c, equal_nan=True) for a, c in zip(before, (d, u))):
                break
        # A parameter that is zero has the size that moves a state by its size.
        of_shared = np.full(len(b), np.inf)
        of_shared[shooting.border.unknown] = np.fmin.reduce(d[:, None] / horizon[:, n + m :], axis=0, initial=np.inf)
        b = np.where((b > 0.0) | ~np.isfinite(of_shared), b, of_shared)
        d = np.where(np.isnan(d) & (largest > 0.0), largest, d)
        d = np.where(np.isnan(d) & np.isfinite(most), most, d)
        largest_u = np.abs(us).max(axis=0, initial=0.0)
        u = np.where(np.isnan(u) & (largest_u > 0.0), largest_u, u)
        u[self._slack & (u < _ZERO)] = np.nan  # a slack of a satisfied constraint is round-off, and not its size
        b[free] = np.where(b[free] < 1e-3 * _ZERO, np.nan, b[free])
        d, u, b = (usable(a) for a in (d, u, b))
        return Sizes(d, u, b, steers.any(axis=0), reserve)

    def of_norm_bounds(self, sizes: Sizes) -> list[tuple[int, float]]:
        """The path rows that bound norms, with their units."""
        return [(row, factor * np.append(sizes.d, sizes.u)[at]) for row, at, factor in self._norm_bounds]

    def largest(self, point: Iterate) -> Array:
        """The largest value of each flat state, zero for other states."""
        largest = np.zeros(self._shooting.n)
        largest[self._columns] = np.abs(self._flat_values(point)).max(axis=0, initial=0.0)
        return largest

    def _flat_values(self, point: Iterate) -> Array:
        """(nodes, columns) values of all flat states."""
        nodes = self._shooting.nodes
        return np.concatenate(
            [np.zeros((nodes, 0)), *(np.reshape(point.xs[name], (nodes, -1)) for name in self._flat)], axis=1
        )

    def _of_states(self, point: Iterate, values: Array, largest: Array) -> Array:
        """Sizes of the states' tangents; NaN if unknown."""
        d = np.full(self._shooting.n, np.nan)
        d[self._columns] = _spread(values, largest)
        for leaf, part in self._curved:
            d[part] = _of_curved(leaf, point.xs[leaf.name])
        d = np.where(np.isnan(self._declared), d, self._declared)
        return np.minimum(np.where(self._paced, self._most, d), self._most)

    def _of_controls(self, us: Array) -> tuple[Array, Array]:
        """Sizes of the controls from their values, and from their limits; NaN if unknown."""
        spread, box = _spread(us, np.abs(us).max(axis=0, initial=0.0)), self._box
        # Limits determine the range of a control, unless they are far from the values that it needs.
        u, limits = np.where(np.isnan(box), spread, np.nan), np.where(np.isnan(box), spread, box)
        is_free = np.isnan(self._u_declared)
        return np.where(is_free, u, self._u_declared), np.where(is_free, limits, self._u_declared)

    def _between_ends(self, values: Array) -> Array:
        """Half the distance between fixed end values of flat states; zero if one is free."""
        half_distance = np.zeros(self._shooting.n)
        half_distance[self._columns] = 0.5 * np.abs(values[-1] - values[0])
        return np.where(self._fixed, half_distance, 0.0)


def _reserve(d: Array, u: Array, box: Array, through: Array, among: Array, between: Array, steering: Array) -> float:
    """The smallest ratio of a state's change by controls to its known size; infinite if there is no such change."""
    known = np.where(between > 0.0, between, d)
    direct = through @ np.nan_to_num(np.where(np.isnan(u), box, u))
    pushed = direct
    for _ in range(_ROUNDS):
        pushed = direct + among @ np.where(steering, known, np.fmin(pushed, known))
    ratios = np.where(steering, np.inf, pushed / known)
    return float(np.fmin.reduce(np.where(ratios > 0.0, ratios, np.inf), initial=np.inf))


def usable(sizes: Array) -> Array:
    """Sizes, with 1 in place of those that are not positive and finite."""
    return np.where((sizes > 0.0) & np.isfinite(sizes), sizes, 1.0)


def _most(leaf: State) -> Array:
    """The upper limit of a size: half the distance between limits of a flat state, or the angle of a rotation; else
    infinite.
    """
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


def _drifting(d: Array, drift: Array, among: Array) -> Array:
    """Sizes, including those of states that only the drift of the guess moves; states that depend on these follow
    later.
    """
    unknown = np.isnan(d) & (drift > 0.0)
    first = unknown & ~(among & np.isnan(d)).any(axis=1)
    sizes = np.where(first if first.any() else unknown, drift, d)
    return np.where(sizes < _NOTHING * drift, drift, sizes)


def _of_curved(leaf: State, values: Array) -> Array:
    """Sizes of the tangents of a state on a manifold; NaN if unknown."""
    group = leaf.group
    sizes = np.full(group.dimension, _TURN)
    for piece in group.parts:
        if piece.sized:
            spread = np.ptp(np.reshape(piece.of(values), (len(values), -1)), axis=0).max()
            sizes[np.array(piece.entries)] = 0.5 * spread if spread > 0.0 else np.nan
    return sizes


def _box(leaf: Control, entries: int) -> Array:
    """Half the distance between the limits of a control, or the magnitude of a single limit; NaN if there is none."""
    low, high = (np.full(entries, np.nan) if a is None else np.ravel(a) for a in (leaf.min, leaf.max))
    box = 0.5 * (high - low)
    one_sided = np.where(np.isfinite(low), np.abs(low), np.where(np.isfinite(high), np.abs(high), np.nan))
    return np.where(np.isfinite(box) & (box > 0.0), box, np.where(one_sided > 0.0, one_sided, np.nan))


def _spread(values: Array, largest: Array) -> Array:
    """Half the spread of values (count, entries) along a start, limited to these sizes; NaN for constant values."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    spread = 0.5 * (values.max(axis=0) - values.min(axis=0))
    return np.where(spread > _ROUNDING * largest, np.maximum(spread, _CONSTANT * largest), np.nan)
