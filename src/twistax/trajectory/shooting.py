"""Multiple shooting in the tangent space: values, first and second derivatives of a discrete problem.

The unknowns are a step z = (d_0, du_0, ..., d_(K-1), du_(K-1), d_K, db) away from the nodes x_k, held controls u_k, and
the border b, which has the final time T and free parameters; nodes move by x_k (+) d_k, so the chart is re-based at
every iterate. Interval k is integrated in exponential coordinates about x_k, in time made dimensionless by T, by an
explicit Runge-Kutta method. It gives

    F_k(d_k, du_k, db) = Log(x_(k+1)^-1 x_k Exp(eta_k)),   and the dynamics say d_(k+1) = F_k,

the rows of constraints at the ends of its substeps, and its share of the running cost by a rule of quadrature.
Second derivatives of sum y.F + w.rows + cost follow from the adjoints of the stages: every stage adds G' M G, with M
the second derivative of the rates weighted by its adjoint and G its sensitivity to (d, du, db).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from ..groups import SpecialEuclidean, SpecialOrthogonal
from ..integrators import RKMK
from ..lowering import XLA, Dynamics
from ..lowering.backends import chosen
from ..lowering.dynamics import Arrays
from ..lowering.native.backend import Auto, Native, installed
from .border import Border
from .conditions import Conditions, Ends
from .cones import NormControls
from .local import Local
from .smooth import Smooth
from .statement import Objective, PathRows


class Point(NamedTuple):
    """Where an optimisation stands: states (nodes, ...), flat controls (nodes - 1, m), border (g,)."""

    xs: Any
    us: Any
    border: Any


class Given(NamedTuple):
    """What a compiled problem is solved for."""

    params: Any
    final: Any  # states at the end; entries that are free stand for nothing
    limits: Any  # (g, 2) of the border
    margins: Any = 0.0  # (rows,) by which rows are tightened


class Step(NamedTuple):
    """A step in the tangent space, or anything with an entry for each unknown."""

    d: Any  # (nodes, n)
    u: Any  # (intervals, m)
    border: Any  # (g,)


class Values(NamedTuple):
    """A problem's values at a point."""

    cost: Any
    defects: Any  # (intervals, n)
    rows: Any  # (rows,) those of all intervals, then those of the end; <= 0 or = 0


class Derivatives(NamedTuple):
    """Derivatives at a point, by z_k = [d_k, du_k, db] of each interval and z_K = [d_K, db] of the end."""

    defects: Any  # (intervals, n, n + m + g)
    rows: Any  # (intervals, R, n + m + g)
    end_rows: Any  # (R_end, n + g)
    gradient: Any  # (intervals, n + m + g) of the cost
    end_gradient: Any  # (n + g,)
    hessian: Any  # (intervals, n + m + g, n + m + g) of cost + y.defects + w.rows
    end_hessian: Any  # (n + g, n + g)


class Segment(NamedTuple):
    """A transcribed phase, and where its nodes, intervals, and [d, u, b] sit among those of the whole problem."""

    number: int
    shooting: Shooting
    nodes: slice
    stages: slice
    columns: Any
    alone: bool = False

    def of(self, point: Point) -> Point:
        """The point of the phase."""
        if self.alone:
            return point
        return Point(point.xs[self.number], point.us[self.stages, : self.shooting.m], point.border)


class Transcribed:
    """What solvers are given: a discrete problem in stages.

    Attributes:
        n, m: tangents of a node and controls of an interval, of the largest phase.
        nodes, intervals, rows_per_interval: how many.
        border: the unknowns that all stages share.
        names, places: of every row.
        equality, exists: (rows,) which rows are equalities; which are asked at all.
        decided: (rows,) those that no unknown changes, for the ends decide them; they are only checked.
        pinned: (rows,) those of them that other rows decide.
        own: (rows,) those of single nodes.
        free: Step of bool, which unknowns may move.
        stirred: (nodes, n) tangents that random steps move: the free ones but what the end fixes, for rows that this
            decides are looked at where a search starts.
        turns: (n,) or (nodes, n) which tangents are rotations.
        segments, joins: the phases, and what is between them.
    """

    n: int
    m: int
    nodes: int
    intervals: int
    rows_per_interval: int
    border: Border
    names: Array
    places: Array
    equality: Array
    exists: Array
    decided: Array
    pinned: Array
    own: Array
    free: Step
    stirred: Array
    turns: Array
    segments: Sequence[Segment]
    joins: Sequence[Any]

    def drop_pinned(self, samples: Sequence[Point], given: Given) -> None:
        """Take rows out that leave no room for slacks."""
        raise NotImplementedError

    def move(self, point: Point, step: Step) -> Point:
        """The point after a step."""
        raise NotImplementedError

    def values(self, point: Point, given: Given, d: jax.Array | None = None) -> Values:
        """Cost, defects and rows at a point, or a step d (nodes, n) of its nodes away in their charts."""
        raise NotImplementedError

    def derivatives(
        self, point: Point, y: jax.Array, w: jax.Array, given: Given, d: jax.Array | None = None
    ) -> Derivatives:
        """First derivatives, and the second of cost + y.defects + w.rows; y as the defects, w as the rows."""
        raise NotImplementedError


class Shooting(Transcribed):
    """The discrete problem behind a continuous one, or behind one phase of it.

    Attributes:
        phase: its number.
        leaves: states and controls by name, in the order of the unknowns.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        objective: Objective,
        *,
        method: RKMK,
        nodes: int,
        substeps: int,
        path: PathRows,
        norms: NormControls,
        ends: Ends,
        final: Conditions,
        at_nodes: Mapping[int, Conditions],
        border: Border,
        phase: int = 0,
    ) -> None:
        self.phase, self._is_last = phase, phase == border.phases - 1
        self.leaves: dict[str, State | Control] = {leaf.name: leaf for leaf in dynamics.states}
        self.leaves |= {leaf.name: leaf for leaf in (*dynamics.controls, *norms.controls)}
        self.dynamics, self.nodes, self.substeps = dynamics, nodes, substeps
        self.intervals = nodes - 1
        self.local = Local(dynamics, path, objective, norms, final)
        self.n, self.m = dynamics.dimension, self.local.controls.dimension
        self.border = border
        self.size = self.n + self.m + border.size
        self.path = path
        self.backend = backend = chosen(
            "auto" if isinstance(dynamics.backend, Auto) else dynamics.backend, Native() if installed() else XLA()
        )
        self._rate, self._point = Smooth(self._rate_at, backend), Smooth(self._point_at, backend)
        self._gap, self._end = Smooth(self.local.gap, backend), Smooth(self._end_at, backend)
        self._nodes = {k: Smooth(functools.partial(self._node_at, k, own), backend) for k, own in at_nodes.items()}
        #: Where [d, b] sit in [d, u, b].
        self._seen = np.array([*range(self.n), *range(self.n + self.m, self.size)])
        tableau = method.tableau
        self._a, self._c = tableau.counted
        self._b = tableau.b[: len(self._c)]
        self._weights = _weights(substeps)
        self.turns = _turns(dynamics)
        self._describe(path, ends, final, at_nodes)
        whole = slice(0, self.nodes), slice(0, self.intervals), np.arange(self.n + self.m)
        self.segments, self.joins = [Segment(0, self, *whole, alone=True)], []

    def _describe(self, path: PathRows, ends: Ends, final: Conditions, at_nodes: Mapping[int, Conditions]) -> None:
        """Which rows there are, and which unknowns may move."""
        count, points, rows = self.intervals, self.substeps + 1, len(path.names)
        asked = path.asked(count, self.substeps)
        decided = np.zeros_like(asked)
        times_free = self.border.free[: self.border.phases]
        known_start = not times_free[: self.phase].any()
        decided[0, 0] = path.decided(ends.initial_fixed, known_start)
        flat = asked.reshape(count, -1)
        self._row_count = rows
        self._kept = kept = np.flatnonzero(flat.any(axis=0))
        states = np.flatnonzero(path.at_nodes())
        self._end_states = states
        self._fixed = np.flatnonzero(ends.final_mask)
        tangents = [
            f"{name}{_entry(i, part)}"
            for name, part in self.dynamics.group.slices.items()
            for i in range(part.stop - part.start)
        ]
        limits = self.border.row_names if self._is_last else []
        end_names = [
            *final.names,
            *(f"final {tangents[i]}" for i in self._fixed),
            *(path.names[i] for i in states),
            *limits,
        ]
        place = np.array(
            [
                [
                    f"at node {k}"
                    if p == 0
                    else f"at node {k + 1}"
                    if p == points - 1
                    else f"between nodes {k} and {k + 1}"
                    for p in range(points)
                ]
                for k in range(count)
            ]
        )
        place = np.repeat(place.reshape(count, points, 1), rows, axis=2).reshape(count, -1)[:, kept]
        most = max((len(own.names) for own in at_nodes.values()), default=0)
        node_names = np.full((count, most), "", object)
        node_equality, node_decided = np.zeros((2, count, most), bool)
        loose = [box.name for box in self.border.boxes]
        for k, own in at_nodes.items():
            here = slice(len(own.names))
            node_names[k, here], node_equality[k, here] = own.names, own.equality
            if k == 0:
                node_decided[0, here] = own.decided(ends.initial_fixed, loose, known_start)
        node_places = np.repeat(np.array([[f"at node {k}"] for k in range(count)], object), most, axis=1)

        def joined(inner: Any, at_node: Array, end: Any) -> Array:
            return np.concatenate([np.concatenate([inner, at_node], axis=1).ravel(), end])

        inner_names = np.tile(np.array(path.names, object)[kept % max(rows, 1)], (count, 1))
        self.names = joined(inner_names, node_names, np.array(end_names, object))
        self.places = joined(place, node_places, np.full(len(end_names), f"at node {count}", object))
        end_equality = [*final.equality, *[True] * len(self._fixed), *path.equality[states], *[False] * len(limits)]
        inner_equality = np.tile(path.equality[kept % max(rows, 1)], (count, 1))
        self.equality = joined(inner_equality, node_equality, np.array(end_equality, bool))
        end_decided = np.zeros(len(end_names), bool)
        first = len(final.names) + len(self._fixed)
        end_decided[first : first + len(states)] = path.decided(
            ends.final_fixed, not times_free[: self.phase + 1].any()
        )[states]
        #: Rows of single nodes: conditions, fixed entries, limits of the border.
        end_own = np.repeat([True, False, True], [first, len(states), len(limits)])
        self.own = joined(np.zeros((count, len(kept)), bool), node_names != "", end_own)
        self.decided = joined((decided.reshape(count, -1) & flat)[:, kept], node_decided, end_decided)
        every = joined(flat[:, kept], node_names != "", np.ones(len(end_names), bool))
        self.exists = every & ~self.decided
        self.pinned = np.zeros_like(self.exists)
        self._node_counts = {k: len(own.names) for k, own in at_nodes.items()}
        self._node_rows, self.rows_per_interval = most, len(kept) + most
        self.states = tangents
        free_d = np.ones((self.nodes, self.n), bool)
        if self.phase == 0:
            free_d[0] = ~ends.initial_mask
        self.free = Step(free_d, np.ones((count, self.m), bool), self.border.free)
        self.stirred = free_d.copy()
        self.stirred[-1, self._fixed] = False

    def start_rows(self) -> list[tuple[int, int]]:
        """Of the path rows at the first node: where they are among all rows, and which they are."""
        return [(place, int(row)) for place, row in enumerate(self._kept) if row < self._row_count]

    def drop_pinned(self, samples: Sequence[Point], given: Given) -> None:
        """Take inequalities at nodes out that the equalities there decide: their slopes lie in the span of those.

        Two such rows leave no room for slacks. They count as decided, if it is so at all sample points, with these
        parameters and with others: the next solve may have those.
        """
        others = [stirred(np.random.default_rng(i), given.params) for i in range(2)]
        pairs = [(p, given._replace(params=own)) for p, own in zip(itertools.cycle(samples), (given.params, *others))]
        inner, zero = self.intervals * self.rows_per_interval, np.zeros(self.n + self.border.size)
        ends = jax.jit(lambda z, point, given: self._end.slopes(z, self._here(-1, point), given)[:-1])
        self._drop(np.arange(inner, len(self.exists)), np.zeros((0, len(zero))), lambda *own: ends(zero, *own), pairs)
        held = np.eye(self.n, self.size)[~self.free.d[0]]
        for k in sorted({0, *self._nodes}):
            slopes = jax.jit(functools.partial(self._slopes_at_node, k))
            at_start = np.flatnonzero(self._kept < self._row_count)
            places = np.concatenate([at_start, len(self._kept) + np.arange(self._node_counts.get(k, 0))])
            places = k * self.rows_per_interval + places
            self._drop(places, held if k == 0 else held[:0], slopes, pairs)

    def _slopes_at_node(self, k: int, point: Point, given: Given) -> jax.Array:
        """Of the path rows at the start of an interval and of the conditions there, by [d, u, b]."""
        base, zero = {name: a[k] for name, a in point.xs.items()}, jnp.zeros(self.n, point.us.dtype)
        share, q = jnp.asarray(k / self.intervals, zero.dtype), self._joined(zero, point.us[k], point.border)
        rows = self._point.slopes(q, share, base, given.params)[self._kept[self._kept < self._row_count]]
        return (
            jnp.concatenate([rows, self._node_slopes(k, point, jnp.zeros((self.nodes, self.n)), given)])
            if k in self._nodes
            else rows
        )

    def _drop(
        self, at: Array, held: Array, slopes: Callable[[Point, Given], Any], samples: Sequence[tuple[Point, Given]]
    ) -> None:
        """Take rows out that lie in the span of the equalities among them and of what is held, at all samples."""
        equality, pinned = (self.exists & self.equality)[at], (self.exists & ~self.equality)[at]
        if not (equality.any() or len(held)) or not pinned.any():
            return
        seen = np.zeros_like(pinned)
        for found in (np.asarray(slopes(*sample)) for sample in samples):
            # A random sample may lie where a row has no slopes; others tell about it.
            there = np.isfinite(found).all(axis=1)
            found = np.where(there[:, None], found, 0.0)
            base, rows = np.concatenate([held, found[equality]]).T, found.T
            left = rows - base @ np.linalg.lstsq(base, rows, rcond=None)[0]
            size = np.linalg.norm(rows, axis=0)
            pinned = pinned & (~there | ((size > 0.0) & (np.linalg.norm(left, axis=0) <= 1e-9 * size)))
            seen |= there
        pinned &= seen
        self.exists, self.decided, self.pinned = (np.array(a) for a in (self.exists, self.decided, self.pinned))
        self.exists[at[pinned]] = False
        self.pinned[at[pinned]] = self.decided[at[pinned]] = True

    # ---- moves --------------------------------------------------------------------------------------------------

    def move(self, point: Point, step: Step) -> Point:
        """The point after a step."""
        xs = jax.vmap(self.dynamics.group.retract)(point.xs, step.d)
        return Point(xs, point.us + step.u, point.border + step.border)

    def charts(self, xs: Arrays, d: jax.Array) -> jax.Array:
        """(nodes, n, n) derivatives by e at 0 of Log((x Exp(d))^-1 x Exp(d + e)): charts at x to those at x Exp(d)."""
        group = self.dynamics.group

        def change(base: Arrays, d: jax.Array, e: jax.Array) -> jax.Array:
            return group.difference(group.retract(base, d), group.retract(base, d + e))

        return jax.vmap(jax.jacfwd(change, argnums=2), in_axes=(0, 0, None))(xs, d, jnp.zeros(self.n, d.dtype))

    # ---- values -------------------------------------------------------------------------------------------------

    def values(self, point: Point, given: Given, d: jax.Array | None = None) -> Values:
        """Cost, defects and rows at a point, or a step d (nodes, n) of its nodes away in their charts."""
        left, right = _sides(point.xs)
        d = jnp.zeros((self.nodes, self.n), point.us.dtype) if d is None else d
        etas, _ = jax.vmap(self._roll, in_axes=(0, 0, 0, 0, None, None))(
            self._numbers(point), left, d[:-1], point.us, point.border, given.params
        )
        rows, density = self._at_points(point, left, etas, given.params)
        defects = jax.vmap(self._gap)(etas[:, -1], left, right) - d[1:]
        cost = jnp.sum(density @ jnp.asarray(self._weights, density.dtype)) / self.intervals
        end = self._end(self._place(-1, d), self._here(-1, point), given)
        at_nodes = {k: node(self._place(k, d), self._here(k, point), given.params) for k, node in self._nodes.items()}
        rows = jnp.concatenate([rows, self._spread(at_nodes, rows)], axis=1)
        return Values(cost + end[-1], defects, jnp.concatenate([rows.reshape(-1), end[:-1]]) + given.margins)

    def spread_over_points(self, of_rows: Array) -> Array:
        """(rows,) of numbers (intervals, path rows), at every point of an interval where a row is asked."""
        found = np.zeros((self.intervals, self.rows_per_interval))
        found[:, : len(self._kept)] = of_rows[:, self._kept % max(self._row_count, 1)]
        return np.concatenate([found.ravel(), np.zeros(len(self.exists) - found.size)])

    def path_scales(self, rows: Array) -> Array:
        """(path rows,) the least scale of every path row, infinite where it is asked nowhere; of the scales of rows."""
        found, columns = np.full(self._row_count, np.inf), self._kept % max(self._row_count, 1)
        inner = (self.intervals, self.rows_per_interval)
        sizes, exists = (a[: inner[0] * inner[1]].reshape(inner)[:, : len(columns)] for a in (rows, self.exists))
        np.minimum.at(found, columns, np.where(exists, sizes, np.inf).min(axis=0, initial=np.inf))
        return found

    def advanced(self, number: jax.Array, base: Arrays, u: jax.Array, border: jax.Array, params: Arrays) -> Arrays:
        """The end of an interval, given its number, that starts at a node."""
        etas, _ = self._roll(number, base, jnp.zeros(self.n, u.dtype), u, border, params)
        return self.dynamics.group.retract(base, etas[-1])

    def _node_at(
        self, k: int, conditions: Conditions, z: jax.Array, here: tuple[Arrays, jax.Array], params: Arrays
    ) -> jax.Array:
        """The conditions at a node after a step z = [d, db] of it."""
        b = here[1] + z[self.n :]
        x = self.dynamics.group.retract(here[0], z[: self.n])
        begin, length = self.span(b)
        return conditions.values(begin + k / self.intervals * length, x, params | self.border.params(b))

    def _spread(self, parts: Mapping[int, jax.Array], like: jax.Array) -> jax.Array:
        """Rows of single nodes among those of all intervals."""
        found = jnp.zeros((self.intervals, self._node_rows, *like.shape[2:]), like.dtype)
        for k, rows in parts.items():
            found = found.at[k, : len(rows)].set(rows)
        return found

    def _numbers(self, point: Point) -> jax.Array:
        return jnp.arange(self.intervals, dtype=point.us.dtype)

    def _here(self, k: int, point: Point) -> tuple[Arrays, jax.Array]:
        """A node and the border."""
        return {name: a[k] for name, a in point.xs.items()}, point.border

    def _place(self, k: int, d: jax.Array) -> jax.Array:
        """[d, db] of a node."""
        return jnp.concatenate([d[k], jnp.zeros(self.border.size, d.dtype)])

    def _rate_at(self, q: jax.Array, share: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        """d eta / d(t / T) at time share * T, of q = [eta, u, b]."""
        eta, u, begin, length, params = self._parts(q, params)
        return length * self.local.rate(begin + share * length, eta, u, base, params)

    def _parts(self, q: jax.Array, params: Arrays) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array, Arrays]:
        """eta, u, when the phase begins and how long it takes, and all parameters."""
        eta, u, b = jnp.split(q, [self.n, self.n + self.m])
        return eta, u, *self.span(b), params | self.border.params(b)

    def span(self, b: Any) -> tuple[Any, Any]:
        """When the phase begins, and how long it takes."""
        return b[: self.phase].sum(), b[self.phase]

    def _roll(
        self, number: jax.Array, base: Arrays, eta: jax.Array, u: jax.Array, border: jax.Array, params: Arrays
    ) -> tuple[jax.Array, jax.Array]:
        """eta at the ends of the substeps (S + 1, n), and of all stages (S, s, n)."""
        length = 1.0 / (self.intervals * self.substeps)
        share = number / self.intervals
        ends, stages = [eta], []
        for s in range(self.substeps):
            slopes: list[jax.Array] = []
            own = []
            for i in range(len(self._b)):
                at = eta + sum(length * self._a[i, j] * slopes[j] for j in range(i) if self._a[i, j])
                own.append(at)
                time = share + (s + self._c[i]) * length
                slopes.append(self._rate(self._joined(at, u, border), jnp.asarray(time), base, params))
            eta = eta + length * (jnp.asarray(self._b, u.dtype) @ jnp.stack(slopes))
            ends.append(eta)
            stages.append(jnp.stack(own))
        return jnp.stack(ends), jnp.stack(stages)

    @staticmethod
    def _joined(eta: jax.Array, u: jax.Array, border: jax.Array) -> jax.Array:
        return jnp.concatenate([eta, u, border])

    def _shares(self, number: jax.Array) -> jax.Array:
        """t / T at the ends of the substeps."""
        return (number + jnp.linspace(0.0, 1.0, self.substeps + 1, dtype=number.dtype)) / self.intervals

    def _point_at(self, q: jax.Array, share: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        """The path rows, and the running cost times T."""
        eta, u, begin, length, params = self._parts(q, params)
        rows, density = self.local.point(begin + share * length, eta, u, base, params)
        return jnp.append(rows, length * density)

    def _at_points(self, point: Point, left: Arrays, etas: jax.Array, params: Arrays) -> tuple[jax.Array, jax.Array]:
        """Rows (intervals, R) and T times the running cost (intervals, S + 1)."""

        def one(share: jax.Array, eta: jax.Array, u: jax.Array, base: Arrays) -> jax.Array:
            return self._point(self._joined(eta, u, point.border), share, base, params)

        shares = jax.vmap(self._shares)(self._numbers(point))
        found = jax.vmap(jax.vmap(one, in_axes=(0, 0, None, None)))(shares, etas, point.us, left)
        return found[..., :-1].reshape(self.intervals, -1)[:, self._kept], found[..., -1]

    def _end_at(self, z: jax.Array, last: tuple[Arrays, jax.Array], given: Given) -> jax.Array:
        """The rows of the end and the final cost after a step z = [d, db] of the last node."""
        base, b = last[0], last[1] + z[self.n :]
        params = given.params | self.border.params(b)
        begin, length = self.span(b)
        conditions, gap, path, cost = self.local.end(begin + length, z[: self.n], base, given.final, params)
        limits = self.border.rows(b, given.limits) if self._is_last else jnp.zeros(0, b.dtype)
        return jnp.concatenate([conditions, gap[self._fixed], path[self._end_states], limits, cost[None]])

    # ---- derivatives --------------------------------------------------------------------------------------------

    def derivatives(
        self, point: Point, y: jax.Array, w: jax.Array, given: Given, d: jax.Array | None = None
    ) -> Derivatives:
        """First derivatives, and the second of cost + y.defects + w.rows; y as the defects, w as the rows."""
        left, right = _sides(point.xs)
        d = jnp.zeros((self.nodes, self.n), y.dtype) if d is None else d
        split = self.intervals * self.rows_per_interval
        inner, own = jnp.split(w[:split].reshape(self.intervals, -1), [len(self._kept)], axis=1)
        found = jax.vmap(self._interval, in_axes=(0, 0, 0, 0, 0, 0, 0, None, None))(
            self._numbers(point),
            left,
            d[:-1],
            point.us,
            right,
            y,
            inner,
            point.border,
            given.params,
        )
        defects, rows, gradient, hessian = found
        slopes, hessian = self._node_derivatives(point, d, own, given, rows, hessian)
        rows = jnp.concatenate([rows, slopes], axis=1)
        last = self._here(-1, point)
        at = self._place(-1, d)
        end = self._end.slopes(at, last, given)
        end_hessian = self._end.bends(jnp.append(w[split:], 1.0), at, last, given)
        return Derivatives(defects, rows, end[:-1], gradient, end[-1], hessian, end_hessian)

    def _node_derivatives(
        self, point: Point, d: jax.Array, w: jax.Array, given: Given, rows: jax.Array, hessian: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Slopes of the conditions at nodes, and the second derivatives with theirs."""
        found = {}
        for k, node in self._nodes.items():
            found[k] = self._node_slopes(k, point, d, given)
            bend = node.bends(w[k, : len(found[k])], self._place(k, d), self._here(k, point), given.params)
            hessian = hessian.at[k, self._seen[:, None], self._seen[None]].add(bend)
        return self._spread(found, rows), hessian

    def _node_slopes(self, k: int, point: Point, d: jax.Array, given: Given) -> jax.Array:
        """Of the conditions at a node by [d, u, b]."""
        slopes = self._nodes[k].slopes(self._place(k, d), self._here(k, point), given.params)
        return jnp.zeros((len(slopes), self.size), slopes.dtype).at[:, self._seen].set(slopes)

    def _interval(
        self,
        number: jax.Array,
        base: Arrays,
        start: jax.Array,
        u: jax.Array,
        target: Arrays,
        y: jax.Array,
        w: jax.Array,
        border: jax.Array,
        params: Arrays,
    ) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Derivatives of F and of the rows, gradient of the cost, second derivative of the weighted sum."""
        n, size, substeps = self.n, self.size, self.substeps
        stages, length = len(self._b), 1.0 / (self.intervals * self.substeps)
        a, b = jnp.asarray(self._a, u.dtype), jnp.asarray(self._b, u.dtype)
        etas, points = self._roll(number, base, start, u, border, params)
        join = lambda e: self._joined(e, u, border)  # noqa: E731

        def along(rows: jax.Array, maps: jax.Array) -> jax.Array:
            """Slopes (..., n + m + g) by q along the sensitivities of eta; the rest of q are unknowns themselves."""
            return rows[..., :n] @ maps + jnp.concatenate([jnp.zeros_like(rows[..., :n]), rows[..., n:]], axis=-1)

        # Sensitivities of the stages and of the ends of the substeps to z.
        shares = number / self.intervals + length * (np.arange(substeps)[:, None] + self._c[None, :])
        qs = jax.vmap(jax.vmap(join))(points)
        every = lambda f: jax.vmap(f, in_axes=(0, 0, None, None))  # noqa: E731
        slopes = every(every(self._rate.slopes))(qs, jnp.asarray(shares), base, params)  # (S, s, n, size)
        sensitivity = jnp.eye(n, size, dtype=u.dtype)
        ends, inner = [sensitivity], []
        for s in range(substeps):
            moved: list[jax.Array] = []
            for i in range(stages):
                at = sensitivity + sum(
                    (length * a[i, j] * moved[j] for j in range(i) if self._a[i, j]), jnp.zeros_like(sensitivity)
                )
                inner.append(at)
                moved.append(along(slopes[s, i], at))
            sensitivity = sensitivity + length * jnp.einsum("i,ijk->jk", b, jnp.stack(moved))
            ends.append(sensitivity)
        maps, end_maps = jnp.stack(inner), jnp.stack(ends)

        def bent(bends: jax.Array, maps: jax.Array) -> jax.Array:
            """The sum of second derivatives (k, n + m + g, n + m + g) by q along sensitivities (k, n, n + m + g)."""
            moved = along(bends, maps)
            found = maps.reshape(-1, size).T @ moved[:, :n].reshape(-1, size)
            rest = moved[:, n:].sum(axis=0)
            return found + jnp.concatenate([jnp.zeros((n, size), rest.dtype), rest])

        # Rows, cost and the gap.
        times, end_qs = self._shares(number), jax.vmap(join)(etas)
        weights = jnp.asarray(self._weights, u.dtype) / self.intervals
        asked = jnp.zeros((substeps + 1) * self._row_count, u.dtype).at[self._kept].set(w).reshape(substeps + 1, -1)
        pushes = jnp.concatenate([asked, weights[:, None]], axis=1)
        point_slopes = every(self._point.slopes)(end_qs, times, base, params)
        point_bends = jax.vmap(self._point.bends, in_axes=(0, 0, 0, None, None))(pushes, end_qs, times, base, params)
        gap_slope = self._gap.slopes(etas[-1], base, target)
        gap_bend = self._gap.bends(y, etas[-1], base, target)
        moved_points = along(point_slopes, end_maps)
        rows = moved_points[:, :-1].reshape(-1, size)[self._kept]
        gradient = weights @ moved_points[:, -1]

        # Adjoints, last substep first.
        pulls = jnp.einsum("pr,pri->pi", pushes, point_slopes)
        adjoint = y @ gap_slope + pulls[-1, :n]
        adjoints: list[Any] = [None] * (substeps * stages)
        for s in reversed(range(substeps)):
            through: list[Any] = [None] * stages
            for i in reversed(range(stages)):
                own = length * b[i] * adjoint
                for j in range(i + 1, stages):
                    if self._a[j, i]:
                        own = own + length * a[j, i] * through[j]
                adjoints[s * stages + i] = own
                through[i] = own @ slopes[s, i, :, :n]
            adjoint = adjoint + sum(through) + pulls[s, :n]
        bends = jax.vmap(self._rate.bends, in_axes=(0, 0, 0, None, None))(
            jnp.stack(adjoints), qs.reshape(-1, size), jnp.asarray(shares).reshape(-1), base, params
        )
        hessian = bent(bends, maps) + bent(point_bends, end_maps) + ends[-1].T @ gap_bend @ ends[-1]
        return gap_slope @ ends[-1], rows, gradient, 0.5 * (hessian + hessian.T)


def _turns(dynamics: Dynamics) -> Array:
    parts = [np.zeros(0, bool)]
    for factor in dynamics.group.factors.values():
        turns = np.full(factor.dimension, isinstance(factor, SpecialOrthogonal))
        if isinstance(factor, SpecialEuclidean):
            turns = np.asarray(factor.order.from_linear_first(np.repeat([0.0, 1.0], 3))) > 0.0
        parts.append(turns)
    return np.concatenate(parts)


def stirred(rng: np.random.Generator, values: Any) -> Any:
    """Arrays with every entry changed at random, by a third of its size at most; zeros no longer are."""

    def one(a: Any) -> Array:
        here = np.asarray(a, float)
        return np.asarray(here + rng.uniform(0.1, 0.3, here.shape) * np.where(here == 0.0, 1.0, here))

    return jax.tree.map(one, values)


def _sides(xs: Arrays) -> tuple[Arrays, Arrays]:
    """The nodes at which intervals begin, and those at which they end."""
    return {name: a[:-1] for name, a in xs.items()}, {name: a[1:] for name, a in xs.items()}


def _entry(number: int, part: slice) -> str:
    return f"[{number}]" if part.stop - part.start > 1 else ""


def _weights(substeps: int) -> Array:
    """Weights of the points of a unit interval: Simpson's rule, the trapezoid rule where substeps are odd."""
    weights = np.ones(substeps + 1)
    if substeps % 2:
        weights[1:-1] = 2.0
    else:
        weights[1:-1:2] = 4.0
        weights[2:-1:2] = 2.0
    return weights / weights.sum()
