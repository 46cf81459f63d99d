"""Batches of problems of one form: solves, and derivatives of solutions, as NumPy calls or in XLA programs."""

from __future__ import annotations

import atexit
import ctypes
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..errors import TrajectoryError
from .core import CoreStatus, ProblemStructure, Units, as_problem
from .library import library
from .options import Options
from .processors import processors
from .stages import Stages
from .structures import TranscriptionStructure
from .transcription import Transcription

#: What a result has after its arrays, in the order of members.h.
MEASURES = (
    *("cost", "error", "violation", "stationarity", "complementarity", "minimum", "excess", "worth"),
    *("status", "iterations"),
)

#: Words of the calls that run at once: TWX_JOBS TWX_JOB_WORDS of members.h.
_JOBS = 16 * 16

#: Forms that programs of XLA call. A program may outlive everything else.
_CALLED: list[Any] = []


@atexit.register
def _end_programs() -> None:
    """Stop programs that still run at exit, for batches whose results nobody reads."""
    for form in _CALLED:
        form.structure.stop = 1


#: Functions of Python that the core calls, by the names of members.h.
_PYTHON = {
    "lock": "PyGILState_Ensure",
    "unlock": "PyGILState_Release",
    "signals": "PyErr_CheckSignals",
    "clear": "PyErr_Clear",
    "interrupt": "PyErr_SetInterrupt",
}


class _Structure(ctypes.Structure):
    """`twx_form`."""

    _fields_ = [
        ("problem", ProblemStructure),
        ("options", type(Options().as_structure())),
        ("transcription", TranscriptionStructure),
        ("data", ctypes.c_int64),
        ("transposed", ctypes.c_int32),
        ("stop", ctypes.c_int64),
        ("second", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in _PYTHON),
        ("jobs", ctypes.c_void_p),
    ]


class _Form:
    """The data that all members share.

    Args:
        transcription: functions and sizes.
        data: how many numbers of a row kernels read; 0 where all members have those of the transcription.
    """

    def __init__(
        self,
        transcription: Transcription,
        units: Units,
        options: Options,
        bounds: tuple[Array, Array],
        largest_step: Array | None = None,
        data: int = 0,
    ) -> None:
        self.stages: Stages = transcription.stages
        problem = as_problem(transcription.stages, transcription.functions, *bounds, units, largest_step)
        self._jobs = np.zeros(_JOBS, np.int64)
        self._memory = (problem, transcription)
        self.structure = _Structure(problem.structure, options.as_structure(), transcription.structure, data)
        self.structure.jobs = self._jobs.ctypes.data
        for name, function in _PYTHON.items():
            setattr(self.structure, name, ctypes.cast(getattr(ctypes.pythonapi, function), ctypes.c_void_p).value)
        self._called_back = transcription.called_back
        self.transcription = transcription
        self._doubles = int(library().form_memory(ctypes.addressof(self.structure)))

    def _call(self, target: str, results: tuple[int, ...], *arguments: Any) -> Any:
        if self not in _CALLED:
            _CALLED.append(self)
            # A thread of XLA may be in the middle of a call when Python clears its modules.
            for kept in (self, library()):
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))
        threads = max(1, min(processors(), len(arguments[0])))
        shapes = [jax.ShapeDtypeStruct(shape, np.dtype(float)) for shape in (results, (threads, self._doubles))]
        handle = np.int64(ctypes.addressof(self.structure))
        return jax.ffi.ffi_call(target, shapes)(*arguments, handle=handle)[0]


class Solves(_Form):
    """Solves of problems that differ in numeric arguments of kernels, starts and bounds.

    A row has the numbers of kernels, z, v, and both bounds of v. A result has the arrays of `core.Solution` in its
    order, then `MEASURES`.
    """

    def __init__(
        self, transcription: Transcription, units: Units, options: Options, largest_step: Array, data: int
    ) -> None:
        none = np.zeros(transcription.stages.variables)
        super().__init__(transcription, units, options, (none, none), largest_step, data)
        stages, defects = self.stages, sum(self.stages.after)
        h, e, v = sum(stages.inequalities), sum(stages.equalities), stages.variables
        #: Entries of the arrays of a result, by name.
        self.sizes = {"z": stages.points, "v": v, "s": h, "lam": defects, "y": h, "ye": e, "zl": v, "zu": v}
        self.sizes |= dict.fromkeys(MEASURES, 1)

    def now(self, row: Array) -> Array:
        """The result of one row; functions that JAX runs are called back."""
        result, memory = np.zeros(sum(self.sizes.values())), np.empty(self._doubles)
        address = ctypes.addressof(self.structure)
        library().solve_members(address, 1, row.ctypes.data, result.ctypes.data, memory.ctypes.data)
        self.transcription.check()
        return result

    def __call__(self, rows: Any) -> Any:
        """The results of rows (..., entries), traceable; no derivatives."""

        @jax.custom_batching.custom_vmap
        def solved(rows: Any) -> Any:
            *batch, size = rows.shape
            entries = sum(self.sizes.values())
            with jax.enable_x64(True):
                flat = jnp.reshape(rows, (math.prod(batch), size))
                return self._call(library().targets[0], (len(flat), entries), flat).reshape(*batch, entries)

        @solved.def_vmap
        def batched(size: int, mapped: list[bool], rows: Any) -> tuple[Any, bool]:
            return solved(rows), True

        return solved(rows)

    def split(self, results: Any) -> dict[str, Any]:
        """The arrays of results, and their measures."""
        parts = jnp.split(results, np.cumsum(list(self.sizes.values()))[:-1], axis=-1)
        return {name: part[..., 0] if name in MEASURES else part for name, part in zip(self.sizes, parts)}


class Moves(_Form):
    """Changes of solutions for right-hand sides of their first-order conditions, see linearised.c.

    A side, and a move, has v, lam, y, ye and the cost. Entries of v that are fixed move by what a side has for
    them; the others, and the multipliers, so that the conditions leave what the side has.

    Args:
        fixed: which entries of v are fixed.
        transposed: whether the equations are transposed.

    A row has z, lam, y, ye, weights of bounds and of rows, and whether the solution is one: 1, or 0.
    """

    def __init__(
        self, transcription: Transcription, units: Units, options: Options, fixed: Array, transposed: bool
    ) -> None:
        super().__init__(transcription, units, options, (np.where(fixed, 0.0, -1.0), np.where(fixed, 0.0, 1.0)))
        self.structure.transposed = int(transposed)

    def now(self, row: Array, sides: Array) -> Array:
        """The moves of one row for sides (count, entries).

        Raises:
            TrajectoryError: the solution is no strict minimum, or has no finite derivatives.
        """
        solutions, memory = np.array(sides, float), np.empty(self._doubles)
        address = ctypes.addressof(self.structure)
        pointers = row.ctypes.data, solutions.ctypes.data, memory.ctypes.data
        status = CoreStatus(library().linearised_members(address, 1, len(solutions), *pointers))
        self.transcription.check()
        if status is not CoreStatus.SOLVED:
            words = {
                CoreStatus.UNBOUNDED_CURVATURE: "no strict minimum",
                CoreStatus.NON_FINITE: "without finite derivatives",
            }
            raise TrajectoryError(f"the solution is {words.get(status, status.name)}")
        return solutions

    def __call__(self, rows: Any, side: Any) -> Any:
        """The moves for rows (..., entries) and one side each, traceable; one factor serves all sides of a row."""

        @jax.custom_batching.custom_vmap
        def moved(rows: Any, sides: Any) -> Any:  # (..., entries), (..., each, entries)
            *batch, size = rows.shape
            count = math.prod(batch)
            with jax.enable_x64(True):
                flat = jnp.reshape(rows, (count, size)), jnp.reshape(sides, (count, *sides.shape[-2:]))
                return self._call(library().targets[1], flat[1].shape, *flat).reshape(sides.shape)

        @moved.def_vmap
        def batched(size: int, mapped: list[bool], rows: Any, sides: Any) -> tuple[Any, bool]:
            if not mapped[0]:  # more sides of the same solutions
                sides = jnp.moveaxis(sides, 0, -3)
                solutions = moved(rows, sides.reshape(*sides.shape[:-3], -1, sides.shape[-1]))
                return jnp.moveaxis(solutions.reshape(sides.shape), -3, 0), True
            return moved(rows, sides if mapped[1] else jnp.broadcast_to(sides, (size, *sides.shape))), True

        return moved(rows, side[..., None, :])[..., 0, :]
