"""Values and derivatives of a staged problem at a point, as NumPy arrays."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...solver.transcription import Transcription

_POINTER = ctypes.c_void_p
_SIGNATURES = {
    "values": ctypes.CFUNCTYPE(ctypes.c_int32, *[_POINTER] * 6),
    "jacobians": ctypes.CFUNCTYPE(ctypes.c_int32, *[_POINTER] * 6),
    "hessians": ctypes.CFUNCTYPE(ctypes.c_int32, _POINTER, _POINTER, ctypes.c_double, *[_POINTER] * 4),
}


class Evaluated:
    """Values and derivatives of a problem in stages at a point, by its functions.

    Attributes:
        cost, c, h, e: (1,) the cost; defects, inequalities and equalities of all stages.
        failed: whether there are no values.
        gradient: of the cost by v, once derivatives are evaluated, as the others.
        F, Jh, Je: matrices of defects and rows, one stage after the other; see `blocks`.
        H: second derivatives of the cost, likewise.
    """

    def __init__(self, transcription: Transcription, z: Array) -> None:
        self.stages = stages = transcription.stages
        self.cost = np.zeros(1)
        self.c, self.h, self.e = map(np.zeros, stages.row_counts)
        self._z, self._functions = np.ascontiguousarray(z), transcription.functions
        self.failed = self._call("values", self.cost, self.c, self.h, self.e)
        transcription.check()

    def _call(self, name: str, *arrays: Any) -> bool:
        function = _SIGNATURES[name](getattr(self._functions, name))
        pointers = [a if isinstance(a, float) else a.ctypes.data for a in arrays]
        return bool(function(self._functions.user, self._z.ctypes.data, *pointers))

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
        """The matrices (rows, columns) of all stages."""
        return [block for _, blocks in self.batches(flat, rows) for block in blocks]

    def batches(self, flat: Array, rows: Sequence[int]) -> Iterator[tuple[slice, Array]]:
        """The matrices of stages with the same counts, (stages, rows, columns)."""
        end = 0
        for run in self.stages.runs:
            shape = (run.stop - run.start, self.stages.columns[run.start], rows[run.start])
            begin, end = end, end + math.prod(shape)
            yield run, flat[begin:end].reshape(shape).swapaxes(1, 2)

    def changes(self, flat: Array, rows: Sequence[int], v: Array) -> Array:
        """By how much a step whose entries are as large as v changes each row at most, to first order: |J| v."""
        changes = [(np.abs(J) @ self._of_stages(v, run)[..., None]).ravel() for run, J in self.batches(flat, rows)]
        return np.concatenate(changes)

    def curvatures(self, H: Array, v: Array) -> Array:
        """(stages,) v' |H| v, with the entries of v that belong to each stage."""
        return np.concatenate(
            [
                ((np.abs(block) @ self._of_stages(v, run)[..., None])[..., 0] * self._of_stages(v, run)).sum(axis=1)
                for run, block in self.batches(H, self.stages.columns)
            ]
        )

    def _of_stages(self, v: Array, run: slice) -> Array:
        """(stages, columns) of v, those of the parameters in each."""
        first, split = self.stages.first[run.start], self.stages.variables - self.stages.parameters
        count, width = run.stop - run.start, self.stages.columns[run.start] - self.stages.parameters
        inner = v[first : first + count * width].reshape(count, width)
        return np.concatenate([inner, np.broadcast_to(v[split:], (count, len(v) - split))], axis=1)


def moved(transcription: Transcription, z: Array, step: Array) -> Array:
    """z after a step of v."""
    result, functions = np.array(z), transcription.functions
    retract = ctypes.CFUNCTYPE(ctypes.c_int32, *[_POINTER] * 4)(functions.retract)
    z, step = (np.ascontiguousarray(a, float) for a in (z, step))
    retract(functions.user, z.ctypes.data, step.ctypes.data, result.ctypes.data)
    return result
