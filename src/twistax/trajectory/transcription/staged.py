"""A transcribed problem in the form of the solver's core, with points, steps and rows as flat arrays.

The array z holds the points of all nodes, controls and shared unknowns, stage by stage; v has tangents in place of
points. Rows are inequalities h, equalities e, and lower and upper bounds of v.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...jax_inside import in_double
from ...solver.transcription import EQUALITY, INEQUALITY, Transcription
from .iterate import Instance, Iterate
from .kernels import PhaseFunctions, point_of
from .shooting import Transcribed
from .staged_phase import StagedPhase
from .vectors import Numbers


class Staged:
    """A transcribed problem in the form of the solver's core.

    Args:
        transcribed: the discrete problem.
        problems: the staged problems of its phases.
        instance: data of a solve, for shapes.

    Attributes:
        numbers: the data of a solve, as one vector.
        parts: its phases.
        transcription: functions and sizes in the core's form.
        first: the index in v of the first unknown of each stage.
        plain: the indices, in z and in v, of vector-space quantities: states without a group, controls and shared
            unknowns.
        curved: the entries of z that belong to states on non-flat manifolds.
        turning: the entries of v that are rotations.
        places_alone: groups of inequalities and equalities such that no two of a group belong to one stage.
    """

    def __init__(self, transcribed: Transcribed, problems: Sequence[Any], instance: Instance) -> None:
        self.transcribed, self.border = transcribed, transcribed.border
        points = [point_of(problem.shooting) for problem in problems]
        self.numbers = Numbers(points, instance, [problem.shooting.by_node for problem in problems])
        with in_double():
            every = [PhaseFunctions(p.shooting, self.numbers, p.squares, p.order) for p in problems]
            pairs = zip(every, transcribed.joins, problems[1:])
            joins = [functions.join(join, after.shooting) for functions, join, after in pairs]
            self.parts = [
                StagedPhase(
                    segment,
                    p.node_rows,
                    functions.kernels(p.node_rows),
                    join,
                    self.numbers.node_rows(number),
                    self.numbers.of_phase(number).start,
                )
                for number, (segment, p, functions, join) in enumerate(
                    zip(transcribed.segments, problems, every, [*joins, None])
                )
            ]
        self.assemble(instance)

    def assemble(self, instance: Instance) -> None:
        """Take memory for the numbers of a problem, and place its rows."""
        self._instance: Instance | None = None
        phases = [part.phase for part in self.parts]
        self.transcription = Transcription(phases, self.border.unknowns, self.numbers.vector(instance))
        stages = self.transcription.stages
        self.first, first = stages.first, stages.first_point
        self._shared = stages.variables - stages.parameters, stages.points - stages.parameters
        every = np.repeat(np.arange(len(stages.controls)), stages.controls)
        columns = np.arange(len(every)) - np.repeat(np.cumsum(stages.controls) - stages.controls, stages.controls)
        self._us = every, columns
        self._us_v = (self.first + stages.states)[every] + columns
        self._us_z = (first + (stages.point_states or stages.states))[every] + columns
        self._nodes_v = [self.first[part.stages][:, None] + np.arange(part.shooting.n) for part in self.parts]
        self._nodes_z = [first[part.stages][:, None] + np.arange(part.point.size) for part in self.parts]
        shared = np.arange(stages.parameters)
        self.turning, in_v = np.zeros(stages.variables, bool), [self._us_v, self._shared[0] + shared]
        in_z = [self._us_z, self._shared[1] + shared]
        for part, at_v, at_z in zip(self.parts, self._nodes_v, self._nodes_z):
            self.turning[at_v[:, part.shooting.turns]] = True
            for name, group in part.shooting.dynamics.group.factors.items():
                if group.flat:
                    in_v.append(at_v[:, part.shooting.dynamics.group.slices[name]].ravel())
                    in_z.append(at_z[:, part.point.places(name)].ravel())
        self.plain = np.concatenate(in_z), np.concatenate(in_v)
        flat = np.full(stages.variables, -1, np.int32)
        flat[self.plain[1]] = self.plain[0]
        self.transcription.functions = dataclasses.replace(self.transcription.functions, flat=flat)
        self.curved = np.ones(stages.points, bool)
        self.curved[self.plain[0]] = False
        self._margins = np.zeros(len(self.transcribed.exists))
        self._place_rows()
        self.places_alone, self._levels = self._alone(), self._groups()

    def _place_rows(self) -> None:
        """Assign each row an index among inequalities, equalities, lower bounds or upper bounds."""
        stages, transcribed = self.transcription.stages, self.transcribed
        counts = np.cumsum([sum(stages.inequalities), sum(stages.equalities), stages.variables, stages.variables])
        self._kinds, nothing = counts.tolist(), int(counts[-1])
        first = {INEQUALITY: 0, EQUALITY: self._kinds[0]}
        bounds, places = list[tuple[Array, ...]](), list[Array]()
        every = zip(transcribed.segments, self.parts, self.transcription.path_places, self.transcription.node_places)

        def among(place: Array, kinds: Array) -> Array:
            by_kind = [place + first[kind] for kind in (INEQUALITY, EQUALITY)]
            return np.select([kinds == INEQUALITY, kinds == EQUALITY], by_kind, nothing)

        for segment, part, path, nodes in every:
            of_nodes = [among(*both) for both in zip(nodes, part.phase.conditions)]
            place, bound = part.all_rows(among(path, part.phase.path), of_nodes, float(nothing)), part.bounds
            shared = self._shared[0] + bound.columns - part.shooting.n - part.shooting.m
            of_stage = self.first[part.stages.start + bound.stages] + bound.columns
            at = np.where(np.isnan(bound.limits), shared, of_stage)
            place[bound.rows] = np.where(bound.upper, self._kinds[2], self._kinds[1]) + at
            rows = transcribed.rows_of(segment, np.arange(len(transcribed.exists)))[bound.rows]
            bounds.append((rows, at, bound.upper, bound.limits))
            places.append(place)
        self._bounds = [np.concatenate(parts) for parts in zip(*bounds)]
        # Padding of smaller phases has no index either.
        self._places = transcribed.rows_of_all([place - nothing for place in places]).astype(int) + nothing

    def drop(self, rows: Sequence[Array], instance: Instance) -> None:
        """Remove redundant rows of each phase, which other rows imply; they are only checked."""
        self.transcribed.drop(rows)
        for part in self.parts:
            part.describe()
        self.assemble(instance)

    def alone(self, instance: Instance) -> Staged:
        """A copy for another thread: it shares kernels, not memory."""
        other = copy.copy(self)
        other.assemble(instance)
        return other

    def set_instance(self, instance: Instance) -> None:
        """Set the data of the solve."""
        if instance is self._instance:
            return
        self._instance = instance
        self.transcription.set_data(self.numbers.vector(instance))
        self._margins = np.broadcast_to(np.asarray(instance.margins), self._margins.shape)
        for number, (part, segment) in enumerate(zip(self.parts, self.transcribed.segments)):
            rows = self.transcribed.rows_of(segment, self._margins)
            self.transcription.set_margins(number, *part.by_place(rows))

    # ---- points ---------------------------------------------------------------------------------------------------

    def flat(self, point: Iterate) -> Array:
        """The array z of a point."""
        z, states = np.zeros(self.transcription.stages.points), self._states(point)
        for part, at, xs in zip(self.parts, self._nodes_z, states):
            z[at] = part.point.joined(xs, 1)
        us, shared = np.asarray(point.us)[self._us], np.ravel(point.border)[self.border.unknown]
        z[self._us_z], z[self._shared[1] :] = us, shared
        return z

    def point(self, z: Array) -> Iterate:
        """The point of an array z; fixed durations are those of the present data."""
        us = np.zeros((self.transcribed.intervals, self.transcribed.m))
        us[self._us] = z[self._us_z]
        xs = [part.point.split(z[at]) for part, at in zip(self.parts, self._nodes_z)]
        border = self.border.complete(z[self._shared[1] :], self.numbers.limits(self.transcription.data))
        return Iterate(xs[0] if self.transcribed.segments[0].alone else tuple(xs), us, border)

    def coordinates(self, z: Array) -> Array:
        """The array v of a point z: flat states, controls and shared unknowns as they are, zeros elsewhere."""
        v = np.zeros(self.transcription.stages.variables)
        v[self.plain[1]] = z[self.plain[0]]
        return v

    def step(self, d: Array, u: Array, border: Array) -> Array:
        """The array v of a step; d (nodes, n) and u (intervals, m) are padded."""
        v = np.zeros(self.transcription.stages.variables)
        for part, at in zip(self.parts, self._nodes_v):
            v[at] = d[part.stages, : part.shooting.n]
        v[self._us_v], v[self._shared[0] :] = u[self._us], border[self.border.unknown]
        return v

    def tangents(self, v: Array) -> list[Array]:
        """The tangents (nodes, n) of each phase in v."""
        return [v[at] for at in self._nodes_v]

    def after(self, v: Array) -> Array:
        """Entries of v, as those of the states after each interval in the order of the defects."""
        states = self.transcription.stages.states
        return np.concatenate([v[a : a + n] for a, n in zip(self.first[1:], states[1:])])

    def padded(self, of_defects: Array) -> Array:
        """An array with an entry for each defect, padded to (intervals, n)."""
        counts = np.array(self.transcription.stages.after[:-1])
        result = np.zeros((len(counts), self.transcribed.n))
        result[np.arange(self.transcribed.n) < counts[:, None]] = of_defects
        return result

    def unpadded(self, dynamics: Array) -> Array:
        """The inverse of `padded`."""
        counts = np.array(self.transcription.stages.after[:-1])
        flat: Array = np.asarray(dynamics)[np.arange(self.transcribed.n) < counts[:, None]]
        return flat

    def _states(self, point: Iterate) -> Sequence[Any]:
        return [point.xs] if self.transcribed.segments[0].alone else point.xs

    # ---- limits and rows ------------------------------------------------------------------------------------------

    def limits(self, v: Array, instance: Instance) -> tuple[Array, Array]:
        """Lower and upper bounds of the coordinates v; equal for a fixed entry."""
        lower, upper = np.full(len(v), -np.inf), np.full(len(v), np.inf)
        lower[self._shared[0] :], upper[self._shared[0] :] = np.asarray(instance.limits)[self.border.unknown].T
        rows, places, is_upper, limits = self._bounds
        for bound, side, most, sign in ((lower, False, np.maximum, 1.0), (upper, True, np.minimum, -1.0)):
            at = ~np.isnan(limits) & (is_upper == side)
            most.at(bound, places[at], limits[at] + sign * self._margins[rows[at]])
        fixed = np.flatnonzero(~self.parts[0].shooting.free.d[0])
        lower[fixed] = upper[fixed] = v[fixed]
        return lower, upper

    def all_rows(self, h: Array, e: Array, lower: Array, upper: Array) -> Array:
        """An array with an entry for each row, from arrays for inequalities, equalities, and both bounds of v."""
        rows: Array = np.concatenate([h, e, lower, upper, np.zeros(1)])[self._places]
        return rows

    def split_rows(self, rows: Array) -> tuple[Array, Array, Array, Array]:
        """The inverse of `all_rows`; entries without a row are zero."""
        every = np.zeros(self._kinds[-1] + 1)
        every[self._places] = rows
        h, e, lower, upper = np.split(every[:-1], self._kinds[:-1])
        return h, e, lower, upper

    @property
    def stages_of_rows(self) -> tuple[Array, Array]:
        """The stage of every inequality and of every equality."""
        stages = self.transcription.stages
        every = np.arange(len(stages.states))
        return np.repeat(every, stages.inequalities), np.repeat(every, stages.equalities)

    def _alone(self) -> list[tuple[Array, Array]]:
        """All conditions, and each path row at its last place in each interval, which represents its other places
        there.
        """
        rounds, none = list[tuple[Array, Array]](), np.zeros(0, int)
        for kind, stages in zip((INEQUALITY, EQUALITY), self.stages_of_rows):
            chosen = np.ones(len(stages), bool)
            for part, every in zip(self.parts, self.transcription.path_places):
                exists = part.phase.path == kind
                later = np.cumsum(exists[:, ::-1], axis=1)[:, ::-1]  # the number of rows from each place on
                chosen[every[exists & (later > 1)]] = False
            places = np.flatnonzero(chosen)
            numbers = np.arange(len(places)) - np.searchsorted(stages[places], stages[places])
            for k in range(int(numbers.max(initial=-1)) + 1):
                alone = places[numbers == k]
                rounds.append((alone, none) if kind == INEQUALITY else (none, alone))
        return rounds

    def levelled_rows(self, inequalities: Array, equalities: Array) -> tuple[Array, Array]:
        """Scales of rows: for a path row the largest over all its places; 1 if there is none."""
        result = []
        for values, (order, starts, groups) in zip((inequalities, equalities), self._levels):
            sizes = np.where(np.isfinite(values) & (values > 0.0), values, 0.0)
            if len(sizes):
                sizes = np.maximum.reduceat(sizes[order], starts)[groups]
            result.append(sizes + (sizes == 0.0))
        return result[0], result[1]

    def _groups(self) -> list[tuple[Array, Array, Array]]:
        """For inequalities and equalities: a permutation that sorts them into groups of equal size, the starts of the
        groups, and the groups.
        """
        groups = []
        for kind, count in zip((INEQUALITY, EQUALITY), self.transcription.stages.row_counts[1:]):
            labels, used = np.arange(count), count
            for part, every in zip(self.parts, self.transcription.path_places):
                rows = np.broadcast_to(np.arange(part.phase.path.shape[2]), part.phase.path.shape)
                is_kind = part.phase.path == kind
                labels[every[is_kind]] = used + rows[is_kind]
                used += part.phase.path.shape[2]
            _, labels, counts = np.unique(labels, return_inverse=True, return_counts=True)
            groups.append((np.argsort(labels, kind="stable"), np.cumsum(counts) - counts, labels))
        return groups
