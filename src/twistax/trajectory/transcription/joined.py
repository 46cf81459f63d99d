"""Several phases as one discrete problem: the stages of each phase in turn, with an additional stage, a join, between
two phases.

States, controls and rows of smaller phases are padded to the largest phase, so all stages cost as much as the largest.
The last node of a phase and the first node of the next are both unknown. The defect of the join states

    F(d, b) = Log(x_next^-1 jump(x_last Exp(d), b)),   d_next = F,

with the conditions and the cost of the phase's end as its rows and its cost. An entry of x_next that no link determines
is a control u of the join: F = u there, the step of this entry from the node.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...expr import Expr, Inputs, evaluate_all
from ...system.dynamics import Arrays
from ..problem.statement import PathRows
from .iterate import Step
from .shooting import PhaseSegment, Shooting, Transcribed


class Join:
    """A join between two phases: the initial states of the next phase as expressions of the last states of the previous
    one.

    Args:
        before, after: the two phases.
        sources: state -> an expression of the last states of the previous phase, or None for a free state.
        initial: state -> the values that replace its link, NaN for free entries; a solve may use other values.
        fixed: state -> (dimension,) the tangents with such a value.

    Attributes:
        stage: the index of its stage.
        free: the tangents of the next initial state that neither a link nor a value determines.
        key: what the defect depends on besides its expressions and the layout of both phases.
    """

    stage = 0

    def __init__(
        self,
        before: Shooting,
        after: Shooting,
        sources: Mapping[str, Expr | None],
        initial: Mapping[str, Array | None],
        fixed: Mapping[str, Array],
    ) -> None:
        self._before, self._after = before, after
        names = after.dynamics.group.factors
        self._sources = {name: sources[name] for name in names}
        self._placed = {name: ~np.isnan(value) for name, value in initial.items() if value is not None}
        self._loose = np.zeros(after.n, bool)
        for name, part in after.dynamics.group.slices.items():
            self._loose[part] = ~fixed[name] if sources[name] is None else False
        self.free = np.flatnonzero(self._loose)
        placed = tuple(self._placed[name].tobytes() if name in self._placed else None for name in names)
        self.key = (placed, tuple(sources[name] is None for name in names), self._loose.tobytes())

    @property
    def sources(self) -> tuple[Expr, ...]:
        """The expressions of the previous phase's last states, in the order of the next phase's states."""
        return tuple(source for source in self._sources.values() if source is not None)

    def gap_at(
        self, sources: Sequence[Expr], z: jax.Array, base: Arrays, start: Arrays, initial: Arrays, params: Arrays
    ) -> jax.Array:
        """The defect of the join at z = [d, b]: a step d of the last node from its base, and the shared unknowns b.

        Args:
            sources: the expressions of `sources`, or others of their shapes.
        """
        before = self._before
        x, b = before.dynamics.group.retract(base, z[: before.n]), z[before.n :]
        begin, length = before.span(b)
        inputs = Inputs(begin + length, x, {}, params | before.border.params(b), z.dtype)
        values = iter(evaluate_all(list(sources), lambda leaf: leaf.read(inputs)))
        target = {name: start[name] if source is None else next(values) for name, source in self._sources.items()}
        for name, placed in self._placed.items():
            target[name] = jnp.where(placed, initial[name], target[name])
        target = {name: jnp.asarray(a, z.dtype) for name, a in target.items()}
        return jnp.where(self._loose, 0.0, self._after.dynamics.group.difference(start, target))


class Joined(Transcribed):
    """A problem of several phases.

    Points have a tuple with the states of each phase, and so has `Instance.final`.
    """

    def __init__(self, shootings: Sequence[Shooting], joins: Sequence[Join], names: Sequence[str]) -> None:
        self.joins, self._phases = joins, names
        self.border = shootings[0].border
        self.n = max(phase.n for phase in shootings)
        self.m = max(*(phase.m for phase in shootings), *(len(join.free) for join in joins), 0)
        self.nodes = sum(phase.nodes for phase in shootings)
        self.intervals = self.nodes - 1
        self._inner = [phase.intervals * phase.rows_per_interval for phase in shootings]
        self._ends = [len(phase.exists) - inner for phase, inner in zip(shootings, self._inner)]
        self.rows_per_interval = max([phase.rows_per_interval for phase in shootings] + self._ends[:-1])
        self.segments, first = list[PhaseSegment](), 0
        for number, phase in enumerate(shootings):
            nodes, stages = slice(first, first + phase.nodes), slice(first, first + phase.intervals)
            self.segments.append(PhaseSegment(number, phase, nodes, stages))
            first += phase.nodes
        d, u = np.zeros((self.nodes, self.n), bool), np.zeros((self.intervals, self.m), bool)
        self.perturbable = np.zeros_like(d)
        for part in self.segments:
            phase = part.shooting
            self.perturbable[part.nodes, : phase.n] = phase.perturbable
            d[part.nodes, : phase.n], u[part.stages, : phase.m] = phase.free.d, phase.free.u
        for part, join in zip(self.segments, joins):
            join.stage = part.stages.stop
            u[join.stage, : len(join.free)] = True
        self.free = Step(d, u, self.border.free)
        self._gather_rows()

    segments: list[PhaseSegment]

    def _gather_rows(self) -> None:
        places = self.phase_places
        self.names = self._rows(lambda p: [self.named(p, name) for name in p.shooting.names], "")
        self.places = self._rows(lambda p: [place + places[p.number] for place in p.shooting.places], "")
        for field in ("equality", "exists", "determined", "redundant", "at_single_node"):
            setattr(self, field, self._rows(lambda p: getattr(p.shooting, field), False))  # noqa: B023

    @property
    def phase_places(self) -> list[str]:
        return [f" of {phase!r}" for phase in self._phases]

    def named(self, part: PhaseSegment, name: str) -> str:
        shared = not name or name in self.border.row_names
        return name if shared else f"{self._phases[part.number]}: {name}"

    def _rows(self, of: Callable[[PhaseSegment], Any], fill: Any) -> Array:
        kind = object if fill == "" else type(fill)
        inner, end = np.full((self.intervals, self.rows_per_interval), fill, kind), np.zeros(0)
        for part, split in zip(self.segments, self._inner):
            rows, end = np.split(np.asarray(of(part), kind), [split])
            inner[part.stages, : part.shooting.rows_per_interval] = rows.reshape(part.shooting.intervals, -1)
            if part is not self.segments[-1]:
                inner[part.stages.stop, : len(end)] = end
        return np.concatenate([inner.ravel(), end])

    def rows_of(self, part: PhaseSegment, rows: Any) -> Any:
        inner, end = np.split(np.asarray(rows), [self.intervals * self.rows_per_interval])
        inner = inner.reshape(self.intervals, -1)
        if part is not self.segments[-1]:
            end = inner[part.stages.stop, : self._ends[part.number]]
        return np.concatenate([inner[part.stages, : part.shooting.rows_per_interval].reshape(-1), end])

    def rows_of_all(self, parts: Sequence[Array]) -> Array:
        return self._rows(lambda part: parts[part.number], 0.0)

    def defect(self, stage: int, column: int) -> str:
        part = next(part for part in self.segments if stage <= part.stages.stop)
        if stage < part.stages.stop:
            of_phase = part.shooting.defect(stage - part.stages.start, column)
            return f"'{self._phases[part.number]}: {of_phase[1:]}"
        after = part.number + 1
        return f"'join before {self._phases[after]}: {self.segments[after].shooting.states[column]}'"

    def drop(self, rows: Sequence[Array]) -> None:
        for part, redundant in zip(self.segments, rows):
            part.shooting.drop([redundant])
        self._gather_rows()


def drop_repeated_rows(before: Shooting, after: Shooting, unchanged: set[str]) -> None:
    """Remove rows at the start of a phase that duplicate rows of the same states at the end of the previous phase."""
    at_end = {key for key, is_there in zip(_keys(before.path), before.path.at_nodes()) if is_there}
    for place, row in after.start_rows():
        same = after.path.states[row] <= unchanged and _keys(after.path)[row] in at_end
        if same and after.path.at_nodes()[row]:
            after.exists[place] = after.determined[place] = False


def _keys(path: PathRows) -> list[Any]:
    keys: list[Any] = [(row.key(), entry) for row in path.residuals for entry in range(prod(row.shape))]
    return keys + [(bound.leaf, bound.entry, bound.sign, bound.limit) for bound in path.bounds]
