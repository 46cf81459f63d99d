"""Units of the unknowns, the rows and the objective of a staged problem, from its derivatives at a start."""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from .sizes import Sizes, measured_sizes
from .transcription.evaluation import Evaluated, moved
from .transcription.points import Point
from .transcription.staged import Staged

#: Entries of rotation matrices that differ by more are of another attitude.
_TURNED = 0.5
#: Limited controls move the state that is hardest to move by so many of its sizes in least time, of a double integrator
#: by 8, of a single one by 2. Durations in which they move it by more than `_RESERVE` are fitted to `_FITTING`.
_FITTING, _RESERVE = 16.0, 100.0


class StartUnits:
    """Units for the solver's core, measured at a start.

    Attributes:
        parts: sizes of states, controls and shared unknowns, of each phase.
        v: of all variables.
        rows, equalities, cost: of the rows and the objective.
    """

    @np.errstate(all="ignore")  # far from a trajectory numbers may be of any size
    def __init__(self, staged: Staged, point: Point, limits: Array | None = None) -> None:
        self._staged_at = staged.flat(point), staged.coordinates(point)
        at = Evaluated(staged.transcription, self._staged_at[0])
        good, stages = at.differentiate(), at.stages
        blocks = at.blocks(at.F, stages.after)
        self.parts = self._measured(staged, point, blocks if good else [np.zeros_like(b) for b in blocks], at.c)
        self._first = self.parts
        if limits is not None and _reserve(self.parts) > _RESERVE:
            self.parts = self._fitted(staged, point, limits, self.parts)[1]
        self.border = np.max([sizes.border for sizes in self.parts], axis=0)
        by_stage = self._by_stage(staged)
        self.v = np.concatenate([*by_stage, self.border])
        columns = [np.concatenate([units, self.border]) for units in by_stage]
        slopes = [at.blocks(flat, rows) for flat, rows in ((at.Jh, stages.inequalities), (at.Je, stages.equalities))]
        changes = [
            np.concatenate([np.zeros(0), *(np.abs(b) @ c for b, c in zip(stages_J, columns))]) for stages_J in slopes
        ]
        for places in staged.places_alone():
            weights = [np.zeros(len(change)) for change in changes]
            for weight, at_place in zip(weights, places):
                weight[at_place] = 1.0
            bends = [c @ np.abs(H) @ c for c, H in zip(columns, at.blocks(at.bends(*weights), stages.columns))]
            for change, stage_of_row, at_place in zip(changes, staged.stages_of_rows, places):
                change[at_place] += 0.5 * np.array(bends)[stage_of_row[at_place]]
        self.rows, self.equalities = staged.levelled_rows(*changes)
        bends = sum(c @ np.abs(H) @ c for c, H in zip(columns, at.blocks(at.H, stages.columns)))
        change_of_cost = np.abs(at.gradient) @ self.v + 0.5 * bends
        if not change_of_cost > 0.0:  # no slope and no curvature there: what a whole move changes
            step = np.random.default_rng(0).uniform(0.5, 1.0, len(self.v)) * self.v
            there = Evaluated(staged.transcription, moved(staged.transcription, staged.flat(point), step))
            change_of_cost = abs(there.cost[0] - at.cost[0])
        self.cost = float(change_of_cost) if np.isfinite(change_of_cost) and change_of_cost > 0.0 else 1.0

    def fitted_durations(self, staged: Staged, point: Point, limits: Array) -> Array:
        """Shared unknowns of the start, with durations that are long enough for the limited controls."""
        return self._fitted(staged, point, limits, self._first)[0]

    @classmethod
    def _fitted(cls, staged: Staged, point: Point, limits: Array, parts: list[Sizes]) -> tuple[Array, list[Sizes]]:
        """Durations in which limited controls can move the states as far as required, and sizes for them.

        A guess of a duration may be thousands of times too long. What controls do to states over such a time says
        nothing of the states of a trajectory, so free durations are halved until it fits.

        Args:
            limits: (g, 2) of the shared unknowns.
            parts: sizes at the durations of the point.
        """
        border, (low, high), durations = staged.border, np.array(limits).T, np.asarray(point.border)
        free = border.free & (np.arange(border.size) < border.phases) & (low < high)
        while np.isfinite(_reserve(parts)) and _reserve(parts) > _FITTING:
            shorter = np.where(free, np.maximum(0.5 * durations, low), durations)
            if (shorter == durations).all():
                break
            durations, there = shorter, point._replace(border=shorter)
            at = Evaluated(staged.transcription, staged.flat(there))
            if at.differentiate():  # long steps of an unstable system may overflow
                parts = cls._measured(staged, there, at.blocks(at.F, at.stages.after), at.c)
        return durations, parts

    def distance(self, other: StartUnits) -> float:
        """The largest |log| of a ratio of corresponding units of the objective, the states and the controls that move
        them.
        """
        ratios = [np.ravel(self.cost / other.cost)]
        for mine, theirs in zip(self.parts, other.parts):
            ratios += [mine.d / theirs.d, (mine.u / theirs.u)[mine.steers]]
        return float(np.abs(np.log(np.concatenate(ratios))).max(initial=0.0))

    def fit(self, staged: Staged, point: Point) -> bool:
        """Whether every unknown of a point is within its unit of the start at which the units were measured."""
        z, v = self._staged_at
        moved = np.abs(staged.coordinates(point) - v) <= self.v
        return bool(moved.all() and (np.abs(staged.flat(point) - z)[staged.curved] <= _TURNED).all())

    def become_one(self) -> None:
        """Use the units of the statement: 1 for everything."""
        ones = [np.ones_like(a) for a in (self.border, self.v, self.rows, self.equalities)]
        self.border, self.v, self.rows, self.equalities = ones
        self.parts = [sizes._replace(d=np.ones_like(sizes.d), u=np.ones_like(sizes.u)) for sizes in self.parts]
        self.cost = 1.0

    @staticmethod
    def _measured(staged: Staged, point: Point, blocks: list[Array], gaps: Array) -> list[Sizes]:
        by_part, sizes_of = list[Sizes](), dict[str, Array]()
        for part, segment in zip(staged.parts, staged.transcribed.segments):
            shooting, first = part.shooting, part.stages.start
            moved = np.stack(blocks[first : first + shooting.intervals])
            moved = np.where(np.isfinite(moved).all(), moved, 0.0)
            at = sum(staged.transcription.stages.after[:first])
            drift = gaps[at : at + shooting.intervals * shooting.n].reshape(-1, shooting.n)
            drift = np.where(np.isfinite(drift).all(), drift, 0.0)
            sizes = measured_sizes(shooting, segment.of(point), moved, drift)
            for name, other in shooting.alike.items():  # an extreme counts as what it is one of, in all phases alike
                slices = shooting.dynamics.group.slices
                sizes_of.setdefault(name, sizes.d[slices.get(other, slices[name])])
                sizes.d[slices[name]] = sizes_of[name]
            by_part.append(sizes)
        return by_part

    def _by_stage(self, staged: Staged) -> list[Array]:
        units = list[Array]()
        for number, (part, sizes) in enumerate(zip(staged.parts, self.parts)):
            units += [np.concatenate([sizes.d, sizes.u])] * part.shooting.intervals
            join = part.phase.join
            free = np.zeros(0) if join is None else self.parts[number + 1].d[join.free]
            units.append(np.concatenate([sizes.d, free]))
        return units


def _reserve(parts: list[Sizes]) -> float:
    return min(sizes.reserve for sizes in parts)
