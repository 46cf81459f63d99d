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
from ..system.dynamics import Arrays
from .shooting import Shooting
from .statement import PathRows
from .transcribed import Segment, Step, Transcribed


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
        self._ends = ends
        self._describe()
        self._assemble()

    def _describe(self) -> None:
        d, u = np.zeros((self.nodes, self.n), bool), np.zeros((self.intervals, self.m), bool)
        self.stirred = np.zeros_like(d)
        for part in self.segments:
            own = part.shooting
            self.stirred[part.nodes, : own.n] = own.stirred
            d[part.nodes, : own.n], u[part.stages, : own.m] = own.free.d, own.free.u
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
