"""How big steps of the unknowns, residuals and the objective are, measured on an iterate and the problem's derivatives.

Nothing here looks at limits unless nothing else is known, so scales follow the units and not the width of the limits.
All of it is traceable: kernels measure, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from ..groups import Euclidean
from .border import Border
from .iterate import Scales
from .magnitudes import largest_along
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
#: Changes of less than this share of a value are rounding, and none that counts is smaller.
_ROUNDING = 1e-9
#: What an interval makes more than so many times as large, by itself or with another state, explodes: most often the
#: steps are too long for it.
_EXPLOSIVE = 1e2
#: Scales stay above this share of what they were.
SMALL = 1e-6
_FLOORED = ("d", "u", "border", "cost")


def unit_scales(shooting: Transcribed) -> Scales:
    """Scales of 1."""
    free = shooting.free
    return Scales(*map(np.ones, (*(a.shape for a in free), len(shooting.exists), ())))


def measured(
    shooting: Transcribed, point: Point, slopes: Derivatives, scales: Scales, gaps: Any = None
) -> tuple[Scales, jax.Array]:
    """Scales at a point, from the derivatives there, taken in other scales; and whether the objective has slopes.

    States and controls count with half the spread of their values along the trajectory, or with what the leaf
    declares. What does not move yet gets a size from what it moves, or from what moves it; of a control none at which
    the Lagrangian bends by more than the objective's scale, for its slopes may vanish at an optimum. Durations count
    as they are, parameters with what changes states and rows as much as these sizes do. Rows are divided by their
    slope, the objective by what steps of these sizes do to it. No state counts with less than a billionth of its value,
    and the objective, where it has slopes, with no less than these change as all values are rounded so.

    Args:
        gaps: (intervals, n) of the dynamics at a start, where second derivatives are those of the objective. States at
            rest there count with half of how far gaps would move them, and the objective with how it bends: it may
            have no slope where a guess is.
    """
    unit, border = Scales(*map(jnp.asarray, scales)), shooting.border
    before, end_before = of_stages(Step(unit.d, unit.u, unit.border))
    reach = jnp.abs(slopes.defects) * unit.d[1:, :, None] / before[:, None]
    explosive = _explosive(slopes, unit)
    inner_slopes, end_slopes = jnp.abs(slopes.rows) / before[:, None], jnp.abs(slopes.end_rows) / end_before[None]
    d, u, times = jnp.ones_like(unit.d), jnp.ones_like(unit.u), jnp.abs(point.border)[: border.phases]
    moved, told = [], dict[str, jax.Array]()
    values = Step(jnp.zeros_like(unit.d), jnp.zeros_like(unit.u), jnp.abs(point.border))
    for part in shooting.segments:
        own, slices = part.shooting, part.shooting.dynamics.group.slices
        # What drives a state that explodes may drive it against that.
        among = reach[part.stages, : own.n] / explosive[part.stages, : own.n, None]
        most = (among / own.mesh.widths[:, None, None]).max(axis=0)
        drift, limit = jnp.zeros(own.n), jnp.full(own.m, jnp.inf)
        if gaps is None:
            limit = unit.u[part.stages.start, : own.m] * _straight(slopes, part)
        else:
            drift = _drift(slopes, before, gaps, part)
        most_d, most_u = jnp.split(largest_along(part, point), [own.n])
        values = values._replace(d=values.d.at[part.nodes, : own.n].set(most_d))
        values = values._replace(u=values.u.at[part.stages, : own.m].set(most_u))
        own_d, own_u = _completed(
            own, *_spreads(own, part.of(point)), most[:, part.columns], drift, limit, _ROUNDING * most_d
        )
        for name, other in own.alike.items():
            told[name] = told.get(name, own_d[slices.get(other, slices[name])])
            own_d = own_d.at[slices[name]].set(told[name])
        d, u = d.at[part.nodes, : own.n].set(own_d), u.at[part.stages, : own.m].set(own_u)
        moved.append((most, own_d))
    for join in shooting.joins:
        u = u.at[join.stage, : len(join.free)].set(d[join.stage + 1, join.free])
    end_sizes = jnp.concatenate([d[-1], times])
    end_others = end_slopes[:, : len(end_sizes)] @ end_sizes
    whole = jnp.concatenate([d[:-1], u, jnp.broadcast_to(times, (len(u), len(times)))], axis=1)
    others = (inner_slopes[..., : whole.shape[1]] * whole[:, None]).sum(axis=-1)
    moved += [(inner_slopes.max(axis=0), others.max(axis=0)), (end_slopes, end_others)]
    b = _border(border, point.border, moved)
    if gaps is None:  # later on: a parameter whose slopes vanish, as at its optimum they may, keeps its size
        b = jnp.minimum(b, jnp.maximum(unit.border, jnp.abs(point.border)))
    z, end = of_stages(Step(d, u, b))
    inner = (inner_slopes * z[:, None]).sum(axis=-1) * unit.rows[: inner_slopes[..., 0].size].reshape(len(z), -1)
    for part in shooting.segments:
        inner = inner.at[part.stages].set(inner[part.stages].max(axis=0, initial=0.0))
    rows = jnp.concatenate([inner.ravel(), end_slopes @ end * unit.rows[inner.size :]])
    z, end = z / before / explosive.max(axis=1)[:, None], end / end_before
    moves = (jnp.abs(slopes.gradient) * z).sum() + (jnp.abs(slopes.end_gradient) * end).sum()
    cost, sizes = moves * unit.cost, Step(d, u, b)
    if gaps is not None:
        cost = cost + bent(shooting, slopes, unit, sizes, sizes)
    # What rounding of the unknowns does to slopes counts as nothing.
    rounding = 2.0 * _ROUNDING * bent(shooting, slopes, unit, sizes, values)
    cost = jnp.where(cost > 0.0, jnp.maximum(cost, rounding), cost)
    sloped = jnp.isfinite(cost) & (cost > 0.0)
    return Scales(d, u, b, jnp.where(rows > 0.0, rows, unit.rows), jnp.where(sloped, cost, unit.cost)), sloped


def bent(shooting: Transcribed, slopes: Derivatives, scales: Scales, one: Step, other: Step) -> jax.Array:
    """Half of |one'| |H| |other|, H the Lagrangian's second derivatives; zero if it is not finite.

    Args:
        scales: those that slopes are in.
        one, other: sizes of steps.
    """
    own, end_own = of_stages(Step(scales.d, scales.u, scales.border))
    own = own * _explosive(slopes, scales).max(axis=1)[:, None]
    (one_z, one_end), (z, end) = ((a / own, b / end_own) for a, b in map(of_stages, (one, other)))
    there = np.pad(shooting.free.u, ((0, 0), (shooting.n, shooting.border.size)), constant_values=True)
    hessian = jnp.where(there[:, None] & there[:, :, None], jnp.abs(slopes.hessian), 0.0)  # padding bends, in no unit
    found = (hessian * one_z[:, None] * z[:, :, None]).sum()
    found = 0.5 * (found + (jnp.abs(slopes.end_hessian) * one_end[None] * end[:, None]).sum()) * scales.cost
    return jnp.where(jnp.isfinite(found), found, 0.0)


def _explosive(slopes: Derivatives, scales: Scales) -> jax.Array:
    """(intervals, n) by how much too large each interval makes a state; 1 where it does not.

    A step that is too long for stiff dynamics does. What such a step makes of a move is no measure of anything. Of two
    states that drive each other it is the root of what each makes of the other, which has no unit.
    """
    n = scales.d.shape[1]
    reach = jnp.abs(slopes.defects[..., :n]) * scales.d[1:, :, None] / scales.d[:-1, None]
    grown = jnp.sqrt(jnp.minimum(reach, 1e100) * jnp.minimum(reach.swapaxes(1, 2), 1e100))
    return jnp.maximum(grown.max(axis=2) / _EXPLOSIVE, 1.0)


def _border(border: Border, values: jax.Array, moved: Sequence[tuple[jax.Array, jax.Array]]) -> jax.Array:
    """Sizes of durations and parameters, as `measured` says; where nothing is known the value, the limits, 1.

    Moved are the slopes of rows, and how far the sizes of other unknowns move these.
    """
    count, sizes = border.phases, jnp.abs(values)
    if border.size == count:
        return sizes
    found = jnp.full(border.size - count, jnp.inf)
    for rows, others in moved:
        by, size = rows[:, rows.shape[1] - len(found) :], others[:, None]
        known = (by > 0.0) & (size > 0.0)
        found = jnp.minimum(found, jnp.where(known, size / by, jnp.inf).min(axis=0, initial=jnp.inf))
    limits = np.concatenate([np.zeros(0), *map(_from_limits, border.boxes)])
    for known_size in (sizes[count:], jnp.asarray(limits), jnp.ones_like(found)):
        found = jnp.where(jnp.isfinite(found) & (found > 0.0), found, known_size)
    return jnp.concatenate([sizes[:count], found])


def declared(leaves: Sequence[State | Control]) -> Array:
    """The scales that leaves declare, of all their tangents in one vector; 1, and half a radian, where they do not."""
    parts = [np.zeros(0)]
    for leaf in leaves:
        group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
        plain = np.where(group.sized | group.flat, 1.0, _TURN)
        parts.append(plain if leaf.scale is None else np.ravel(leaf.scale))
    return np.concatenate(parts)


def not_below(scales: Scales, seen: Scales, sloped: Any) -> tuple[Scales, Scales]:
    """Scales of unknowns and objective no less than a small share of the largest seen, and the largest seen.

    What falls to zero, as an objective may at its optimum, would else never be small.
    """
    known = scales._replace(cost=jnp.where(sloped, scales.cost, 0.0))
    seen = seen._replace(**{name: jnp.maximum(getattr(known, name), getattr(seen, name)) for name in _FLOORED})
    own = {name: jnp.maximum(getattr(scales, name), SMALL * getattr(seen, name)) for name in _FLOORED}
    return scales._replace(**own), seen


def levelled(shooting: Transcribed, scales: Scales) -> Scales:
    """Scales in which an entry of a vector that hardly moves counts as the one that moves most.

    Vectors that declare a scale keep it, and so do tangents of SO(3) and SE(3), whose axes have one unit.
    """

    def level(sizes: jax.Array, stages: slice, columns: slice) -> jax.Array:
        most = sizes[stages, columns].max(axis=1, keepdims=True)
        return sizes.at[stages, columns].set(jnp.broadcast_to(most, sizes[stages, columns].shape))

    d, u = jnp.asarray(scales.d), jnp.asarray(scales.u)
    for part in shooting.segments:
        own, group = part.shooting, part.shooting.dynamics.group
        for name, factor in group.factors.items():
            if factor.flat and own.leaves[name].scale is None:
                d = level(d, part.nodes, group.slices[name])
        for name, columns in own.local.controls.slices.items():
            if own.leaves[name].scale is None:
                u = level(u, part.stages, columns)
    return scales._replace(d=d, u=u)


def change(one: Scales, other: Scales) -> jax.Array:
    """The largest factor between two sets of scales."""
    ratios = [a / b for a, b in zip(one, other)]
    # One that is infinite in both says nothing, and takes nothing from the others.
    return jnp.stack([jnp.where(jnp.isnan(r), 1.0, jnp.maximum(r, 1.0 / r)).max(initial=1.0) for r in ratios]).max()


def _spreads(shooting: Shooting, point: Point) -> tuple[jax.Array, jax.Array]:
    """Half the spread of every tangent along the trajectory; zero where nothing moves."""
    d, u = [jnp.zeros(0)], [jnp.zeros(0)]
    for name, factor in shooting.dynamics.group.factors.items():
        values, leaf = point.xs[name], shooting.leaves[name]
        if leaf.scale is not None:
            own = jnp.asarray(np.ravel(leaf.scale))
        elif factor.flat:
            flat = values.reshape(len(values), -1)
            own = _moving(_range(flat) / 2.0, flat)
        else:
            own = jnp.full(factor.dimension, _TURN)
            for piece in factor.parts:
                if piece.sized:
                    moved = piece.of(values).reshape(len(values), -1)
                    own = own.at[np.array(piece.entries)].set(_range(moved).max() / 2.0)
        d.append(own)
    for name, part in shooting.local.controls.slices.items():
        flat, leaf = point.us[:, part], shooting.leaves[name]
        spread = _moving(jnp.maximum(_range(flat) / 2.0, _CONSTANT * jnp.abs(flat).max(axis=0)), flat)
        u.append(spread if leaf.scale is None else jnp.asarray(np.ravel(leaf.scale)))
    return jnp.concatenate(d), jnp.concatenate(u)


def _range(values: jax.Array) -> jax.Array:
    return values.max(axis=0) - values.min(axis=0)


def _moving(spread: jax.Array, values: jax.Array) -> jax.Array:
    """Spreads, zero where they are rounding, or nothing beside another entry's."""
    moves = (spread > _NOTHING * spread.max(initial=0.0)) & (spread > _ROUNDING * jnp.abs(values).max(axis=0))
    return jnp.where(moves, spread, 0.0)


def _straight(slopes: Derivatives, part: Segment) -> jax.Array:
    """How many scales of each control bend the Lagrangian by the objective's scale, 1 at least; inf where none do."""
    first, m = slopes.defects.shape[1], part.shooting.m
    bends = jnp.abs(slopes.hessian[part.stages, first : first + m, first : first + m])
    bent = jnp.where(np.eye(m, dtype=bool), bends, 0.0).sum(axis=(0, 2)) / 2.0
    return jnp.where(bent > SMALL**2, 1.0 / jnp.sqrt(jnp.clip(bent, SMALL**2, 1.0)), jnp.inf)


def _drift(slopes: Derivatives, before: jax.Array, gaps: jax.Array, part: Segment) -> jax.Array:
    """Half of how far gaps move the states of a phase: along linear dynamics, or alone where these grow far."""
    n = part.shooting.n
    own, jumps = slopes.defects[part.stages, :n, :n] / before[part.stages, None, :n], gaps[part.stages, :n]
    alone = jnp.abs(jumps).sum(axis=0)

    def ahead(way: tuple[jax.Array, jax.Array], stage: Any) -> tuple[tuple[jax.Array, jax.Array], None]:
        moved = stage[0] @ way[0] + stage[1]
        return (moved, jnp.maximum(way[1], jnp.abs(moved))), None

    (_, most), _ = jax.lax.scan(ahead, (jnp.zeros(n), jnp.zeros(n)), (own, jumps))
    once = jnp.maximum(alone, (jnp.abs(own).max(axis=0) * alone[None]).max(axis=1) * len(own))
    return _finite(jnp.where(most * _NOTHING <= once, most, alone) / 2.0)


def _completed(
    shooting: Shooting,
    d: jax.Array,
    u: jax.Array,
    slopes: jax.Array,
    drift: jax.Array,
    limit: jax.Array,
    least: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Sizes for what has none: from what it moves along the whole trajectory, from what moves it, from limits, though
    no more than other entries of its vector have, from these, of controls before those of states, 1.

    Slopes are the largest of the dynamics over an interval as long as the trajectory, (n, n + m); states that others
    move count with their drift at least, controls that move others with their limit at most. No state counts with less
    than `least`, (n,).
    """
    n, declared = shooting.n, _declared(shooting)
    largest = jnp.concatenate([jnp.full(n, jnp.inf), jnp.maximum(limit, u)])
    own = np.arange(n + shooting.m) == np.arange(n)[:, None]
    reach = jnp.where(own, 0.0, slopes)
    sizes = jnp.where(declared, jnp.concatenate([d, u]), _without_noise(d, u, reach))
    limits = np.concatenate([_from_limits(leaf) for leaf in shooting.leaves.values()])

    def further(own: Any) -> Any:
        sizes, _, count = own
        back = _back(sizes[:n], reach)
        found = jnp.where((sizes > 0.0) | ~jnp.isfinite(back), sizes, jnp.minimum(back, largest))
        ahead = jnp.maximum((reach * found[None]).max(axis=1), drift)
        found = jnp.concatenate([jnp.where(found[:n] > 0.0, found[:n], ahead), found[n:]])
        return found, (found != sizes).any(), count + 1

    def complete(sizes: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        # Limits may be as wide as they like: they say no more than the other entries of a vector do.
        known, level = now[0], jnp.where(siblings, sizes[None], 0.0).max(axis=1)
        known = jnp.where(level > 0.0, jnp.minimum(known, level), jnp.where(jnp.isfinite(known), known, now[1]))
        begin = jnp.where(sizes > 0.0, sizes, known), jnp.ones((), bool), jnp.zeros((), int)
        return jax.lax.while_loop(lambda own: own[1] & (own[2] < len(sizes)), further, begin)[0], None

    nothing, siblings = np.zeros(len(limits)), _siblings(shooting)
    # Units of a state's entries may differ: what controls do to one says more than its neighbours.
    controls = np.where(np.arange(len(limits)) < n, 0.0, np.inf)
    rounds = jnp.stack([nothing, limits, controls, nothing + np.inf]), jnp.array([0.0, 0.0, 0.0, 1.0])
    sizes, _ = jax.lax.scan(complete, sizes, rounds)
    # What hardly moves, and what hardly moves others, is not measured by how little it does.
    floor = jnp.maximum(SMALL * (reach * sizes[None]).max(axis=1), least)
    weak = jnp.minimum(_finite(_back(jnp.maximum(sizes[:n], floor), reach)[n:]), largest[n:])
    floor = jnp.concatenate([floor, _WEAK * weak])
    sizes = jnp.where(declared, sizes, jnp.maximum(sizes, floor))
    return sizes[:n], sizes[n:]


def _declared(shooting: Shooting) -> Array:
    """Which tangents and controls have a size from their leaf."""
    found = np.zeros(shooting.n + shooting.m, bool)
    places = [(name, part, 0) for name, part in shooting.dynamics.group.slices.items()]
    places += [(name, part, shooting.n) for name, part in shooting.local.controls.slices.items()]
    for name, part, before in places:
        found[before:][part] = shooting.leaves[name].scale is not None
    return found


def _siblings(shooting: Shooting) -> Array:
    """(n + m, n + m) which tangents and controls are entries of one vector, the axes of a place among them."""
    found, turns = np.zeros((shooting.n + shooting.m,) * 2, bool), np.pad(shooting.turns, (0, shooting.m))
    for places, first in ((shooting.dynamics.group.slices, 0), (shooting.local.controls.slices, shooting.n)):
        for part in places.values():
            own = first + np.arange(part.start, part.stop)
            own = own[~turns[own]]
            found[np.ix_(own, own)] = True
    return found


def _without_noise(d: jax.Array, u: jax.Array, reach: jax.Array) -> jax.Array:
    """Sizes, zero where a guess at rest has noise: what would move no other, and what others move far more."""
    n = len(d)
    reach = jnp.minimum(reach, 1e100)  # products stay finite
    small = d < _NOTHING * _finite(_back(d, reach)[:n])
    moves = u >= _NOTHING * _finite(_back(jnp.where(small, 0.0, d), reach)[n:])
    left = jnp.concatenate([jnp.where(small, 0.0, d), jnp.where(moves, u, 0.0)])
    ahead = (reach * left[None]).max(axis=1)
    # Not where states drive each other far apart: there little may move much.
    calm = (reach[:, :n] * reach[:, :n].T).max(axis=1) < 1.0 / _NOTHING
    noise = calm & ((d < _NOTHING * ahead) | (small & (ahead == 0.0)))
    return jnp.concatenate([jnp.where(noise, 0.0, d), jnp.where(moves, u, 0.0)])


def _finite(values: jax.Array) -> jax.Array:
    return jnp.where(jnp.isfinite(values), values, 0.0)


def _back(d: jax.Array, reach: jax.Array) -> jax.Array:
    """How large what moves a state is, to move it by its size; infinite where it moves none of known size."""
    rows = d[:, None]
    return jnp.where((reach > 0.0) & (rows > 0.0), rows / reach, jnp.inf).min(axis=0)


def _from_limits(leaf: State | Control) -> Array:
    """Half the width of a box, or the size of its one side; zero without a box."""
    group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
    if not group.flat:
        return np.zeros(group.dimension)
    low = np.full(leaf.shape, np.nan) if leaf.min is None else np.where(np.isfinite(leaf.min), leaf.min, np.nan)
    high = np.full(leaf.shape, np.nan) if leaf.max is None else np.where(np.isfinite(leaf.max), leaf.max, np.nan)
    width = np.where(np.isnan(low + high), np.fmax(np.abs(low), np.abs(high)), (high - low) / 2.0)
    return np.nan_to_num(width).ravel()
