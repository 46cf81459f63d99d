"""Values and derivatives of a staged problem at a point, as NumPy arrays."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..solver.transcription import Transcription

_POINTER = ctypes.c_void_p


class Evaluated:
    """Values and derivatives of a problem in stages at a point, by its functions."""

    def __init__(self, transcription: Transcription, z: Array) -> None:
        stages, functions = transcription.stages, transcription.functions
        self.stages = stages
        self.cost, self.c = np.zeros(1), np.zeros(sum(stages.after))
        self.h, self.e = np.zeros(sum(stages.inequalities)), np.zeros(sum(stages.equalities))
        self._z, self._functions = np.ascontiguousarray(z), functions
        self.failed = self._call("values", self.cost, self.c, self.h, self.e)
        transcription.check()

    @functools.cached_property
    def gradient(self) -> Array:
        """Of the cost, by v."""
        return np.zeros(self.stages.variables)

    @functools.cached_property
    def F(self) -> Array:
        """Matrices of the defects, one stage after the other, as those of the rows and of second derivatives are."""
        return self._blocks(self.stages.after)

    @functools.cached_property
    def Jh(self) -> Array:
        return self._blocks(self.stages.inequalities)

    @functools.cached_property
    def Je(self) -> Array:
        return self._blocks(self.stages.equalities)

    @functools.cached_property
    def H(self) -> Array:
        """Of the cost."""
        return self._blocks(self.stages.columns)

    def _blocks(self, rows: Sequence[int]) -> Array:
        return np.zeros(self.stages.block_sizes(rows))

    def _call(self, name: str, *arrays: Any) -> int:
        kinds = [ctypes.c_double if isinstance(a, float) else _POINTER for a in arrays]
        function = ctypes.CFUNCTYPE(ctypes.c_int32, _POINTER, _POINTER, *kinds)(getattr(self._functions, name))
        pointers = [a if isinstance(a, float) else a.ctypes.data for a in arrays]
        return int(function(self._functions.user, self._z.ctypes.data, *pointers))

    def differentiate(self) -> bool:
        """First derivatives, and the second ones of the cost; whether there are such."""
        stages = self.stages
        self.gradient = np.zeros(stages.variables)
        counts = (stages.after, stages.inequalities, stages.equalities)
        self.F, self.Jh, self.Je = (np.zeros(stages.block_sizes(rows)) for rows in counts)
        self.H = np.zeros(stages.block_sizes(stages.columns))
        zeros = [np.zeros_like(a) for a in (self.c, self.h, self.e)]
        return self.jacobians() and not self._call("hessians", 1.0, *zeros, self.H)

    def jacobians(self) -> bool:
        """First derivatives; whether there are such."""
        return not (self.failed or self._call("jacobians", self.gradient, self.F, self.Jh, self.Je))

    def bends(self, y: Array, ye: Array) -> Array:
        """Second derivatives of y . h + ye . e."""
        return self.hessian(0.0, np.zeros_like(self.c), y, ye)

    def hessian(self, weight: float, lam: Array, y: Array, ye: Array) -> Array:
        """Second derivatives of weight cost + lam . c + y . h + ye . e; NaN where there are none."""
        H, others = self._blocks(self.stages.columns), [np.ascontiguousarray(a) for a in (lam, y, ye)]
        failed = self.failed or self._call("hessians", weight, *others, H)
        return np.full_like(H, np.nan) if failed else H

    def blocks(self, flat: Array, rows: Any) -> list[Array]:
        """The matrices (rows, columns) of all stages."""
        sizes = [r * n for r, n in zip(rows, self.stages.columns)]
        parts = np.split(flat, np.cumsum(sizes)[:-1])
        return [a.reshape(n, r).T for a, r, n in zip(parts, rows, self.stages.columns)]


def moved(transcription: Transcription, z: Array, step: Array) -> Array:
    """z after a step of v."""
    found, functions = np.array(z), transcription.functions
    move = ctypes.CFUNCTYPE(ctypes.c_int32, *[_POINTER] * 4)(functions.retract)
    z, step = (np.ascontiguousarray(a, float) for a in (z, step))
    move(functions.user, z.ctypes.data, step.ctypes.data, found.ctypes.data)
    return found
