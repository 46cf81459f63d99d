"""A staged problem as a nonlinear program with sparse derivatives, for IPOPT and Fatrop.

Unknowns and constraints are ordered by stage, as solvers that exploit the stage structure require:

    x = [x_0, u_0, ..., x_N, p],   minimise f(x),   lower <= x <= upper,   lower_rows <= g(x) <= 0,
    g = [x_1 - F_0(x_0, u_0, p), h_0, e_0, ..., h_N, e_N].

Flat states, controls and p are unknowns themselves. States on other groups are represented by steps d_k in charts about
fixed points. p is shared by all stages and begins with free durations; for solvers that require separate stages, each
stage has a copy p_k. Unknowns that cannot change are omitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...solver.kernels import Argument
from ..start_units import StartUnits
from ..strategy.warm import WarmStart
from ..transcription.evaluation import Evaluated, moved
from ..transcription.iterate import Instance, Iterate
from ..transcription.staged import Staged
from ..transcription.staged_phase import StagedPhase


class Entries(NamedTuple):
    """The entries of a sparse matrix, column by column, and the numbers whose sum is each entry."""

    rows: Array
    columns: Array
    source: Array
    target: Array

    def of(self, parts: Sequence[Array]) -> Array:
        """The entries, from a list of arrays of numbers."""
        return np.bincount(self.target, np.concatenate(parts)[self.source], minlength=len(self.rows))


class ProgramStart(NamedTuple):
    """The start of a solver: unknowns, their bounds, and multipliers of bounds and rows."""

    x: Array
    lower: Array
    upper: Array
    of_bounds: Array
    of_rows: Array


class Reached(NamedTuple):
    """The result of a solver: the point, multipliers in the problem's units, and the largest
    rotation of a node, rad.
    """

    point: Iterate
    dynamics: Array  # (intervals, n)
    rows: Array  # (rows,)
    turn: float


class NonlinearProgram:
    """The nonlinear program of a staged problem.

    Attributes:
        size, count: numbers of unknowns and of constraints.
        equality: (count,) which constraints are equalities.
        jacobian, hessian: `Entries` of g' and of the Lagrangian's second derivative, which is symmetric.
        stages: for each node the numbers of states (p included), of controls and of rows.

    Args:
        with_copies: whether each stage has a separate copy of p.
    """

    def __init__(self, staged: Staged, instance: Instance, *, with_copies: bool) -> None:
        self._staged, self._transcription = (staged := staged.alone(instance)), staged.transcription
        self._transcription.use_charts()
        stages = self._transcription.stages
        self._free = staged.step(*(np.asarray(a, float) for a in staged.transcribed.free)) > 0.0
        self._last, self._shared = len(stages.states) - 1, stages.variables - stages.parameters
        #: The unknown of each entry of v, -1 for none; for shared entries, that of each stage's copy.
        self._places = -np.ones(stages.variables, int)
        self._copies = -np.ones((self._last + 1, stages.parameters), int)
        self.size = self.count = 0
        sizes = self._number(with_copies)
        self._row_places, self._copy_rows, counts = self._number_rows(with_copies)
        self.stages = tuple((*of_stage, rows) for of_stage, rows in zip(sizes, counts))
        self.equality = np.ones(self.count, bool)
        self.equality[self._row_places[1]] = False
        self.lower_rows = np.where(self.equality, 0.0, -np.inf)
        #: The indices of flat states, controls and shared unknowns in points; -1 for rotations.
        self._point_places = -np.ones(stages.variables, int)
        self._point_places[staged.plain[1]] = staged.plain[0]
        self._curved = np.where(self._point_places < 0, 1.0, 0.0)
        self._describe()

    def _number(self, with_copies: bool) -> list[tuple[int, int]]:
        """Number the unknowns, and count the states and controls of each stage."""
        stages, first, sizes = self._transcription.stages, self._staged.first, list[tuple[int, int]]()
        shared = self._free[self._shared :]
        for k, (n, m) in enumerate(zip(stages.states, stages.controls)):
            states = self._next(self._places, first[k] + np.flatnonzero(self._free[first[k] : first[k] + n]))
            if with_copies or k == self._last:
                states += self._next(self._copies[k], np.flatnonzero(shared))
            of_stage = first[k] + n + np.arange(m)
            sizes.append((states, self._next(self._places, of_stage[self._free[of_stage]])))
        if not with_copies:
            self._copies[:] = self._copies[-1]
        self._places[self._shared :] = self._copies[0]
        return sizes

    def _next(self, places: Array, which: Array) -> int:
        """Assign the next numbers to some unknowns."""
        places[which] = np.arange(self.size, self.size + len(which))
        self.size += len(which)
        return len(which)

    def _number_rows(self, with_copies: bool) -> tuple[list[Array], Array, list[int]]:
        """Assign constraints to defects, inequalities, equalities and the equations between copies.

        The last item is the number of constraints of each stage besides the dynamics.
        """
        stages, rows, counts = self._transcription.stages, list[list[Array]](), list[int]()
        shared, copies = np.flatnonzero(self._copies[0] >= 0), -np.ones((self._last, stages.parameters), int)
        for k in range(self._last + 1):
            of_stage = [self._take(stages.after[k])]
            if with_copies and k < self._last:
                copies[k, shared] = self._take(len(shared))
            after_dynamics = self.count
            of_stage += [self._take(stages.inequalities[k]), self._take(stages.equalities[k])]
            rows.append(of_stage)
            counts.append(self.count - after_dynamics)
        return [np.concatenate(parts) for parts in zip(*rows)], copies, counts

    def _take(self, count: int) -> Array:
        self.count += count
        return np.arange(self.count - count, self.count)

    def _describe(self) -> None:
        """The sparsity patterns of the derivatives."""
        stages, first = self._transcription.stages, self._staged.first
        jacobian = list[Any]()
        columns = [
            np.concatenate([self._places[first[k] + np.arange(n + m)], self._copies[k]])
            for k, (n, m) in enumerate(zip(stages.states, stages.controls))
        ]
        for places, counts in zip(self._row_places, (stages.after, stages.inequalities, stages.equalities)):
            by_stage = np.split(places, np.cumsum(counts)[:-1])
            jacobian += [np.broadcast_arrays(r[None, :], c[:, None]) for r, c in zip(by_stage, columns)]
        copies = self._copy_rows
        jacobian += [(self._row_places[0], self._staged.after(self._places))]
        jacobian += [(copies, self._copies[1:]), (copies, self._copies[:-1])]
        self.jacobian = _entries(jacobian)
        self.hessian = _entries([np.broadcast_arrays(c[None, :], c[:, None]) for c in columns])
        self._ones = np.ones(len(self._row_places[0]) + copies.size), -np.ones(copies.size)
        joins = [(part.stages.stop - 1, part.phase.join.free) for part in self._staged.parts if part.phase.join]
        starts = np.cumsum(stages.after) - stages.after
        #: Entries that a join leaves free: indices of the defect, of its control, and of the next node.
        self._joined = [
            (starts[k] + free, first[k] + stages.states[k] + np.arange(len(free)), first[k + 1] + free)
            for k, free in joins
        ]

    # ---- start and result -----------------------------------------------------------------------------------------

    def start(self, start: Iterate | WarmStart, instance: Instance, units: StartUnits | None) -> ProgramStart:
        """Set the point about which the program is stated, and the units: the argument, or those of the problem."""
        staged, point = self._staged, start.point if isinstance(start, WarmStart) else start
        staged.set_instance(instance)
        self._latest: tuple[Array, Evaluated] | None = None
        self._z = staged.flat(point)
        self._v = staged.coordinates(self._z)
        for _, control, after in self._joined:
            self._v[control] = self._v[after]
        self._x_units, self._row_units, self._cost_unit = np.ones(self.size), np.ones(self.count), 1.0
        if units is not None:
            self._x_units, self._cost_unit = self._of_v(units.v), units.cost
            copies = np.broadcast_to(units.border[staged.border.unknown], self._copy_rows.shape)
            self._row_units = self._of_rows(staged.after(units.v), units.rows, units.equalities, copies)
        lower, upper = (self._of_v(a) / self._x_units for a in staged.limits(self._v, instance))
        repeated = np.setdiff1d(self._copies[1:], self._copies[0])  # copies are equal, so bounds on one of them suffice
        lower[repeated], upper[repeated] = -np.inf, np.inf
        bounds, rows = np.zeros(self.size), np.zeros(self.count)
        if isinstance(start, WarmStart):
            y, ye, zl, zu = staged.split_rows(np.asarray(start.rows))
            bounds = self._of_v(zu - zl) * self._x_units / self._cost_unit
            rows = self._of_rows(-staged.unpadded(start.dynamics), y, ye) * self._row_units / self._cost_unit
        return ProgramStart(self._of_v(self._v) / self._x_units, lower, upper, bounds, rows)

    def reached(self, x: Array, of_bounds: Array, of_rows: Array) -> Reached:
        """The point for values of the unknowns, with its multipliers."""
        staged = self._staged
        z, v = self._at(x)
        z = moved(self._transcription, z, v * self._curved)
        for _, control, _ in self._joined:
            z[self._point_places[control]] = 0.0
        rows = of_rows * self._cost_unit / self._row_units
        lam, y, ye = (rows[places] for places in self._row_places)
        bounds = np.append(of_bounds * self._cost_unit / self._x_units, 0.0)[self._places]
        every = staged.all_rows(np.maximum(y, 0.0), ye, np.maximum(-bounds, 0.0), np.maximum(bounds, 0.0))
        dynamics = staged.padded(-lam)
        for part, d in zip(staged.parts, staged.tangents(v * self._curved)):
            self._turn(part, d, dynamics)
        return Reached(staged.point(z), dynamics, every, float(np.abs(v[staged.turning]).max(initial=0.0)))

    @staticmethod
    def _turn(part: StagedPhase, d: Array, dynamics: Array) -> None:
        """Transform the multipliers of a phase's dynamics to nodes that are moved by d.

        A further step e of a moved node is a step J e in the original chart, with J^-1 = J_l(-d).
        """
        turn, n = part.phase.kernels.turn, part.shooting.n
        if turn is None:
            return
        matrices = turn(len(d), n * n, {Argument.Z: -d}).reshape(-1, n, n)
        for k, matrix in zip(range(part.stages.start, part.stages.stop), matrices):
            if k > 0:
                dynamics[k - 1, :n] = np.linalg.solve(matrix.T, dynamics[k - 1, :n])

    def _of_v(self, v: Array) -> Array:
        """Entries of the unknowns, from entries of v."""
        x = np.zeros(self.size + 1)
        x[self._places], x[self._copies] = v, v[self._shared :]
        return x[:-1]

    def _of_rows(self, c: Array, h: Array, e: Array, copies: Any = 0.0) -> Array:
        """Entries of the constraints, from entries of defects and rows."""
        rows = np.zeros(self.count + 1)
        rows[self._copy_rows] = copies
        for places, numbers in zip(self._row_places, (c, h, e)):
            rows[places] = numbers
        return rows[:-1]

    def _at(self, x: Array) -> tuple[Array, Array]:
        """z and v for values of the unknowns: nodes in the charts about the current points, other entries unchanged."""
        v, z, placed, flat = self._v.copy(), self._z.copy(), self._places >= 0, self._point_places >= 0
        v[placed] = (x * self._x_units)[self._places[placed]]
        z[self._point_places[flat]] = v[flat]
        return z, v

    # ---- values and derivatives -----------------------------------------------------------------------------------

    def _evaluated(self, x: Array) -> Evaluated:
        """Values of the problem's functions for values of the unknowns. The next call overwrites their memory."""
        if self._latest is not None and np.array_equal(self._latest[0], x):
            return self._latest[1]
        z, v = self._at(x)
        self._transcription.set_steps(self._staged.tangents(v * self._curved))
        at = Evaluated(self._transcription, z)
        for defect, control, after in self._joined:
            at.c[defect] = v[control] - v[after]
        self._latest = x.copy(), at
        return at

    def values(self, x: Array) -> tuple[float, Array]:
        """The objective f and the constraints g."""
        at = self._evaluated(x)
        if at.failed:
            return np.nan, np.full(self.count, np.nan)
        g, every = self._of_rows(-at.c, at.h, at.e), np.append(x * self._x_units, 0.0)
        there = self._copy_rows >= 0
        g[self._copy_rows[there]] = (every[self._copies[1:]] - every[self._copies[:-1]])[there]
        return float(at.cost[0]) / self._cost_unit, g / self._row_units

    def first_derivatives(self, x: Array) -> tuple[Array, Array]:
        """The gradient of f, and the entries of the Jacobian of g."""
        at = self._evaluated(x)
        if not at.jacobians():
            return np.full(self.size, np.nan), np.full(len(self.jacobian.rows), np.nan)
        gradient = np.zeros(self.size + 1)
        gradient[self._places] = at.gradient
        numbers = self.jacobian.of([-at.F, at.Jh, at.Je, *self._ones])
        numbers *= self._x_units[self.jacobian.columns] / self._row_units[self.jacobian.rows]
        return gradient[:-1] * self._x_units / self._cost_unit, numbers

    def lagrangian_hessian(self, x: Array, weight: float, multipliers: Array) -> Array:
        """The entries of the second derivative of weight f + multipliers . g."""
        at, scaled = self._evaluated(x), multipliers / self._row_units
        lam, y, ye = (scaled[places] for places in self._row_places)
        numbers = self.hessian.of([at.hessian(weight / self._cost_unit, -lam, y, ye)])
        return numbers * self._x_units[self.hessian.rows] * self._x_units[self.hessian.columns]


def _entries(blocks: Sequence[Any]) -> Entries:
    """The entries of blocks with (row, column) indices, -1 for omitted ones."""
    rows, columns = (np.concatenate([np.asarray(block[i]).ravel() for block in blocks]) for i in range(2))
    source = np.flatnonzero((rows >= 0) & (columns >= 0))
    places, target = np.unique(np.stack([columns[source], rows[source]]), axis=1, return_inverse=True)
    return Entries(places[1], places[0], source, target.ravel())
