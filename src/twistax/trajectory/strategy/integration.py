"""Integration with the solver's core: accurate integration of each interval from its planned start, and rollouts of a
phase.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...integrators import RKMK, tableaus
from ...solver.kernels import Argument
from ...solver.transcription import INEQUALITY, NONE, CorePhase, Scheme, Transcription
from ..transcription.evaluation import Evaluated, moved
from ..transcription.iterate import Instance, Iterate
from ..transcription.methods import Collocation, MultipleShooting
from ..transcription.staged import Staged
from ..transcription.staged_phase import StagedPhase
from ..transcription.vectors import Numbers

#: The number of random moves of all unknowns; in a single one, changes may cancel.
_MOVES = 4
#: A method for values at nodes only; its ends of intervals are not meaningful.
_AT_NODES = MultipleShooting(RKMK(tableaus.EULER), 1)


class Closely(NamedTuple):
    """The result of the accurate integration of each interval of a phase from its planned start."""

    gaps: Array  # (intervals, n) the tangent from the planned end to the accurate end
    rows: Array  # (intervals, path rows) the largest value along the interval; for equalities the largest magnitude
    cost: float  # for the phase, including its end
    middles: dict[str, Array]  # states halfway


class Changes(NamedTuple):
    """Changes of rows and objective under moves of the unknowns."""

    rows: Array
    cost: float


class CloseIntegration:
    """Integrates every interval of a staged problem accurately.

    Args:
        staged: the problem.
        problems: those of its phases.
    """

    def __init__(self, staged: Staged, problems: Sequence[Any], instance: Instance) -> None:
        self._staged, data = staged, staged.numbers.vector(instance)
        self._phases = [_looking(part, p.transcription.finer.scheme) for part, p in zip(staged.parts, problems)]
        self._transcription = Transcription(self._phases, staged.border.unknowns, data)
        at_nodes = [_looking(part, _AT_NODES.scheme) for part in staged.parts]
        self._at_nodes = Transcription(at_nodes, staged.border.unknowns, data)
        self._signs = np.zeros((0, 0))

    def at(self, z: Array, instance: Instance) -> tuple[Closely, ...]:
        """The accurate integration of all phases at a point of the problem."""
        self._transcription.set_data(self._staged.numbers.vector(instance))
        seen = Evaluated(self._transcription, z)
        middles = self._middles(z)
        return tuple(self._phase(k, seen, middles[k]) for k in range(len(self._phases)))

    def determined_rows(self, z: Array, instance: Instance) -> Array:
        """(rows,) values of the node rows that fixed ends or other rows determine; other entries are meaningless."""
        transcription, rows = self._at_nodes, []
        transcription.set_data(self._staged.numbers.vector(instance))
        h = Evaluated(transcription, z).h
        for part, path, nodes in zip(self._staged.parts, transcription.path_places, transcription.node_places):
            at_starts = np.zeros(part.phase.path.shape)
            at_starts[:, 0] = h[path[:, 0]]
            rows.append(part.all_rows(at_starts, [h[places] for places in nodes]))
        return self._staged.transcribed.rows_of_all(rows)

    def _phase(self, number: int, seen: Evaluated, middles: dict[str, Array]) -> Closely:
        part, transcription = self._staged.parts[number], self._transcription
        rows = seen.h[transcription.path_places[number]]  # (intervals, points, rows)
        rows = np.where(part.shooting.path.equality, np.abs(rows), rows).max(axis=1, initial=-np.inf)
        n, first = part.shooting.n, sum(transcription.stages.after[: part.stages.start])
        gaps = seen.c[first : first + part.shooting.intervals * n].reshape(-1, n)
        return Closely(gaps, rows, seen.cost[0] if number == 0 else 0.0, middles)

    def _middles(self, z: Array) -> list[dict[str, Array]]:
        """States halfway through each interval."""
        d = np.zeros((self._staged.transcribed.nodes, self._staged.transcribed.n))
        for number, (part, phase) in enumerate(zip(self._staged.parts, self._phases)):
            eta = self._transcription.states(number, phase.method.substeps // 2)
            d[part.stages.start : part.stages.stop - 1, : eta.shape[1]] = eta
        us, border = np.zeros((len(d) - 1, self._staged.transcribed.m)), np.zeros(self._staged.border.size)
        d = self._staged.step(d, us, border)
        halfway = self._staged.point(moved(self._transcription, z, d))
        xs = halfway.xs if isinstance(halfway.xs, tuple) else (halfway.xs,)
        return [{name: a[:-1] for name, a in states.items()} for states in xs]

    def changes(self, z: Array, v: Array, length: float) -> Changes:
        """The largest changes of rows and objective under random moves of all free unknowns.

        Args:
            v: the sizes of all unknowns.
            length: the length of the moves, in these sizes.
        """
        staged, transcription = self._staged, self._staged.transcription
        free = staged.transcribed.free
        which = staged.step(staged.transcribed.perturbable, free.u, free.border) != 0.0
        before = Evaluated(transcription, z)
        rows, cost = np.zeros(len(staged.transcribed.exists)), 0.0
        if self._signs.shape[1] != len(v):
            rng = np.random.default_rng(0)
            size = len(v)
            drawn = (rng.choice([-1.0, 1.0], size=size) * rng.uniform(0.5, 1.0, size=size) for _ in range(_MOVES))
            self._signs = np.stack(list(drawn))
        for signs in self._signs:
            step = np.where(which, length * v * signs, 0.0)
            there = Evaluated(transcription, moved(transcription, z, step))
            change = np.abs(staged.all_rows(there.h - before.h, there.e - before.e, step, step))
            rows = np.fmax(rows, np.where(np.isfinite(change), change, 0.0))
            cost = max(cost, abs(float(there.cost[0] - before.cost[0])))
        return Changes(rows, cost)


def _looking(part: StagedPhase, method: Scheme) -> CorePhase:
    """A phase with another transcription, with all rows as inequalities so that they are only evaluated."""
    shape = (part.phase.intervals, method.substeps + 1, part.phase.path.shape[2])
    conditions = [np.full(len(rows), INEQUALITY) for rows in part.phase.conditions]
    return dataclasses.replace(part.phase, method=method, path=np.full(shape, INEQUALITY), conditions=conditions)


class CoreRollout:
    """Integrates the controls of a phase.

    Args:
        part: the phase.
        transcription: the integration of an interval; the substeps are the samples.
        numbers: the layout of the numbers of a solve.
        data: these.
    """

    def __init__(
        self, part: StagedPhase, transcription: MultipleShooting | Collocation, numbers: Numbers, data: Array
    ) -> None:
        self._part, self._samples, self._numbers, self._data = part, int(transcription.substeps), numbers, data
        self._start, self._width = np.zeros(1), np.ones(1)
        phase, (_, end) = part.phase, part.phase.kernels.nodes[-1]
        alone = dataclasses.replace(
            phase,
            method=transcription.scheme,
            kernels=dataclasses.replace(phase.kernels, nodes=[(1, end)]),
            starts=self._start,
            widths=self._width,
            path=np.full((1, self._samples + 1, phase.path.shape[2]), NONE),
            conditions=[np.full(len(phase.conditions[-1]), NONE)],
            join=None,
        )
        self._transcription = Transcription([alone], part.shooting.border.unknowns, data)

    def states(self, point: Iterate) -> dict[str, Array]:
        """All states at the sample times, (intervals * samples + 1, ...), from the first node of the phase."""
        base, *planned = self._part.point.joined(point.xs, 1)
        samples = [base[None]]
        for k, (u, end) in enumerate(zip(np.asarray(point.us), planned)):
            samples.append(self.interval(k, base, u, end, np.ravel(point.border)))
            base = samples[-1][-1]
        xs: dict[str, Any] = self._part.point.split(np.concatenate(samples))
        return xs

    def interval(self, number: int, base: Array, u: Array, end: Array, border: Array) -> Array:
        """(samples, ...) the states along an interval that starts at a node.

        Args:
            end: a node near the end, about which the logarithm is continuous.
        """
        shooting = self._part.shooting
        self._start[0], self._width[0] = shooting.mesh.shares[number], shooting.mesh.widths[number]
        # The cached integration is that of another interval.
        self._transcription.set_data(self._numbers.at_times(self._data, border))
        Evaluated(self._transcription, np.concatenate([base, u[: shooting.m], end, border[shooting.border.unknown]]))
        eta = np.stack([self._transcription.states(0, k)[0] for k in range(1, self._samples + 1)])
        retract = self._part.phase.kernels.retract
        if retract is None:
            return base + eta
        return retract(len(eta), len(base), {Argument.Z: eta, Argument.BASE: base[None]})
