"""Multiple shooting in the tangent space: values, first and second derivatives of a discrete problem.

The unknowns are a step z = (d_0, du_0, ..., d_(K-1), du_(K-1), d_K, db) away from the nodes x_k, held controls u_k, and
the border b, which has the final time T and free parameters; nodes move by x_k (+) d_k, so the chart is re-based at
every iterate. Interval k is integrated in exponential coordinates about x_k, in time made dimensionless by T. It gives

    F_k(d_k, du_k, db) = Log(x_(k+1)^-1 x_k Exp(eta_k)),   and the dynamics say d_(k+1) = F_k,

the rows of constraints at the ends of its substeps, and its share of the running cost by a rule of quadrature.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Control, Expr, State
from ..scalar.backends import XLA, chosen
from ..scalar.targets.llvm.backend import Auto, Native, installed
from ..system import entry_names
from ..system.dynamics import Arrays, Dynamics
from .border import Border
from .by_node import ByNode
from .conditions import Conditions, Ends
from .cones import NormControls
from .interval import Interval, Slot
from .layout import laid_out
from .local import Local
from .mesh import Mesh
from .smooth import Smooth
from .statement import Objective, PathRows
from .transcribed import Derivatives, Given, Point, Segment, Step, Transcribed, Values
from .transcription import Collocation, MultipleShooting


class Shooting(Transcribed):
    """The discrete problem behind a continuous one, or behind one phase of it.

    Args:
        pace: the control that says how long intervals are over what their shares say.

    Attributes:
        phase: its number.
        leaves: states and controls by name, in the order of the unknowns.
        states: names of the states' tangents.
        turns: (n,) which tangents are rotations.
        paced: where the control stands that says how long intervals are.
        by_node: the parameters that have a value for each node.
        alike: state -> the one whose scale it has, in this phase or in the first.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        objective: Objective,
        *,
        transcription: MultipleShooting | Collocation,
        mesh: Mesh,
        path: PathRows,
        norms: NormControls,
        ends: Ends,
        final: Conditions,
        at_nodes: Mapping[int, Conditions],
        border: Border,
        phase: int = 0,
        pace: str | None = None,
        by_node: ByNode,
    ) -> None:
        self.by_node = by_node
        #: Whether the parameters of nodes come with a value for each node.
        self._interpolates = bool(by_node.leaves)
        self.alike: dict[str, str] = {}
        self.phase, self.is_last = phase, phase == border.phases - 1
        self.leaves: dict[str, State | Control] = {leaf.name: leaf for leaf in dynamics.states}
        self.leaves |= {leaf.name: leaf for leaf in (*dynamics.controls, *norms.controls)}
        self.dynamics, self.mesh, self.substeps = dynamics, mesh, transcription.substeps
        self.nodes, self.intervals = mesh.nodes, mesh.nodes - 1
        #: Names of controls that are slacks.
        self.slacks = frozenset(slack.name for slack in getattr(norms, "slacks", {}).values())
        self.local = Local(dynamics, path, objective, norms, final)
        self.n, self.m = dynamics.dimension, self.local.controls.dimension
        self.border = border
        self.paced = None if pace is None else self.local.controls.slices[pace]
        self.size = self.n + self.m + border.size
        self.path = path
        self.backend = backend = chosen(
            "auto" if isinstance(dynamics.backend, Auto) else dynamics.backend, Native() if installed() else XLA()
        )
        self._point, self._gap = Smooth(self.point_at, backend), Smooth(self.local.gap, backend)
        self._end = Smooth(self.end_at, backend)
        self._nodes = {k: Smooth(functools.partial(self._node_at, k, own), backend) for k, own in at_nodes.items()}
        #: Where [d, b] sit in [d, u, b].
        self._seen = np.array([*range(self.n), *range(self.n + self.m, self.size)])
        self.turns = np.concatenate([np.zeros(0, bool), *(g.angular for g in dynamics.group.factors.values())])
        self.states = [
            entry
            for name, factor in dynamics.group.factors.items()
            for entry in entry_names(name, factor.tangent_shape)
        ]
        self._row_count = len(path.names)
        layout = laid_out(self.states, self.intervals, self.substeps, path, ends, final, at_nodes, border, phase)
        self.layout = layout
        self.names, self.places, self.equality, self.own = layout.names, layout.places, layout.equality, layout.own
        self.exists, self.decided, self.pinned = layout.exists, layout.decided, np.zeros_like(layout.exists)
        self.rows_per_interval = layout.per_interval
        self._rate = Smooth(self.rate_at, backend)
        self._interval = self._interval_of(transcription, layout.asked)
        free_d = np.ones((self.nodes, self.n), bool)
        if phase == 0:
            free_d[0] = ~ends.initial_mask
        self.free = Step(free_d, np.ones((self.intervals, self.m), bool), border.free)
        self.stirred = free_d.copy()
        self.stirred[-1, layout.fixed] = False
        whole = slice(0, self.nodes), slice(0, self.intervals), np.arange(self.n + self.m)
        self.segments, self.joins = [Segment(0, self, *whole, alone=True)], []

    def by(self, local: Local) -> Shooting:
        """The same with other functions of single points; only for these."""
        found = copy.copy(self)
        found.local, found._interpolates = local, False
        return found

    def _interval_of(self, transcription: MultipleShooting | Collocation, asked: Array) -> Interval:
        """The maths of an interval, with these of the path rows at its points."""
        return transcription.interval(
            self._rate,
            self._point,
            self._gap,
            transcription.tableau,
            transcription.substeps,
            n=self.n,
            size=self.size,
            asked=asked,
            rows=self._row_count,
        )

    def start_rows(self) -> list[tuple[int, int]]:
        """Of the path rows at the first node: where they are among all rows, and which they are."""
        return [(place, int(row)) for place, row in enumerate(self.layout.asked) if row < self._row_count]

    def drop(self, rows: Sequence[Array]) -> None:
        (pinned,) = rows
        self.exists, self.decided, self.pinned = (np.array(a) for a in (self.exists, self.decided, self.pinned))
        self.exists[pinned] = False
        self.pinned[pinned] = self.decided[pinned] = True

    # ---- moves --------------------------------------------------------------------------------------------------

    def move(self, point: Point, step: Step) -> Point:
        """The point after a step."""
        xs = jax.vmap(self.dynamics.group.retract)(point.xs, step.d)
        return Point(xs, point.us + step.u, point.border + step.border)

    def defect(self, stage: int, column: int) -> str:
        return f"'dynamics of {self.states[column]}' between nodes {stage} and {stage + 1}"

    @property
    def phase_places(self) -> list[str]:
        return [""]

    def named(self, part: Segment, name: str) -> str:
        return name

    def whole_rows(self, parts: Sequence[Array]) -> Array:
        (found,) = parts
        return found

    def rows_of(self, part: Segment, rows: Any) -> Any:
        return rows

    # ---- values -------------------------------------------------------------------------------------------------

    def values(self, point: Point, given: Given, d: jax.Array | None = None) -> Values:
        """Cost, defects and rows at a point, or a step d (nodes, n) of its nodes away in their charts."""
        left, right = _sides(point.xs)
        d = jnp.zeros((self.nodes, self.n), point.us.dtype) if d is None else d
        slots, shared = self._slots(point), (point.border, given.params)
        rolled = jax.vmap(self._interval.roll, in_axes=(0, 0, 0, 0, None, None))(slots, left, d[:-1], point.us, *shared)
        rows, costs = jax.vmap(self._interval.at_points, in_axes=(0, 0, 0, 0, None, None))(
            slots, left, rolled, point.us, *shared
        )
        defects = jax.vmap(self._gap)(rolled.ends[:, -1], left, right) - d[1:]
        end = self._end(self._place(-1, d), self._here(-1, point), given)
        at_nodes = {k: node(self._place(k, d), self._here(k, point), given.params) for k, node in self._nodes.items()}
        rows = jnp.concatenate([rows, self._spread(at_nodes, rows)], axis=1)
        rows = jnp.concatenate([rows.reshape(-1), end[:-1]]) + given.margins
        return Values(jnp.sum(costs) + end[-1], defects, rows)

    def spread_over_points(self, of_rows: Array) -> Array:
        """(rows,) of numbers (intervals, path rows), at every point of an interval where a row is asked."""
        return self.layout.spread(of_rows)

    def row_scales(self, rows: Array) -> Array:
        """(intervals, path rows) the least scale of every path row, of those of all; infinite where none asks it."""
        return self.layout.least(np.where(self.exists, rows, np.inf), self.intervals, self._row_count)

    def advanced(self, number: jax.Array, base: Arrays, u: jax.Array, border: jax.Array, params: Arrays) -> Arrays:
        """The end of an interval, given its number, that starts at a node."""
        slot = Slot(*(jnp.asarray(a, u.dtype)[number] for a in (self.mesh.shares[:-1], self.mesh.widths)))
        rolled = self._interval.roll(slot, base, jnp.zeros(self.n, u.dtype), u, border, params)
        return self.dynamics.group.retract(base, rolled.ends[-1])

    def _node_at(
        self, k: int, conditions: Conditions, z: jax.Array, here: tuple[Arrays, jax.Array], params: Arrays
    ) -> jax.Array:
        """The conditions at a node after a step z = [d, db] of it."""
        b = here[1] + z[self.n :]
        x = self.dynamics.group.retract(here[0], z[: self.n])
        begin, length = self.span(b)
        return conditions.values(begin + self.mesh.shares[k] * length, x, params | self.border.params(b))

    def _spread(self, parts: Mapping[int, jax.Array], like: jax.Array) -> jax.Array:
        """Rows of single nodes among those of all intervals."""
        found = jnp.zeros((self.intervals, self.layout.at_nodes, *like.shape[2:]), like.dtype)
        for k, rows in parts.items():
            found = found.at[k, : len(rows)].set(rows)
        return found

    def _slots(self, point: Point) -> Slot:
        """Where the intervals lie."""
        dtype = point.us.dtype
        return Slot(jnp.asarray(self.mesh.shares[:-1], dtype), jnp.asarray(self.mesh.widths, dtype))

    def _here(self, k: int, point: Point) -> tuple[Arrays, jax.Array]:
        """A node and the border."""
        return {name: a[k] for name, a in point.xs.items()}, point.border

    def _place(self, k: int, d: jax.Array) -> jax.Array:
        """[d, db] of a node."""
        return jnp.concatenate([d[k], jnp.zeros(self.border.size, d.dtype)])

    def rate_at(self, q: jax.Array, share: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        """d eta / d(t / T) at time share * T, of q = [eta, u, b]."""
        eta, u, begin, length, params = self._parts(q, params)
        return length * self._pace(u) * self.local.rate(begin + share * length, eta, u, base, params)

    def _parts(self, q: jax.Array, params: Arrays) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array, Arrays]:
        """eta, u, when the phase begins and how long it takes, and all parameters."""
        eta, u, b = jnp.split(q, [self.n, self.n + self.m])
        return eta, u, *self.span(b), params | self.border.params(b)

    def _at_share(self, params: Arrays, share: Any) -> Arrays:
        """The parameters, those with a value for each node at a share of the duration."""
        return params | self.by_node.along(params, share) if self._interpolates else params

    def span(self, b: Any) -> tuple[Any, Any]:
        """When the phase begins, and how long it takes."""
        return b[: self.phase].sum(), b[self.phase]

    def times(self, border: Array) -> Array:
        """(nodes,) of the nodes, s."""
        begin, length = (float(a) for a in self.span(border))
        return np.asarray(begin + length * self.mesh.shares)

    def point_at(self, q: jax.Array, share: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        """The path rows, and the running cost times T."""
        eta, u, begin, length, params = self._parts(q, self._at_share(params, share))
        rows, density = self.local.point(begin + share * length, eta, u, base, params)
        return jnp.concatenate([rows, (length * self._pace(u) * density)[None]])

    def values_at(
        self, exprs: Sequence[Expr], q: jax.Array, share: jax.Array, base: Arrays, params: Arrays
    ) -> tuple[jax.Array, list[Any]]:
        """T, and expressions at time share * T."""
        eta, u, begin, length, params = self._parts(q, params)
        return length * self._pace(u), self.local.values(exprs, begin + share * length, eta, u, base, params)

    def _pace(self, u: jax.Array) -> Any:
        """How long the interval is over what its share says."""
        return 1.0 if self.paced is None else u[self.paced][0]

    def end_at(self, z: jax.Array, last: tuple[Arrays, jax.Array], given: Given) -> jax.Array:
        """The rows of the end and the final cost after a step z = [d, db] of the last node."""
        base, b = last[0], last[1] + z[self.n :]
        params = self._at_share(given.params, 1.0) | self.border.params(b)
        begin, length = self.span(b)
        conditions, gap, path, cost = self.local.end(begin + length, z[: self.n], base, given.final, params)
        limits = self.border.rows(b, given.limits) if self.is_last else jnp.zeros(0, b.dtype)
        return jnp.concatenate([conditions, gap[self.layout.fixed], path[self.layout.end_states], limits, cost[None]])

    # ---- derivatives --------------------------------------------------------------------------------------------

    def derivatives(self, point: Point, y: jax.Array, w: jax.Array, given: Given) -> Derivatives:
        """First derivatives, and the second of cost + y.defects + w.rows; y as the defects, w as the rows."""
        left, right = _sides(point.xs)
        d = jnp.zeros((self.nodes, self.n), y.dtype)
        split = self.intervals * self.rows_per_interval
        inner, own = jnp.split(w[:split].reshape(self.intervals, -1), [len(self.layout.asked)], axis=1)
        found = jax.vmap(self._interval.derivatives, in_axes=(0, 0, 0, 0, 0, 0, 0, None, None))(
            self._slots(point),
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
        # No `jnp.append`: XLA loses what says how kernels are called where a called function is given an empty array.
        pushes = jnp.concatenate([w[split:], jnp.ones(1, w.dtype)])
        end_hessian = self._end.bends(pushes, at, last, given)
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


def _sides(xs: Arrays) -> tuple[Arrays, Arrays]:
    """The nodes at which intervals begin, and those at which they end."""
    return {name: a[:-1] for name, a in xs.items()}, {name: a[1:] for name, a in xs.items()}
