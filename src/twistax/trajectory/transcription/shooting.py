"""Multiple shooting in the tangent space: the unknowns, rows and functions of a phase.

The unknowns are a step z = (d_0, du_0, ..., d_(K-1), du_(K-1), d_K, db) from the nodes x_k, the piecewise constant
controls u_k, and the shared unknowns b (border), which hold the final time T and free parameters. Nodes move by x_k (+)
d_k, so the chart is re-based at every iterate. Interval k is integrated in exponential coordinates about x_k, in time
divided by T. The results are the defect function

    F_k(d_k, du_k, db) = Log(x_(k+1)^-1 x_k Exp(eta_k)), with the dynamics d_(k+1) = F_k,

the constraint rows at the ends of its substeps, and its contribution to the running cost by a quadrature rule.
"""

from __future__ import annotations

import copy
import functools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...expr import Control, Expr, Inputs, State
from ...system import entry_names
from ...system.dynamics import Arrays, Dynamics
from ..problem.bridges.path_bounds import PathBounds
from ..problem.by_node import ByNode
from ..problem.conditions import Conditions, Ends
from ..problem.statement import Labels, Objective, PathRows
from .border import Border
from .iterate import Instance, Iterate, Step
from .local import Local
from .mesh import Mesh
from .methods import Collocation, MultipleShooting
from .row_layout import row_layout


class PhaseSegment(NamedTuple):
    """A transcribed phase, with the indices of its nodes and intervals in the whole problem."""

    number: int
    shooting: Shooting
    nodes: slice
    stages: slice
    alone: bool = False

    def of(self, point: Iterate) -> Iterate:
        """The part of a point of the whole problem that belongs to the phase."""
        if self.alone:
            return point
        return Iterate(point.xs[self.number], point.us[self.stages, : self.shooting.m], point.border)


class Transcribed(ABC):
    """The interface of staged (multi-stage) discrete problems, which solvers read.

    Attributes:
        n, m: the numbers of tangents of a node and of controls of an interval, in the largest phase.
        nodes, intervals, rows_per_interval: their numbers.
        border: the unknowns that all stages share.
        names, places: the name and the place of every row.
        equality, exists: (rows,) whether a row is an equality; whether the problem has it.
        determined: (rows,) the rows that depend only on fixed initial or final values; they are checked, not solved
            for.
        redundant: (rows,) the determined rows that other rows imply.
        at_single_node: (rows,) the conditions at single nodes.
        free: a Step of bool, the unknowns that may change.
        perturbable: (nodes, n) the tangents that random perturbations may change: the free ones except those that final
            values fix, whose rows are evaluated at the start of a search.
        segments, joins: the phases, and the joins between them.
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
    determined: Array
    redundant: Array
    at_single_node: Array
    free: Step
    perturbable: Array
    segments: Sequence[PhaseSegment]
    joins: Sequence[Any]

    @abstractmethod
    def drop(self, rows: Sequence[Array]) -> None:
        """Remove redundant rows of each phase, which other rows imply; they are only checked."""

    @abstractmethod
    def defect(self, stage: int, column: int) -> str:
        """The name and the place of an entry of the defects (the residuals of the dynamics)."""

    @functools.cached_property
    def labels(self) -> Labels:
        """The names of all rows."""
        return Labels(self.names)

    @functools.cached_property
    def node_labels(self) -> Labels:
        """The names of the conditions at single nodes."""
        return Labels(self.names[self.at_single_node])

    # For one phase; for several phases see `Joined`.

    @property
    def phase_places(self) -> list[str]:
        """The text that follows the place of an interval in messages, for each phase."""
        return [""]

    def named(self, part: PhaseSegment, name: str) -> str:
        """The name of a row of a phase among those of the whole problem."""
        return name

    def rows_of_all(self, parts: Sequence[Array]) -> Array:
        """Values for the rows of each phase, as values for all rows."""
        return parts[0]

    def rows_of(self, part: PhaseSegment, rows: Any) -> Any:
        """The values for the rows of one phase, from values for all rows."""
        return rows


class Shooting(Transcribed):
    """A transcribed phase, or a transcribed problem of one phase.

    Args:
        pace: the control that scales the lengths of intervals.

    Attributes:
        phase: the index of the phase.
        leaves: states and controls by name, in the order of the unknowns.
        slacks: names of controls that are slacks.
        size: the number of unknowns in q with respect to which derivatives are taken: all but fixed durations.
        states: names of the states' tangents.
        turns: (n,) the tangents that are rotations.
        paced: the index of the control that scales the lengths of intervals.
        by_node: the parameters that have a value for each node.
        alike: state -> the state whose scale it shares, in this phase or in the first.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        objective: Objective,
        *,
        transcription: MultipleShooting | Collocation,
        mesh: Mesh,
        path: PathRows,
        norms: PathBounds,
        ends: Ends,
        final: Conditions,
        at_nodes: Mapping[int, Conditions],
        border: Border,
        phase: int = 0,
        pace: str | None = None,
        by_node: ByNode,
    ) -> None:
        self.dynamics, self.mesh, self.transcription, self.by_node = dynamics, mesh, transcription, by_node
        self.path, self.conditions, self.border = path, at_nodes, border
        self._interpolates = bool(by_node.leaves)
        self.alike: dict[str, str] = {}
        self.phase, self.is_last = phase, phase == border.phases - 1
        leaves: list[State | Control] = [*dynamics.states, *dynamics.controls, *norms.controls]
        self.leaves = {leaf.name: leaf for leaf in leaves}
        self.slacks = frozenset(slack.name for slack in norms.slacks.values())
        self.local = Local(dynamics, path, objective, norms, final)
        self.n, self.m = dynamics.dimension, self.local.controls.dimension
        self.size = self.n + self.m + border.unknowns
        self.nodes, self.intervals, self.substeps = mesh.nodes, mesh.nodes - 1, transcription.substeps
        self.paced = None if pace is None else self.local.controls.slices[pace]
        factors = dynamics.group.factors
        self.turns = np.concatenate([np.zeros(0, bool), *(group.angular for group in factors.values())])
        self.states = [entry for name, group in factors.items() for entry in entry_names(name, group.tangent_shape)]
        self.layout = row_layout(
            path,
            ends,
            final,
            at_nodes,
            border,
            tangents=self.states,
            intervals=self.intervals,
            substeps=self.substeps,
            phase=phase,
        )
        for field in ("names", "places", "equality", "exists", "determined", "at_single_node"):
            setattr(self, field, getattr(self.layout, field))
        self.redundant, self.rows_per_interval = np.zeros_like(self.exists), self.layout.per_interval
        free = np.ones((self.nodes, self.n), bool)
        if phase == 0:
            free[0] = ~ends.initial_mask
        self.free = Step(free, np.ones((self.intervals, self.m), bool), border.free)
        self.perturbable = free.copy()
        self.perturbable[-1, self.layout.fixed] = False
        self.segments = [PhaseSegment(0, self, slice(0, self.nodes), slice(0, self.intervals), alone=True)]
        self.joins = []

    def made_of(self, **expressions: tuple[Expr, ...]) -> Shooting:
        """The functions with other expressions of the same shapes, by name. Parameters of nodes are evaluated at the
        node's fraction.
        """
        other = copy.copy(self)
        other.local, other._interpolates = self.local.made_of(**expressions), False
        return other

    # ---- rows -----------------------------------------------------------------------------------------------------

    def start_rows(self) -> list[tuple[int, int]]:
        """The path rows at the first node: their indices among all rows, and among path rows."""
        return [(place, int(row)) for place, row in enumerate(self.layout.path_indices) if row < len(self.path.names)]

    def drop(self, rows: Sequence[Array]) -> None:
        (redundant,) = rows
        self.exists, self.determined, self.redundant = (
            np.array(a) for a in (self.exists, self.determined, self.redundant)
        )
        self.exists[redundant] = False
        self.redundant[redundant] = self.determined[redundant] = True

    def defect(self, stage: int, column: int) -> str:
        return f"'dynamics of {self.states[column]}' between nodes {stage} and {stage + 1}"

    def spread_over_points(self, of_rows: Array) -> Array:
        """(rows,) from values (intervals, path rows): the value of an interval at every point of it
        that has the row.
        """
        return self.layout.spread(of_rows)

    def row_scales(self, rows: Array) -> Array:
        """(intervals, path rows) the smallest scale of every path row, from the scales of all rows; infinite for
        missing rows.
        """
        return self.layout.least(np.where(self.exists, rows, np.inf), self.intervals, len(self.path.names))

    # ---- functions of q = [eta, u, b], and of a node's step z = [d, db] -------------------------------------------

    def inputs_at(self, q: jax.Array, share: jax.Array, base: Arrays, params: Arrays) -> tuple[jax.Array, Inputs]:
        """The duration, and the point of evaluation at time share * T."""
        eta, u, b = jnp.split(q, [self.n, self.n + self.m])
        begin, length = self.span(b)
        pace = 1.0 if self.paced is None else u[self.paced][0]
        at = self.local.inputs(begin + share * length, eta, u, base, params | self.border.params(b))
        return length * pace, at

    def rate_at(self, q: jax.Array, share: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        """The derivative of eta with respect to t / T, at time share * T."""
        length, at = self.inputs_at(q, share, base, params)
        return length * self.local.rate(at, q[: self.n])

    def point_at(self, q: jax.Array, share: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        """The path rows, and the running cost times T."""
        length, at = self.inputs_at(q, share, base, self._at_share(params, share))
        density = self.local.cost(self.local.expressions.running, at)
        return jnp.concatenate([self.local.rows(at), (length * density)[None]])

    def node_at(self, k: int, z: jax.Array, here: tuple[Arrays, jax.Array], params: Arrays) -> jax.Array:
        """The conditions at a node, from its state and the shared unknowns."""
        b = here[1] + z[self.n :]
        return self.condition_at(self.conditions[k], z[: self.n], self.mesh.shares[k], here[0], b, params)

    def condition_at(
        self, conditions: Conditions, d: jax.Array, share: Any, base: Arrays, b: jax.Array, params: Arrays
    ) -> jax.Array:
        """Conditions at a fraction of the duration."""
        begin, length = self.span(b)
        x = self.dynamics.group.retract(base, d)
        return conditions.values(begin + share * length, x, params | self.border.params(b))

    def end_at(self, z: jax.Array, last: tuple[Arrays, jax.Array], data: Instance) -> jax.Array:
        """The rows of the end and the final cost, from the last node and the shared unknowns;
        controls are set to zero.
        """
        base, b = last[0], last[1] + z[self.n :]
        q, share = jnp.concatenate([z[: self.n], jnp.zeros(self.m, z.dtype), b]), jnp.ones((), z.dtype)
        _, at = self.inputs_at(q, share, base, self._at_share(data.params, 1.0))
        gap = self.dynamics.group.difference(data.final, at.x)[self.layout.fixed]
        limits = self.border.rows(b, data.limits) if self.is_last else jnp.zeros(0, b.dtype)
        path, cost = self.local.rows(at)[self.layout.end_states], self.local.cost(self.local.expressions.final, at)
        return jnp.concatenate([self.local.conditions(at), gap, path, limits, cost[None]])

    def span(self, b: Any) -> tuple[Any, Any]:
        """Start time and duration of the phase."""
        return b[: self.phase].sum(), b[self.phase]

    def times(self, border: Array) -> Array:
        """(nodes,) times of the nodes, s."""
        begin, length = (float(a) for a in self.span(border))
        return np.asarray(begin + length * self.mesh.shares)

    def _at_share(self, params: Arrays, share: Any) -> Arrays:
        """The parameters; those with a value for each node are interpolated at a fraction of the duration."""
        return params | self.by_node.along(params, share) if self._interpolates else params
