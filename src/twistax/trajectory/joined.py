"""Phases as one discrete problem: the stages of each in turn, and between two phases a stage of its own, a join.

States, controls and rows of smaller phases are padded to the largest, so what a stage costs is what the largest costs.
The last node of a phase and the first of the next are both unknown; the join says with its defect

    F(d, b) = Log(x_next^-1 jump(x_last Exp(d), b)),   d_next = F,

with the conditions and the cost of the phase's end as its rows and its cost. An entry of x_next that no link decides is
the control of the join: F = u there, the step to it from the node, zero where the node has moved along.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Expr, Inputs, evaluate_all
from ..lowering.dynamics import Arrays
from .shooting import Shooting
from .smooth import Smooth
from .statement import PathRows
from .transcribed import Derivatives, Given, Point, Segment, Step, Transcribed, Values


class Join:
    """What the states at the start of a phase are.

    Args:
        before, after: the phases.
        sources: state -> an expression of the last states before, or None where the state is free.
        given: state -> values in place of it as stated, NaN where entries are free; a solve has others there.
        fixed: state -> (dimension,) which tangents have such a value.

    Attributes:
        free: which tangents of the next start nothing decides.
    """

    stage = 0

    def __init__(
        self,
        before: Shooting,
        after: Shooting,
        sources: Mapping[str, Expr | None],
        given: Mapping[str, Array | None],
        fixed: Mapping[str, Array],
    ) -> None:
        self._before, self._after, self._sources = before, after, sources
        self._placed = {name: ~np.isnan(value) for name, value in given.items() if value is not None}
        parts = after.dynamics.group.slices.items()
        loose = np.zeros(after.n, bool)
        for name, part in parts:
            loose[part] = ~fixed[name] if sources[name] is None else False
        self.free, self._loose = np.flatnonzero(loose), loose
        self.gap = Smooth(self.gap_at, before.backend)
        places = after.dynamics.group.factors
        placed = tuple(self._placed[name].tobytes() if name in self._placed else None for name in places)
        #: What the defect depends on beside its expressions and the layout of both phases.
        self.key = (placed, tuple(sources[name] is None for name in places), loose.tobytes())

    @property
    def sources(self) -> tuple[Expr, ...]:
        """The expressions of the last states before, in the order of the next ones."""
        every = (self._sources[name] for name in self._after.dynamics.group.factors)
        return tuple(source for source in every if source is not None)

    def made_of(self, sources: Sequence[Expr]) -> Join:
        """The same by other expressions."""
        found, others = copy.copy(self), iter(sources)
        names = self._after.dynamics.group.factors
        found._sources = {n: None if self._sources[n] is None else next(others) for n in names}
        return found

    def gap_at(
        self, z: jax.Array, here: tuple[Arrays, jax.Array], start: Arrays, given: Arrays, params: Arrays
    ) -> jax.Array:
        """The defect after a step z = [d, db] of the last node; of other starts it is the same."""
        before = self._before
        x, b = before.dynamics.group.retract(here[0], z[: before.n]), here[1] + z[before.n :]
        begin, length = before.span(b)
        inputs = Inputs(begin + length, x, {}, params | before.border.params(b), z.dtype)
        sources = {name: source for name, source in self._sources.items() if source is not None}
        values = evaluate_all(list(sources.values()), lambda leaf: leaf.read(inputs))
        target = dict(start) | dict(zip(sources, values, strict=True))
        for name, placed in self._placed.items():
            target[name] = jnp.where(placed, given[name], target[name])
        target = {name: jnp.asarray(a, z.dtype) for name, a in target.items()}
        gap = self._after.dynamics.group.difference(start, target)
        return jnp.where(self._loose, 0.0, gap)


class Joined(Transcribed):
    """A problem of several phases.

    Points have the states of each phase in a tuple; `Given.final` likewise.
    """

    def __init__(self, shootings: Sequence[Shooting], joins: Sequence[Join], names: Sequence[str]) -> None:
        self.joins, self._phases = joins, names
        self.border = shootings[0].border
        self.n = max(own.n for own in shootings)
        self.m = max(max(own.m for own in shootings), max((len(join.free) for join in joins), default=0))
        self.nodes = sum(own.nodes for own in shootings)
        self.intervals = self.nodes - 1
        self._inner = [own.intervals * own.rows_per_interval for own in shootings]
        ends = [len(own.exists) - inner for own, inner in zip(shootings, self._inner)]
        self.rows_per_interval = max([own.rows_per_interval for own in shootings] + ends[:-1])
        segments, first = [], 0
        for number, own in enumerate(shootings):
            columns = np.concatenate([np.arange(own.n), self.n + np.arange(own.m)])
            stages = slice(first, first + own.intervals)
            segments.append(Segment(number, own, slice(first, first + own.nodes), stages, columns))
            first += own.nodes
        self.segments: Sequence[Segment] = segments
        for part, join in zip(segments, joins):
            join.stage = part.stages.stop
        self._ends, self._border_columns = ends, self.n + self.m + np.arange(self.border.size)
        self._describe()
        self._assemble()

    def _describe(self) -> None:
        d, u = np.zeros((self.nodes, self.n), bool), np.zeros((self.intervals, self.m), bool)
        self.turns, self.stirred = np.zeros_like(d), np.zeros_like(d)
        for part in self.segments:
            own = part.shooting
            self.stirred[part.nodes, : own.n] = own.stirred
            d[part.nodes, : own.n], u[part.stages, : own.m] = own.free.d, own.free.u
            self.turns[part.nodes, : own.n] = own.turns
        for join in self.joins:
            u[join.stage, : len(join.free)] = True
        self.free = Step(d, u, self.border.free)

    def _assemble(self) -> None:
        """Rows of the phases among all rows."""

        def named(part: Segment) -> Array:
            return np.array([self.named(part, name) for name in part.shooting.names], object)

        def placed(part: Segment) -> Array:
            return np.array([place + self.phase_places[part.number] for place in part.shooting.places], object)

        self.names, self.places = self._rows(named, ""), self._rows(placed, "")
        for field in ("equality", "exists", "decided", "pinned", "own"):
            setattr(self, field, self._rows(functools.partial(_of, field), False))

    @property
    def phase_places(self) -> list[str]:
        return [f" of {phase!r}" for phase in self._phases]

    def named(self, part: Segment, name: str) -> str:
        shared = not name or name in self.border.row_names
        return name if shared else f"{self._phases[part.number]}: {name}"

    def _rows(self, of: Callable[[Segment], Array], fill: Any) -> Array:
        inner = np.full((self.intervals, self.rows_per_interval), fill, object if fill == "" else type(fill))
        end = np.zeros(0)
        for part, split in zip(self.segments, self._inner):
            own, end = np.split(of(part), [split])
            inner[part.stages, : part.shooting.rows_per_interval] = own.reshape(part.shooting.intervals, -1)
            if part is not self.segments[-1]:
                inner[part.stages.stop, : len(end)] = end
        return np.concatenate([inner.ravel(), end])

    def rows_of(self, part: Segment, rows: Any) -> Any:
        split = self.intervals * self.rows_per_interval
        inner, end = rows[:split].reshape(self.intervals, -1), rows[split:]
        if part is not self.segments[-1]:
            end = inner[part.stages.stop, : self._ends[part.number]]
        joined = jnp.concatenate if isinstance(rows, jax.Array) else np.concatenate
        return joined([inner[part.stages, : part.shooting.rows_per_interval].reshape(-1), end])

    def whole_rows(self, parts: Sequence[Array]) -> Array:
        return self._rows(lambda part: parts[part.number], 0.0)

    def defect(self, stage: int, column: int) -> str:
        part = next(part for part in self.segments if stage <= part.stages.stop)
        if stage < part.stages.stop:
            own = part.shooting.defect(stage - part.stages.start, column)
            return f"'{self._phases[part.number]}: {own[1:]}"
        after = part.number + 1
        return f"'join before {self._phases[after]}: {self.segments[after].shooting.states[column]}'"

    def drop(self, rows: Sequence[Array]) -> None:
        for part, own in zip(self.segments, rows):
            part.shooting.drop([own])
        self._assemble()

    def _given(self, part: Segment, given: Given) -> Given:
        return given._replace(final=given.final.final[part.number], margins=self.rows_of(part, given.margins))

    # ---- values -------------------------------------------------------------------------------------------------

    def move(self, point: Point, step: Step) -> Point:
        xs = []
        for part in self.segments:
            own = part.shooting
            d = jnp.asarray(step.d)[part.nodes, : own.n]
            xs.append(jax.vmap(own.dynamics.group.retract)(point.xs[part.number], d))
        us = point.us + step.u
        # What a join leaves free is where the next node is: the step to it from there is taken.
        for join in self.joins:
            us = us.at[join.stage, : len(join.free)].add(-jnp.asarray(step.d)[join.stage + 1, join.free])
        return Point(tuple(xs), us, point.border + step.border)

    def charts(self, xs: Any, d: jax.Array) -> jax.Array:
        found = jnp.tile(jnp.eye(self.n, dtype=d.dtype), (self.nodes, 1, 1))
        for part in self.segments:
            n, nodes = part.shooting.n, part.nodes
            found = found.at[nodes, :n, :n].set(part.shooting.charts(xs[part.number], d[nodes, :n]))
        return found

    def values(self, point: Point, given: Given, d: jax.Array | None = None) -> Values:
        cost = jnp.zeros((), point.us.dtype)
        defects = jnp.zeros((self.intervals, self.n), cost.dtype)
        rows, end = jnp.zeros((self.intervals, self.rows_per_interval), cost.dtype), cost[None][:0]
        for part, split in zip(self.segments, self._inner):
            own = part.shooting
            found = own.values(part.of(point), self._given(part, given), self._of(part, d))
            cost, end = cost + found.cost, found.rows[split:]
            defects = defects.at[part.stages, : own.n].set(found.defects)
            rows = rows.at[part.stages, : own.rows_per_interval].set(found.rows[:split].reshape(own.intervals, -1))
            if part is not self.segments[-1]:
                rows = rows.at[part.stages.stop, : len(end)].set(end)
        for number, join in enumerate(self.joins):
            gap = join.gap(*self._around(number, point, given, d))
            gap = gap.at[join.free].set(point.us[join.stage, : len(join.free)])
            step = 0.0 if d is None else d[join.stage + 1, : len(gap)]
            defects = defects.at[join.stage, : len(gap)].set(gap - step)
        return Values(cost, defects, jnp.concatenate([rows.reshape(-1), end]))

    @staticmethod
    def _of(part: Segment, d: jax.Array | None) -> jax.Array | None:
        """The step of a phase."""
        return None if d is None else d[part.nodes, : part.shooting.n]

    def _around(self, number: int, point: Point, given: Given, d: jax.Array | None) -> tuple[Any, ...]:
        """What the gap of a join is a function of."""
        last = {name: a[-1] for name, a in point.xs[number].items()}
        start = {name: a[0] for name, a in point.xs[number + 1].items()}
        before = self.segments[number]
        z = jnp.zeros(before.shooting.n + self.border.size, point.us.dtype)
        if d is not None:
            z = z.at[: before.shooting.n].set(d[before.nodes.stop - 1, : before.shooting.n])
        return z, (last, point.border), start, given.final.initial[number + 1], given.params

    # ---- derivatives --------------------------------------------------------------------------------------------

    def derivatives(
        self, point: Point, y: jax.Array, w: jax.Array, given: Given, d: jax.Array | None = None
    ) -> Derivatives:
        size, dtype = self.n + self.m + self.border.size, y.dtype
        defects = jnp.zeros((self.intervals, self.n, size), dtype)
        rows = jnp.zeros((self.intervals, self.rows_per_interval, size), dtype)
        gradient = jnp.zeros((self.intervals, size), dtype)
        # Controls that are only padding rest.
        hessian = jnp.zeros((self.intervals, size, size), dtype)
        padding = np.concatenate([np.zeros((self.intervals, self.n)), ~self.free.u], axis=1)
        diagonal = np.arange(self.n + self.m)
        hessian = hessian.at[:, diagonal, diagonal].add(padding)
        for part in self.segments:
            own, stages = part.shooting, part.stages
            own_y, own_w = y[stages, : own.n], self.rows_of(part, w)
            found = own.derivatives(part.of(point), own_y, own_w, self._given(part, given), self._of(part, d))
            columns = np.concatenate([part.columns, self._border_columns])
            stage = np.arange(stages.start, stages.stop)
            defects = defects.at[np.ix_(stage, np.arange(own.n), columns)].set(found.defects)
            rows = rows.at[np.ix_(stage, np.arange(own.rows_per_interval), columns)].set(found.rows)
            gradient = gradient.at[np.ix_(stage, columns)].set(found.gradient)
            hessian = hessian.at[np.ix_(stage, columns, columns)].add(found.hessian)
            seen = np.concatenate([np.arange(own.n), self._border_columns])
            if part is not self.segments[-1]:
                k = [stages.stop]
                rows = rows.at[np.ix_(k, np.arange(self._ends[part.number]), seen)].set(found.end_rows[None])
                gradient = gradient.at[np.ix_(k, seen)].set(found.end_gradient[None])
                hessian = hessian.at[np.ix_(k, seen, seen)].add(found.end_hessian[None])
                join, around = self.joins[part.number], self._around(part.number, point, given, d)
                count = self.segments[part.number + 1].shooting.n
                slopes = join.gap.slopes(*around)
                bends = join.gap.bends(y[stages.stop, :count], *around)
                defects = defects.at[np.ix_(k, np.arange(count), seen)].set(slopes[None])
                defects = defects.at[stages.stop, join.free, self.n + np.arange(len(join.free))].set(1.0)
                hessian = hessian.at[np.ix_(k, seen, seen)].add(bends[None])
        # The end, of the last phase.
        whole = np.concatenate([np.arange(own.n), self.n + np.arange(self.border.size)])
        of_end = self.n + self.border.size
        return Derivatives(
            defects,
            rows,
            jnp.zeros((self._ends[-1], of_end), dtype).at[:, whole].set(found.end_rows),
            gradient,
            jnp.zeros(of_end, dtype).at[whole].set(found.end_gradient),
            hessian,
            jnp.zeros((of_end, of_end), dtype).at[np.ix_(whole, whole)].set(found.end_hessian),
        )


def _of(field: str, part: Segment) -> Array:
    found: Array = getattr(part.shooting, field)
    return found


def told_before(before: Shooting, after: Shooting, unchanged: set[str]) -> None:
    """Take rows out of the start of a phase that are asked, of the same states, at the end of the one before."""
    told = {key for key, at_end in zip(_keys(before.path), before.path.at_nodes()) if at_end}
    for place, row in after.start_rows():
        same = after.path.states[row] <= unchanged and _keys(after.path)[row] in told
        if same and after.path.at_nodes()[row]:
            after.exists[place] = after.decided[place] = False


def _keys(path: PathRows) -> list[Any]:
    """What makes rows the same."""
    keys: list[Any] = [(row.key(), entry) for row in path.residuals for entry in range(prod(row.shape))]
    return keys + [(bound.leaf, bound.entry, bound.sign, bound.limit) for bound in path.bounds]
