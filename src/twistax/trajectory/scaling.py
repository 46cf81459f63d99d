"""How big steps of the unknowns, residuals and the objective are, measured on an iterate and the problem's derivatives.

Nothing here looks at limits unless nothing else is known, so scales follow the units and not the width of the limits.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from ..groups import Euclidean, SpecialEuclidean
from .border import Border
from .iterate import Scales
from .riccati import of_stages
from .shooting import Shooting
from .transcribed import Derivatives, Point, Segment, Step, Transcribed

#: A turn, in rad, after which a rotation's tangent space looks different.
_TURN = 0.5
#: A control that is constant counts as this share of its size.
_CONSTANT = 0.1
#: A spread of less than this share of another entry's, or of what others move it by, counts as zero.
_NOTHING = 1e-4
#: Controls count with at least this share of what moves a state by its size.
_WEAK = 1e-2
#: Scales stay above this share of what they were.
_SMALL = 1e-6
_FLOORED = ("d", "u", "border", "cost")


def unit_scales(shooting: Transcribed) -> Scales:
    """Scales of 1."""
    free = shooting.free
    return Scales(*map(np.ones, (*(a.shape for a in free), len(shooting.exists), ())))


@np.errstate(over="ignore", invalid="ignore")  # starts far off may have slopes without end
def measured(
    shooting: Transcribed,
    point: Point,
    slopes: Derivatives,
    scales: Scales,
    gaps: Array | None = None,
) -> tuple[Scales, bool]:
    """Scales at a point, from the derivatives there, taken in other scales; and whether the objective has slopes.

    States and controls count with half the spread of their values along the trajectory, or with what the leaf
    declares. What does not move yet gets a size from what it moves, or from what moves it; of a control none at which
    the Lagrangian bends by more than the objective's scale, for its slopes may vanish at an optimum. Durations count
    as they are, parameters with what changes states and rows as much as these sizes do. Rows are divided by their
    slope, the objective by what steps of these sizes do to it.

    Args:
        gaps: (intervals, n) of the dynamics at a start, where second derivatives are those of the objective. States at
            rest there count with half of how far gaps would move them, and the objective with how it bends: it may
            have no slope where a guess is.
    """
    unit, border = Scales(*map(np.asarray, scales)), shooting.border
    before, end_before = (np.asarray(a) for a in of_stages(Step(unit.d, unit.u, unit.border)))
    reach = np.abs(np.asarray(slopes.defects)) * unit.d[1:, :, None] / before[:, None]
    inner_slopes = np.abs(np.asarray(slopes.rows)) / before[:, None]
    end_slopes = np.abs(np.asarray(slopes.end_rows)) / end_before
    d, u, times = np.ones_like(unit.d), np.ones_like(unit.u), np.abs(np.asarray(point.border))[: border.phases]
    moved, told = [], dict[str, Array]()
    for part in shooting.segments:
        own, slices = part.shooting, part.shooting.dynamics.group.slices
        most = (reach[part.stages, : own.n] / own.mesh.widths[:, None, None]).max(axis=0)
        drift, limit = np.zeros(own.n), np.full(own.m, np.inf)
        if gaps is None:
            limit = unit.u[part.stages.start, : own.m] * _straight(slopes, part)
        else:
            drift = _drift(slopes, before, gaps, part)
        sizes = _completed(own, *_spreads(own, part.of(point)), most[:, part.columns], drift, limit)
        for name, other in own.alike.items():
            sizes[0][slices[name]] = told[name] = told.get(name, sizes[0][slices.get(other, slices[name])])
        d[part.nodes, : own.n], u[part.stages, : own.m] = sizes
        moved.append((most, sizes[0]))
    for join in shooting.joins:
        u[join.stage, : len(join.free)] = d[join.stage + 1, join.free]
    end_sizes = np.concatenate([d[-1], times])
    end_others = end_slopes[:, : len(end_sizes)] @ end_sizes
    whole = np.concatenate([d[:-1], u, np.broadcast_to(times, (len(u), len(times)))], axis=1)
    others = np.einsum("kra,ka->kr", inner_slopes[..., : whole.shape[1]], whole)
    moved += [(inner_slopes.max(axis=0), others.max(axis=0)), (end_slopes, end_others)]
    values = np.asarray(point.border)
    b = _border(border, values, moved)
    if gaps is None:  # later on: a parameter whose slopes vanish, as at its optimum they may, keeps its size
        b = np.minimum(b, np.maximum(unit.border, np.abs(values)))
    z, end = (np.asarray(a) for a in of_stages(Step(d, u, b)))
    inner = np.einsum("kra,ka->kr", inner_slopes, z) * unit.rows[: inner_slopes[..., 0].size].reshape(len(z), -1)
    for part in shooting.segments:
        inner[part.stages] = inner[part.stages].max(axis=0, initial=0.0)
    rows = np.concatenate([inner.ravel(), end_slopes @ end * unit.rows[inner.size :]])
    z, end = z / before, end / end_before
    moves = (np.abs(np.asarray(slopes.gradient)) * z).sum() + np.abs(np.asarray(slopes.end_gradient)) @ end
    if gaps is not None:
        bent = np.einsum("kab,ka,kb->", np.abs(np.asarray(slopes.hessian)), z, z)
        bent = 0.5 * (bent + end @ np.abs(np.asarray(slopes.end_hessian)) @ end)
        moves = moves + (bent if np.isfinite(bent) else 0.0)
    cost = float(moves) * float(unit.cost)
    sloped = bool(np.isfinite(cost)) and cost > 0.0
    return Scales(d, u, b, np.where(rows > 0.0, rows, unit.rows), np.array(cost if sloped else unit.cost)), sloped


def _border(border: Border, values: Array, moved: Sequence[tuple[Array, Array]]) -> Array:
    """Sizes of durations and parameters, as `measured` says; where nothing is known the value, the limits, 1.

    Moved are the slopes of rows, and how far the sizes of other unknowns move these.
    """
    count = border.phases
    if border.size == count:
        return np.abs(values)
    found = np.full(border.size - count, np.inf)
    for rows, others in moved:
        by, size = rows[:, rows.shape[1] - len(found) :], others[:, None]
        known = (by > 0.0) & (size > 0.0)
        found = np.minimum(found, np.divide(size, by, out=np.full_like(by, np.inf), where=known).min(0, initial=np.inf))
    limits = np.concatenate([np.zeros(0), *map(_from_limits, border.boxes)])
    for known in (np.abs(values[count:]), limits, np.ones_like(found)):
        found = np.where(np.isfinite(found) & (found > 0.0), found, known)
    return np.concatenate([np.abs(values[:count]), found])


def declared(leaves: Sequence[State | Control]) -> Array:
    """The scales that leaves declare, of all their tangents in one vector; 1, and half a radian, where they do not."""
    parts = [np.zeros(0)]
    for leaf in leaves:
        group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
        plain = np.ones(group.dimension)
        if isinstance(group, SpecialEuclidean):
            plain = np.asarray(group.order.from_linear_first(np.array([1.0] * 3 + [_TURN] * 3)))
        elif not isinstance(group, Euclidean):
            plain = np.full(group.dimension, _TURN)
        parts.append(plain if leaf.scale is None else np.ravel(leaf.scale))
    return np.concatenate(parts)


def not_below(scales: Scales, seen: Scales, sloped: bool) -> tuple[Scales, Scales]:
    """Scales of unknowns and objective no less than a small share of the largest seen, and the largest seen.

    What falls to zero, as an objective may at its optimum, would else never be small.
    """
    known = scales if sloped else scales._replace(cost=np.zeros(()))
    seen = seen._replace(**{name: np.maximum(getattr(known, name), getattr(seen, name)) for name in _FLOORED})
    own = {name: np.maximum(getattr(scales, name), _SMALL * getattr(seen, name)) for name in _FLOORED}
    return scales._replace(**own), seen


def levelled(shooting: Transcribed, scales: Scales) -> Scales:
    """Scales in which an entry of a vector that hardly moves counts as the one that moves most.

    Vectors that declare a scale keep it, and so do tangents of SO(3) and SE(3), whose axes have one unit.
    """
    d, u = np.array(scales.d), np.array(scales.u)
    for part in shooting.segments:
        own, group = part.shooting, part.shooting.dynamics.group
        plain = [name for name, factor in group.factors.items() if isinstance(factor, Euclidean)]
        entries = [(d[part.nodes], name, group.slices[name]) for name in plain]
        entries += [(u[part.stages], name, columns) for name, columns in own.local.controls.slices.items()]
        for sizes, name, columns in entries:
            if own.leaves[name].scale is None:
                sizes[:, columns] = sizes[:, columns].max(axis=1, keepdims=True)
    return scales._replace(d=d, u=u)


def change(one: Scales, other: Scales) -> float:
    """The largest factor between two sets of scales."""
    ratios = [np.asarray(a) / np.asarray(b) for a, b in zip(one, other)]
    return max(float(np.maximum(r, 1.0 / r).max(initial=1.0)) for r in ratios)


def _spreads(shooting: Shooting, point: Point) -> tuple[Array, Array]:
    """Half the spread of every tangent along the trajectory; zero where nothing moves."""
    d = np.zeros(shooting.n)
    for name, factor in shooting.dynamics.group.factors.items():
        part, leaf = shooting.dynamics.group.slices[name], shooting.leaves[name]
        values = np.asarray(point.xs[name])
        if leaf.scale is not None:
            d[part] = np.ravel(leaf.scale)
        elif isinstance(factor, SpecialEuclidean):
            length = float(np.ptp(values[:, :3, 3], axis=0).max()) / 2.0
            d[part] = np.where(shooting.turns[part], _TURN, length)
        elif isinstance(factor, Euclidean):
            flat = values.reshape(len(values), -1)
            d[part] = _moving(np.ptp(flat, axis=0) / 2.0, flat)
        else:
            d[part] = _TURN
    u = np.zeros(shooting.m)
    for name, part in shooting.local.controls.slices.items():
        flat, leaf = np.asarray(point.us)[:, part], shooting.leaves[name]
        spread = _moving(np.maximum(np.ptp(flat, axis=0) / 2.0, _CONSTANT * np.abs(flat).max(axis=0)), flat)
        u[part] = spread if leaf.scale is None else np.ravel(leaf.scale)
    return d, u


def _moving(spread: Array, values: Array) -> Array:
    """Spreads, zero where they are rounding, or nothing beside another entry's."""
    moves = (spread > _NOTHING * spread.max(initial=0.0)) & (spread > 1e-9 * np.abs(values).max(axis=0))
    return np.where(moves, spread, 0.0)


def _straight(slopes: Derivatives, part: Segment) -> Array:
    """How many scales of each control bend the Lagrangian by the objective's scale, 1 at least; inf where none do."""
    first = slopes.defects.shape[1]
    own = range(first, first + part.shooting.m)
    bent = np.abs(np.asarray(slopes.hessian)[part.stages, own, own]).sum(axis=0) / 2.0
    return np.where(bent > _SMALL**2, 1.0 / np.sqrt(np.clip(bent, _SMALL**2, 1.0)), np.inf)


def _drift(slopes: Derivatives, before: Array, gaps: Array, part: Segment) -> Array:
    """Half of how far gaps move the states of a phase: along linear dynamics, or alone where these grow far."""
    n = part.shooting.n
    own, jumps = np.asarray(slopes.defects)[part.stages, :n, :n], np.abs(gaps[part.stages, :n])
    own = own / before[part.stages, None, :n]
    alone, moved, most = jumps.sum(axis=0), np.zeros(n), np.zeros(n)
    for slope, gap in zip(own, gaps[part.stages, :n]):
        moved = slope @ moved + gap
        most = np.maximum(most, np.abs(moved))
    once = np.maximum(alone, (np.abs(own).max(axis=0) * alone).max(axis=1) * len(own))
    return _finite(np.where(most * _NOTHING <= once, most, alone) / 2.0)


def _completed(
    shooting: Shooting, d: Array, u: Array, slopes: Array, drift: Array, limit: Array
) -> tuple[Array, Array]:
    """Sizes for what has none: from what it moves along the whole trajectory, from what moves it, from limits, 1.

    Slopes are the largest of the dynamics over an interval as long as the trajectory, (n, n + m); states that others
    move count with their drift at least, controls that move others with their limit at most.
    """
    n = shooting.n
    largest = np.concatenate([np.full(n, np.inf), np.maximum(limit, u)])
    reach = np.array(slopes)
    reach[np.arange(n), np.arange(n)] = 0.0
    declared = _declared(shooting)
    sizes = np.where(declared, np.concatenate([d, u]), _without_noise(d, u, reach))
    limits = lambda _: np.concatenate([_from_limits(leaf) for leaf in shooting.leaves.values()])  # noqa: E731
    for known in (np.zeros_like, limits, np.ones_like):
        if (sizes > 0.0).all():
            break
        sizes = np.where(sizes > 0.0, sizes, known(sizes))
        for _ in range(len(sizes)):
            before = sizes
            back = _back(sizes[:n], reach)
            sizes = np.where((sizes > 0.0) | ~np.isfinite(back), sizes, np.minimum(back, largest))
            ahead = np.maximum((reach * sizes).max(axis=1), drift)
            sizes = np.concatenate([np.where(sizes[:n] > 0.0, sizes[:n], ahead), sizes[n:]])
            if (before == sizes).all():
                break
    # What hardly moves, and what hardly moves others, is not measured by how little it does.
    floor = _SMALL * (reach * sizes).max(axis=1)
    weak = np.minimum(_finite(_back(np.maximum(sizes[:n], floor), reach)[n:]), largest[n:])
    floor = np.concatenate([floor, _WEAK * weak])
    sizes = np.where(declared, sizes, np.maximum(sizes, floor))
    return sizes[:n], sizes[n:]


def _declared(shooting: Shooting) -> Array:
    """Which tangents and controls have a size from their leaf."""
    found = np.zeros(shooting.n + shooting.m, bool)
    places = [(name, part, 0) for name, part in shooting.dynamics.group.slices.items()]
    places += [(name, part, shooting.n) for name, part in shooting.local.controls.slices.items()]
    for name, part, before in places:
        found[before:][part] = shooting.leaves[name].scale is not None
    return found


def _without_noise(d: Array, u: Array, reach: Array) -> Array:
    """Sizes, zero where a guess at rest has noise: what would move no other, and what others move far more."""
    n = len(d)
    reach = np.minimum(reach, 1e100)  # products stay finite
    small = d < _NOTHING * _finite(_back(d, reach)[:n])
    moves = u >= _NOTHING * _finite(_back(np.where(small, 0.0, d), reach)[n:])
    ahead = (reach * np.concatenate([np.where(small, 0.0, d), np.where(moves, u, 0.0)])).max(axis=1)
    # Not where states drive each other far apart: there little may move much.
    calm = (reach[:, :n] * reach[:, :n].T).max(axis=1) < 1.0 / _NOTHING
    noise = calm & ((d < _NOTHING * ahead) | (small & (ahead == 0.0)))
    return np.concatenate([np.where(noise, 0.0, d), np.where(moves, u, 0.0)])


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, 0.0)


def _back(d: Array, reach: Array) -> Array:
    """How large what moves a state is, to move it by its size; infinite where it moves none of known size."""
    rows = d[:, None]
    with np.errstate(over="ignore"):  # it is infinite then
        back = np.divide(rows, reach, out=np.full_like(reach, np.inf), where=(reach > 0.0) & (rows > 0.0))
    least: Array = back.min(axis=0)
    return least


def _from_limits(leaf: State | Control) -> Array:
    """Half the width of a box, or the size of its one side; zero without a box."""
    group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
    if not isinstance(group, Euclidean):
        return np.zeros(group.dimension)
    low = np.full(leaf.shape, np.nan) if leaf.min is None else np.where(np.isfinite(leaf.min), leaf.min, np.nan)
    high = np.full(leaf.shape, np.nan) if leaf.max is None else np.where(np.isfinite(leaf.max), leaf.max, np.nan)
    width = np.where(np.isnan(low + high), np.fmax(np.abs(low), np.abs(high)), (high - low) / 2.0)
    return np.nan_to_num(width).ravel()
