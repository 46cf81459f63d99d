"""Units of the unknowns, rows and objective of a staged problem, from its derivatives at a start."""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from ..solver.transcription import INEQUALITY
from .sizes import Sizes
from .transcription.evaluation import Evaluated, moved
from .transcription.iterate import Iterate
from .transcription.staged import Staged

#: Rotation matrices whose entries differ by more represent different attitudes.
_TURNED = 0.5
#: In minimum time, limited controls move the least controllable state by this multiple of its size: 8 for a double
#: integrator, 2 for a single one. Durations in which they can move it by more than `_RESERVE` are reduced to
#: `_FITTING`.
_FITTING, _RESERVE = 16.0, 100.0


class StartUnits:
    """Units for the solver's core, measured at a start.

    Args:
        limits: (g, 2) limits of the shared unknowns; their durations may be far too long.
        before: the units of the steps that led to the start; values below their round-off are zero.
        with_rows: whether to measure the units of rows.

    Attributes:
        parts: sizes of states, controls and shared unknowns, for each phase.
        v: units of all variables.
        rows, equalities, cost: units of the rows and of the objective; empty if rows are not measured.
    """

    @np.errstate(all="ignore")  # far from a feasible trajectory numbers may have any size
    def __init__(
        self,
        staged: Staged,
        point: Iterate,
        limits: Array | None = None,
        *,
        before: StartUnits | None = None,
        with_rows: bool = True,
    ) -> None:
        z = staged.flat(point)
        self._staged_at = z, staged.coordinates(z)
        at = Evaluated(staged.transcription, z)
        self._at: Evaluated | None = at  # until rows are measured
        self._least = None if before is None else [sizes.rounding() for sizes in before.parts]
        self.parts: list[Sizes] = self._measured(staged, point, at, at.differentiate(), self._is_fitted(staged, limits))
        self._first = self.parts
        if limits is not None and _reserve(self.parts) > _RESERVE:
            self.parts = self._fitted(staged, point, limits, self.parts)[1]
        self.border = np.max([sizes.border for sizes in self.parts], axis=0)
        self.v = np.concatenate([*self._by_stage(staged), self.border[staged.border.unknown]])
        self.rows: Array = np.zeros(0)
        self.equalities: Array = np.zeros(0)
        if with_rows:
            self.measure_rows(staged)
        steps = self._followed(at)
        change_of_cost = np.abs(at.gradient) @ steps + 0.5 * at.curvatures(at.H, at.by_run(steps)).sum()
        if not change_of_cost > 0.0:  # if gradient and curvature vanish there: the change under a whole move
            step = np.random.default_rng(0).uniform(0.5, 1.0, len(self.v)) * self.v
            there = Evaluated(staged.transcription, moved(staged.transcription, self._staged_at[0], step))
            change_of_cost = abs(there.cost[0] - at.cost[0])
        self.cost = float(change_of_cost) if np.isfinite(change_of_cost) and change_of_cost > 0.0 else 1.0

    @staticmethod
    def _is_fitted(staged: Staged, limits: Array | None) -> bool:
        """Whether there are durations that may be too long."""
        return limits is not None and bool(staged.border.free[: staged.border.phases].any())

    @np.errstate(all="ignore")
    def measure_rows(self, staged: Staged) -> None:
        """Measure the units of rows: the changes of inequalities and equalities under moves of all unknowns by their
        units.
        """
        at, self._at = self._at, None
        assert at is not None
        of_stages = at.by_run(self.v)
        kinds = ((at.Jh, at.stages.inequalities), (at.Je, at.stages.equalities))
        changes = [at.changes(*kind, of_stages) for kind in kinds]
        for alone in staged.places_alone:
            weights = [np.zeros(len(change)) for change in changes]
            for weight, at_place in zip(weights, alone):
                weight[at_place] = 1.0
            curvatures = at.curvatures(at.bends(*weights), of_stages)
            for change, of_rows, at_place in zip(changes, staged.stages_of_rows, alone):
                change[at_place] += 0.5 * curvatures[of_rows[at_place]]
        self.rows, self.equalities = staged.levelled_rows(*changes)
        for part, places, sizes in zip(staged.parts, staged.transcription.path_places, self.parts):
            for row, unit in part.meter.of_norm_bounds(sizes):
                at_row = places[..., row][part.phase.path[..., row] == INEQUALITY]
                self.rows[at_row] = np.minimum(self.rows[at_row], unit)

    def _followed(self, at: Evaluated) -> Array:
        """Moves by the units, reduced if a state at the end of the interval would move by more than its unit."""
        stages, steps = at.stages, self.v.copy()
        for run, F in at.batches(at.F, stages.after):
            count, width = run.stop - run.start, stages.columns[run.start] - stages.parameters
            first, rows = stages.first[run.start], stages.after[run.start]
            if not rows:
                continue
            inner = steps[first : first + count * width].reshape(count, width)
            ends = self.v[stages.first[run.start + 1 : run.stop + 1][:, None] + np.arange(rows)]
            ratio = (np.abs(F[:, :, :width]) * inner[:, None, :] / ends[:, :, None]).max(axis=1)
            inner /= np.maximum(1.0, np.where(np.isfinite(ratio), ratio, 1.0))
        return steps

    def fitted_durations(self, staged: Staged, point: Iterate, limits: Array) -> Array:
        """The shared unknowns of the start, with durations that are long enough for the limited controls."""
        return self._fitted(staged, point, limits, self._first)[0]

    def _fitted(self, staged: Staged, point: Iterate, limits: Array, parts: list[Sizes]) -> tuple[Array, list[Sizes]]:
        """Durations in which limited controls can move the states as far as required, and the sizes for these
        durations.

        The guess of a duration may be thousands of times too long. The effect of controls over such a time is not
        representative, so free durations are halved until they fit.

        Args:
            limits: (g, 2) limits of the shared unknowns.
            parts: sizes for the durations of the point.
        """
        border, (low, high), durations = staged.border, np.array(limits).T, np.asarray(point.border)
        free = border.free & (np.arange(border.size) < border.phases) & (low < high)
        while np.isfinite(_reserve(parts)) and _reserve(parts) > _FITTING:
            shorter = np.where(free, np.maximum(0.5 * durations, low), durations)
            if (shorter == durations).all():
                break
            durations, there = shorter, point.with_border(shorter)
            at = Evaluated(staged.transcription, staged.flat(there))
            if at.differentiate():  # long steps of an unstable system may overflow
                parts = self._measured(staged, there, at)
        return durations, parts

    def distance(self, other: StartUnits) -> float:
        """The largest |log| of a ratio of corresponding units of the objective, the states and the controls that affect
        them.
        """
        ratios = [np.ravel(self.cost / other.cost)]
        for mine, theirs in zip(self.parts, other.parts):
            ratios += [mine.d / theirs.d, (mine.u / theirs.u)[mine.steers]]
        return float(np.abs(np.log(np.concatenate(ratios))).max(initial=0.0))

    def fit(self, staged: Staged, point: Iterate) -> bool:
        """Whether every unknown of a point differs by less than its unit from the start at which the units were
        measured.
        """
        (z, v), there = self._staged_at, staged.flat(point)
        moved = np.abs(staged.coordinates(there) - v) <= self.v
        return bool(moved.all() and (np.abs(there - z)[staged.curved] <= _TURNED).all())

    def become_one(self) -> None:
        """Use the units of the statement, that is 1 for everything."""
        ones = [np.ones_like(a) for a in (self.border, self.v, self.rows, self.equalities)]
        self.border, self.v, self.rows, self.equalities = ones
        self.parts = [sizes.of_one() for sizes in self.parts]
        self.cost = 1.0

    def _measured(
        self, staged: Staged, point: Iterate, at: Evaluated, is_good: bool = True, with_reserve: bool = True
    ) -> list[Sizes]:
        """The sizes for each phase; without derivatives, only those that the point and the leaves determine."""
        parts, sizes_of = list[Sizes](), dict[str, Array]()
        for number, (part, segment) in enumerate(zip(staged.parts, staged.transcribed.segments)):
            phase, first = part.shooting, part.stages.start
            K, n, size = phase.intervals, phase.n, phase.size
            slopes, gaps = at.F[at.stages.first_slope[first] :], at.c[at.stages.first_defect[first] :]
            slopes = slopes[: K * n * size].reshape(K, size, n).swapaxes(1, 2)
            slopes = np.where(is_good and np.isfinite(slopes).all(), slopes, 0.0)
            gaps = gaps[: K * n].reshape(K, n)
            gaps = np.where(np.isfinite(gaps).all(), gaps, 0.0)
            least = None if self._least is None else self._least[number]
            sizes = part.meter(segment.of(point), slopes, gaps, least, with_reserve)
            for (
                name,
                other,
            ) in phase.alike.items():  # an extreme has the size of its operand, the same one in all phases
                slices = phase.dynamics.group.slices
                sizes_of.setdefault(name, sizes.d[slices.get(other, slices[name])])
                sizes.d[slices[name]] = sizes_of[name]
            parts.append(sizes)
        return parts

    def _by_stage(self, staged: Staged) -> list[Array]:
        sizes_of = list[Array]()
        for number, (part, sizes) in enumerate(zip(staged.parts, self.parts)):
            sizes_of.append(np.tile(np.concatenate([sizes.d, sizes.u]), part.shooting.intervals))
            join = part.phase.join
            free = np.zeros(0) if join is None else self.parts[number + 1].d[join.free]
            sizes_of.append(np.concatenate([sizes.d, free]))
        return sizes_of


def _reserve(parts: list[Sizes]) -> float:
    return min(sizes.reserve for sizes in parts)
