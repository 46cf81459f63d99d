"""Values and derivatives of a staged (multi-stage) problem at a point, as NumPy arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...solver.transcription import Transcription


class Evaluated:
    """Values and derivatives of a staged problem at a point, from its compiled functions.

    Attributes:
        cost, c, h, e: (1,) the cost; defects, inequalities and equalities of all stages.
        failed: whether the values are not finite.
        gradient: derivative of the cost with respect to v; like the following attributes, set once derivatives are
            evaluated.
        F, Jh, Je: entries of the Jacobians of defects, inequalities and equalities, stage by stage; see `blocks`.
        H: second derivatives of the cost, in the same layout.
    """

    def __init__(self, transcription: Transcription, z: Array) -> None:
        self.stages = stages = transcription.stages
        self.cost = np.zeros(1)
        self.c, self.h, self.e = map(np.zeros, stages.row_counts)
        self._z, self._transcription = np.ascontiguousarray(z), transcription
        self.failed = self._call("values", self.cost, self.c, self.h, self.e)
        transcription.check()

    def _call(self, name: str, *arrays: Any) -> bool:
        return self._transcription.call(name, self._z, *arrays)

    def jacobians(self) -> bool:
        """Compute first derivatives; False if they are not finite."""
        self.gradient = np.zeros(self.stages.variables)
        self.F, self.Jh, self.Je = map(np.zeros, self.stages.slope_sizes)
        return not (self.failed or self._call("jacobians", self.gradient, self.F, self.Jh, self.Je))

    def differentiate(self) -> bool:
        """Compute first derivatives, and second derivatives of the cost; False if they are not finite."""
        good = self.jacobians()
        self.H = np.zeros(self.stages.hessian_size)
        zeros = [np.zeros_like(a) for a in (self.c, self.h, self.e)]
        return good and not self._call("hessians", 1.0, *zeros, self.H)

    def bends(self, y: Array, ye: Array) -> Array:
        """Second derivatives of y . h + ye . e."""
        return self.hessian(0.0, np.zeros_like(self.c), y, ye)

    def hessian(self, weight: float, lam: Array, y: Array, ye: Array) -> Array:
        """Second derivatives of weight cost + lam . c + y . h + ye . e; NaN where there are none."""
        H = np.zeros(self.stages.hessian_size)
        failed = self.failed or self._call("hessians", weight, *map(np.ascontiguousarray, (lam, y, ye)), H)
        return np.full_like(H, np.nan) if failed else H

    def blocks(self, flat: Array, rows: Sequence[int]) -> list[Array]:
        """The matrices (rows, columns) of all stages, from entries in this layout."""
        return [block for _, blocks in self.batches(flat, rows) for block in blocks]

    def batches(self, flat: Array, rows: Sequence[int]) -> Iterator[tuple[slice, Array]]:
        """The matrices of all stages with the same sizes, as arrays (stages, rows, columns)."""
        end = 0
        for run in self.stages.runs:
            shape = (run.stop - run.start, self.stages.columns[run.start], rows[run.start])
            begin, end = end, end + math.prod(shape)
            yield run, flat[begin:end].reshape(shape).swapaxes(1, 2)

    def changes(self, flat: Array, rows: Sequence[int], of_stages: Sequence[Array]) -> Array:
        """A first-order bound |J| v of the change of each row for a step whose entries are at most v.

        Args:
            of_stages: `by_run(v)`.
        """
        every = zip(self.batches(flat, rows), of_stages)
        return np.concatenate([(np.abs(J) @ v[..., None]).ravel() for (_, J), v in every])

    def curvatures(self, H: Array, of_stages: Sequence[Array]) -> Array:
        """(stages,) v' |H| v, with the entries of v that belong to each stage; `of_stages` is the result of
        `by_run(v)`.
        """
        every = zip(self.batches(H, self.stages.columns), of_stages)
        return np.concatenate([((np.abs(block) @ v[..., None])[..., 0] * v).sum(axis=1) for (_, block), v in every])

    def by_run(self, v: Array) -> list[Array]:
        """(stages, columns) of v for each run of equally large stages; shared parameters are repeated in each stage."""
        stages, result = self.stages, []
        split = stages.variables - stages.parameters
        for run in stages.runs:
            count, width = run.stop - run.start, stages.columns[run.start]
            entries = np.empty((count, width))
            first, inner = stages.first[run.start], width - stages.parameters
            entries[:, :inner] = v[first : first + count * inner].reshape(count, inner)
            entries[:, inner:] = v[split:]
            result.append(entries)
        return result


def moved(transcription: Transcription, z: Array, step: Array) -> Array:
    """The point z after a step v."""
    result = np.array(z)
    transcription.call("retract", *(np.ascontiguousarray(a, float) for a in (z, step)), result)
    return result
