"""Controls that an optimum does not determine: near-null directions of the reduced Hessian."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...system import entry_names
from ..transcription.evaluation import Evaluated
from ..transcription.iterate import Instance
from ..transcription.staged import Staged
from ..transcription.staged_phase import StagedPhase
from .warm import WarmStart

#: An undetermined move of all controls by their sizes changes the objective by less than this fraction of its unit.
#: Rows with larger scaled multipliers count as active.
_LITTLE = 1e-6
#: A control is undetermined if the active constraints leave this fraction of a move of it alone.
_SHARE = 0.3
#: Singular values of rows below this fraction of the largest are round-off.
_ROUNDING = 1e-9
#: Problems with more free unknowns than this are skipped.
_MOST = 1000
#: The proposed weight adds this fraction to the objective if a control has its typical size along the whole path.
_PRICE = 1e-3


class Undetermined(NamedTuple):
    """An entry of a control that can change along an optimum at no cost.

    Attributes:
        name: the name of the entry, prefixed with the name of the phase.
        entry: the name without the prefix.
        free_share: (intervals,) from 0 to 1, the fraction of a change of this entry alone that has no effect.
        weight: a weight of its square in the running cost that determines it.
    """

    name: str
    entry: str
    free_share: Array
    weight: float

    @property
    def intervals(self) -> int:
        """The number of intervals where it is undetermined."""
        return int((self.free_share > _SHARE).sum())


def undetermined(
    staged: Staged, warm: WarmStart, instance: Instance, derivatives: Sequence[Mapping[str, str]]
) -> list[Undetermined]:
    """The controls that a solution does not determine, to second order.

    Moves are linear combinations of initial states, controls, times and parameters along the linearised dynamics that
    keep the equalities and active inequalities. Moves for which the second derivative of the Lagrangian nearly vanishes
    span the undetermined subspace. A control is undetermined if the projection of a move of it alone on this subspace
    is long.
    Source: Nocedal and Wright, Numerical Optimization (2006), theorem 12.6 (sufficient conditions of a strict minimum).

    Args:
        derivatives: for each phase: name of a piecewise constant derivative of a control -> its expression.
    """
    staged.set_instance(instance)
    scales, sizes = warm.scales, _control_sizes(staged, warm)
    choices = _Moves(staged, warm, sizes)
    if choices.count > _MOST:
        return []
    free = choices.directions(warm)
    hessian = free.T @ choices.hessian @ free / float(scales.cost)
    values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    flat = free @ vectors[:, np.abs(values) * choices.count < 2.0 * _LITTLE]
    shares = (flat**2).sum(axis=1)
    controls, seconds = list[Undetermined](), np.asarray(warm.point.border)[: staged.border.phases]
    for number, (part, segment) in enumerate(zip(staged.parts, staged.transcribed.segments)):
        for entry, column in _entries(part, derivatives[number]):
            alone = np.array([shares[choices.places[k][column]] for k in _intervals(part)])
            size = float(sizes[part.stages.start, column - part.shooting.n])
            weight = _PRICE * float(scales.cost) / (size**2 * float(seconds[number]))
            name = staged.transcribed.named(segment, entry)
            controls.append(Undetermined(name, entry, alone, float(f"{weight:.0e}")))
    return [control for control in controls if control.intervals]


def _control_sizes(staged: Staged, warm: WarmStart) -> Array:
    """(intervals, m) the unit of each control, or its largest value in the phase if that is larger."""
    sizes, us = np.array(warm.scales.u), np.abs(warm.point.us)
    for part in staged.parts:
        rows = slice(part.stages.start, part.stages.stop - 1)
        sizes[rows] = np.maximum(sizes[rows], us[rows]).max(axis=0)
    return sizes


def _intervals(part: StagedPhase) -> range:
    return range(part.stages.start, part.stages.stop - 1)


def _entries(part: StagedPhase, derivatives: Mapping[str, str]) -> Iterator[tuple[str, int]]:
    """The entries of controls and their columns, without the controls that represent bounds of norms and slacks."""
    phase = part.shooting
    shapes = {c.name: c.shape for c in phase.dynamics.controls}
    for name, columns in phase.local.controls.slices.items():
        if name in shapes and columns != phase.paced:
            names = entry_names(derivatives.get(name, name), shapes[name])
            yield from zip(names, range(phase.n + columns.start, phase.n + columns.stop))


class _Moves:
    """All unknowns as linear functions of the free ones, in units; and the second derivative of the Lagrangian.

    Args:
        controls: sizes of the controls.

    Attributes:
        places: for each stage, the indices of its columns among the free unknowns; -1 for columns that are not free.
        hessian: (count, count) with respect to the free unknowns.
    """

    def __init__(self, staged: Staged, warm: WarmStart, controls: Array) -> None:
        stages, free = staged.transcription.stages, staged.transcribed.free
        sizes = staged.step(np.asarray(warm.scales.d), controls, np.asarray(warm.scales.border))
        chosen = staged.step(*(np.asarray(a, float) for a in free)) != 0.0
        at = Evaluated(staged.transcription, staged.flat(warm.point))
        at.jacobians()
        y, ye, _, _ = staged.split_rows(np.asarray(warm.rows))
        hessian = at.hessian(1.0, staged.unpadded(warm.dynamics), y, ye)
        blocks, slopes = at.blocks(hessian, stages.columns), at.blocks(at.F, stages.after)
        self._staged, self._at = staged, at
        split = stages.variables - stages.parameters
        self._columns = [
            np.r_[a : a + n - stages.parameters, split : len(sizes)] for a, n in zip(staged.first, stages.columns)
        ]
        decides = np.zeros(len(sizes), bool)
        for columns, n in zip(self._columns, stages.states):
            decides[columns[n:]] = chosen[columns[n:]]
        first = self._columns[0][: stages.states[0]]
        decides[first] = chosen[first]
        numbers = np.where(decides, np.cumsum(decides) - 1, -1)
        self.count = int(decides.sum())
        self.places = [numbers[columns] for columns in self._columns]
        #: For each stage (columns, count), in units.
        self.maps: list[Array] = []
        self.hessian = np.zeros((self.count, self.count))
        if self.count > _MOST:
            return
        after = np.zeros((0, self.count))
        for k, (places, columns) in enumerate(zip(self.places, self._columns)):
            move = np.zeros((len(columns), self.count))
            move[np.flatnonzero(places >= 0), places[places >= 0]] = 1.0
            if k:
                move[: len(after)] = after
            size = sizes[columns]
            self.maps.append(move)
            self.hessian += move.T @ (size[:, None] * blocks[k] * size) @ move
            next_sizes = sizes[self._columns[k + 1][: stages.after[k]]] if k + 1 < len(self._columns) else np.zeros(0)
            after = (slopes[k] * size / next_sizes[:, None]) @ move
        self._sizes = sizes

    def directions(self, warm: WarmStart) -> Array:
        """(count, directions) an orthonormal basis of the null space of the equalities and active inequalities."""
        staged, at, stages = self._staged, self._at, self._at.stages
        scaled = np.asarray(warm.rows) * np.asarray(warm.scales.rows) / float(warm.scales.cost)
        y, _, low, high = (np.abs(a) > _LITTLE for a in staged.split_rows(scaled))
        rows = [np.zeros((0, self.count))]
        kinds = ((at.Jh, stages.inequalities, y), (at.Je, stages.equalities, np.ones(sum(stages.equalities), bool)))
        for flat, counts, holds in kinds:
            every = zip(at.blocks(flat, counts), np.split(holds, np.cumsum(counts)[:-1]), self.maps, self._columns)
            rows += [(slopes[active] * self._sizes[columns]) @ move for slopes, active, move, columns in every]
        for move, columns in zip(self.maps, self._columns):
            rows.append(move[(low | high)[columns]])
        fixed = np.concatenate(rows)
        lengths = np.linalg.norm(fixed, axis=1)
        fixed = fixed[lengths > 0.0] / lengths[lengths > 0.0][:, None]
        _, values, directions = np.linalg.svd(np.linalg.qr(fixed, mode="r"))
        rank = int((values > _ROUNDING * values.max(initial=1.0)).sum())
        return directions[rank:].T
