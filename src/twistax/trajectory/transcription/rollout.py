"""Rollouts of held controls by the solver's core: interval after interval, each from where the last one ended."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...solver.kernels import Argument
from ...solver.transcription import NONE, Transcription
from .evaluation import Evaluated
from .methods import Collocation, MultipleShooting
from .points import Point
from .staged_phase import StagedPhase


class Rollout:
    """Rolls the controls of a phase out.

    Args:
        part: the phase.
        transcription: what integrates an interval; its substeps are the samples.
        parameters: entries of the border.
        data: the numbers of a solve.
    """

    def __init__(
        self, part: StagedPhase, transcription: MultipleShooting | Collocation, parameters: int, data: Array
    ) -> None:
        self._part, self._samples, self._data = part, int(transcription.substeps), data
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
        self._transcription = Transcription([alone], parameters, data)

    def states(self, point: Point) -> dict[str, Array]:
        """All states where samples lie, (intervals * samples + 1, ...), from the first node of a point of the phase."""
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
            end: a node near the end, about which no logarithm jumps.
        """
        shooting = self._part.shooting
        self._start[0], self._width[0] = shooting.mesh.shares[number], shooting.mesh.widths[number]
        self._transcription.set_data(self._data)  # what was integrated is for another interval
        Evaluated(self._transcription, np.concatenate([base, u[: shooting.m], end, border]))
        eta = np.stack([self._transcription.states(0, k)[0] for k in range(1, self._samples + 1)])
        retract = self._part.phase.kernels.retract
        if retract is None:
            return base + eta
        return retract(len(eta), len(base), {Argument.Z: eta, Argument.BASE: base[None]})
