"""Values and derivatives of a staged problem at a point, as NumPy arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...solver.transcription import Transcription

_POINTER = ctypes.c_void_p


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
        self.cost, self.c = np.zeros(1), np.zeros(sum(stages.after))
        self.h, self.e = np.zeros(sum(stages.inequalities)), np.zeros(sum(stages.equalities))
        self._z, self._functions = np.ascontiguousarray(z), transcription.functions
        self.failed = self._call("values", self.cost, self.c, self.h, self.e)
        transcription.check()

    def _call(self, name: str, *arrays: Any) -> bool:
        kinds = [ctypes.c_double if isinstance(a, float) else _POINTER for a in arrays]
        function = ctypes.CFUNCTYPE(ctypes.c_int32, _POINTER, _POINTER, *kinds)(getattr(self._functions, name))
        pointers = [a if isinstance(a, float) else a.ctypes.data for a in arrays]
        return bool(function(self._functions.user, self._z.ctypes.data, *pointers))

    def jacobians(self) -> bool:
        """Compute first derivatives; False if they are not finite."""
        stages = self.stages
        counts = (stages.after, stages.inequalities, stages.equalities)
        self.gradient = np.zeros(stages.variables)
        self.F, self.Jh, self.Je = (np.zeros(stages.block_sizes(rows)) for rows in counts)
        return not (self.failed or self._call("jacobians", self.gradient, self.F, self.Jh, self.Je))

    def differentiate(self) -> bool:
        """Compute first derivatives, and second derivatives of the cost; False if they are not finite."""
        good = self.jacobians()
        self.H = np.zeros(self.stages.block_sizes(self.stages.columns))
        zeros = [np.zeros_like(a) for a in (self.c, self.h, self.e)]
        return good and not self._call("hessians", 1.0, *zeros, self.H)

    def bends(self, y: Array, ye: Array) -> Array:
        """Second derivatives of y . h + ye . e."""
        return self.hessian(0.0, np.zeros_like(self.c), y, ye)

    def hessian(self, weight: float, lam: Array, y: Array, ye: Array) -> Array:
        """Second derivatives of weight cost + lam . c + y . h + ye . e; NaN where there are none."""
        H = np.zeros(self.stages.block_sizes(self.stages.columns))
        failed = self.failed or self._call("hessians", weight, *map(np.ascontiguousarray, (lam, y, ye)), H)
        return np.full_like(H, np.nan) if failed else H

    def blocks(self, flat: Array, rows: Sequence[int]) -> list[Array]:
        """The matrices (rows, columns) of all stages."""
        sizes = [r * n for r, n in zip(rows, self.stages.columns)]
        parts = np.split(flat, np.cumsum(sizes)[:-1])
        return [a.reshape(n, r).T for a, r, n in zip(parts, rows, self.stages.columns)]


def moved(transcription: Transcription, z: Array, step: Array) -> Array:
    """z after a step of v."""
    result, functions = np.array(z), transcription.functions
    retract = ctypes.CFUNCTYPE(ctypes.c_int32, *[_POINTER] * 4)(functions.retract)
    z, step = (np.ascontiguousarray(a, float) for a in (z, step))
    retract(functions.user, z.ctypes.data, step.ctypes.data, result.ctypes.data)
    return result
