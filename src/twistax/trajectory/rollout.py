"""Rollouts of held controls by the solver's core: interval after interval, each from where the last one ended."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..solver.kernels import Argument
from ..solver.transcription import NONE, Transcription
from .evaluated import Evaluated
from .staged import Part, method_of
from .transcribed import Point
from .transcription import Collocation, MultipleShooting


class Rollout:
    """Rolls the controls of a phase out.

    Args:
        part: the phase.
        transcription: what integrates an interval; its substeps are the samples.
        parameters: entries of the border.
        data: the numbers of a solve.
    """

    def __init__(self, part: Part, transcription: MultipleShooting | Collocation, parameters: int, data: Array) -> None:
        self._part, self._samples, self._data = part, int(transcription.substeps), data
        self._start, self._width = np.zeros(1), np.ones(1)
        phase, (_, end) = part.phase, part.phase.kernels.nodes[-1]
        shape = (1, self._samples + 1, phase.path.shape[2])
        rows = len(phase.conditions[-1])
        alone = dataclasses.replace(
            phase,
            method=method_of(transcription),
            kernels=dataclasses.replace(phase.kernels, nodes=[(1, end)]),
            starts=self._start,
            widths=self._width,
            path=np.full(shape, NONE),
            conditions=[np.full(rows, NONE)],
            path_margins=np.zeros(shape),
            margins=[np.zeros(rows)],
            join=None,
        )
        self._transcription = Transcription([alone], parameters, data)

    def states(self, point: Point) -> dict[str, Array]:
        """All states where samples lie, (intervals * samples + 1, ...), from the first node of a point of the phase."""
        shooting = self._part.shooting
        base, *planned = self._part.point.joined(point.xs, 1)
        found, border = [base[None]], np.ravel(point.border)
        for u, end, start, width in zip(np.asarray(point.us), planned, shooting.mesh.shares, shooting.mesh.widths):
            self._start[0], self._width[0] = start, width
            self._transcription.set_data(self._data)  # what was integrated is for another interval
            Evaluated(self._transcription, np.concatenate([base, u[: shooting.m], end, border]))
            along = (self._transcription.states(0, sample)[0] for sample in range(1, self._samples + 1))
            found.append(self._moved(base, np.stack(list(along))))
            base = found[-1][-1]
        xs: dict[str, Any] = self._part.point.split(np.concatenate(found))
        return xs

    def _moved(self, base: Array, eta: Array) -> Array:
        """base exp(eta), a row for each."""
        retract = self._part.phase.kernels.retract
        if retract is None:
            return base + eta
        return retract(len(eta), len(base), {Argument.Z: eta, Argument.BASE: base[None]})
