"""A solve whose memory is allocated once and that is called often: a call writes numbers in place and calls C."""

from __future__ import annotations

import ctypes
import time
from typing import Any

import numpy as np
from numpy import ndarray as Array

from .core import (
    COUNTS,
    MEASURES,
    MULTIPLIERS,
    CoreStatus,
    ProblemStructure,
    SolutionStructure,
    StatisticsStructure,
    Units,
    as_problem,
)
from .library import library
from .options import Options
from .transcription import Transcription

#: Statuses after which the iterate means nothing.
LOST = {CoreStatus.NON_FINITE, CoreStatus.UNBOUNDED_CURVATURE, CoreStatus.UNBOUNDED}


class PreparedSolve:
    """Warm-started solves of a transcribed problem, each from the final point of the previous one.

    Attributes:
        z, v, s, lam, y, ye, zl, zu: the iterate, as `core.CoreSolution` has it; callers write in place.
        lower, upper: bounds of v; callers write in place.
        options: the structure of the core's options; numbers may change between calls.
    """

    def __init__(
        self,
        transcription: Transcription,
        units: Units,
        largest_step: Array,
        bounds: tuple[Array, Array],
        options: Options,
    ) -> None:
        stages = transcription.stages
        defects, rows, equalities = stages.row_counts
        sizes = {"z": stages.points, "v": stages.variables, "s": rows, "lam": defects, "y": rows, "ye": equalities}
        sizes |= {"zl": stages.variables, "zu": stages.variables}
        self._memory = np.zeros(sum(sizes.values()))
        parts = np.split(self._memory, np.cumsum(list(sizes.values()))[:-1])
        self.z, self.v, self.s, self.lam, self.y, self.ye, self.zl, self.zu = parts
        self.lower, self.upper = (np.array(a, float) for a in bounds)
        size, row_size, equality_size = (None if a is None else np.array(a, float) for a in units[:3])
        self._units = units = Units(size, row_size, equality_size, units.cost)
        self._described = as_problem(stages, transcription.functions, self.lower, self.upper, units, largest_step)
        self._transcription, problem = transcription, self._described.structure
        problem.discards = True
        self.options = options.as_structure()
        self._statistics = StatisticsStructure()
        self._deadline = 0.0

        def stop(user: Any, iteration: int, z: Any) -> int:
            return int(time.perf_counter() >= self._deadline)

        self._stop = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int32, ctypes.c_void_p)(stop)
        self._stop_address = ctypes.cast(self._stop, ctypes.c_void_p).value
        core = library()
        self._workspace = np.empty(core.workspace_size(ctypes.byref(problem), self._memory.itemsize))
        places = dict(zip(sizes, parts, strict=True))
        self._solution = SolutionStructure(*(places[name].ctypes.data for name in MULTIPLIERS))
        self._call = core.solve
        self._pointers = (
            ctypes.byref(problem),
            ctypes.byref(self.options),
            self.z.ctypes.data,
            ctypes.byref(self._solution),
            self._workspace.ctypes.data,
            ctypes.byref(self._statistics),
        )

    def __call__(self, seconds: float | None = None) -> CoreStatus:
        """Solve from the iterate; the iterate is the result, or what it was where that has no meaning.

        Args:
            seconds: after which it ends with STOPPED, at the iterate with the smallest error so far.
        Raises:
            Exception: what a function that JAX runs raised.
        """
        problem = self._described.structure
        if seconds is None:
            problem.stop = None
        else:
            problem.stop, self._deadline = self._stop_address, time.perf_counter() + seconds
        status = CoreStatus(self._call(*self._pointers))
        self._transcription.check()
        return status

    def set_units(self, units: Units) -> None:
        """Solve in other units from now on; the iterate is in those of the problem."""
        for memory, values in zip(self._units[:3], units[:3]):
            if memory is not None and values is not None:
                np.copyto(memory, values)
        self._described.structure.cost_size = units.cost

    def saved(self) -> tuple[Array, Array, Array]:
        """Copies of the iterate and of both bounds."""
        return self._memory.copy(), self.lower.copy(), self.upper.copy()

    def load(self, saved: tuple[Array, Array, Array]) -> None:
        """Go back to what was saved."""
        self._memory[:], self.lower[:], self.upper[:] = saved

    def workspace_numbers(self, bytes_each: int, **layout: int) -> int:
        """Numbers of the core's workspace, each of so many bytes, where numbers of `twx_problem` that lay it out are
        these.
        """
        problem = ProblemStructure.from_buffer_copy(self._described.structure)
        for name, value in layout.items():
            setattr(problem, name, value)
        return int(library().workspace_size(ctypes.byref(problem), bytes_each))

    def measure(self, name: str) -> float:
        """A number of the last solve, as `CoreSolution.statistics` names it."""
        return float(getattr(self._statistics, name))

    @property
    def measures(self) -> dict[str, float]:
        """All numbers of the last solve."""
        return {name: self.measure(name) for name in (*MEASURES, *COUNTS[1:])}
