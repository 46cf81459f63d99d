"""The memory of a controller in C: the sizes of its arrays, and how many intervals it evaluates together."""

from __future__ import annotations

from collections.abc import Sequence

from ...solver.exported.phase_code import LANES
from ...solver.prepared import PreparedSolve
from ...solver.sources import constant
from ...solver.transcription import Transcription

#: How many arrays of each size a controller has.
_ARRAYS = {"points": 1, "variables": 5, "rows": 2, "defects": 1, "equalities": 1}


class ControllerMemory:
    """The sizes of a controller's arrays in C.

    Args:
        solve, transcription: the problem.
        shared: of each phase, functions that the rate shares.
        bytes_each: of a number.
        data: the number of its data.
        limit: bytes that may be used for a faster solve.

    Attributes:
        sizes: numbers of variables and rows; arrays of C have one entry or more.
        layout: properties of the core's memory besides sizes: with few iterations it needs neither a filter nor a
            watchdog.
        windows: of each phase, the number of intervals that are evaluated together: all if the memory suffices, which
            is faster; else as many as fit into the memory of the linear system.
        counts: numbers of the other arrays.
        bytes: of all arrays.
        work: of each phase, what it keeps between calls of its functions.
        scratch: for derivatives, which all phases use in turn.
    """

    def __init__(
        self,
        solve: PreparedSolve,
        transcription: Transcription,
        shared: Sequence[int],
        bytes_each: int,
        data: int,
        limit: int,
    ) -> None:
        self._solve, self._transcription, self._data = solve, transcription, data
        self._shared, self._bytes_each = shared, bytes_each
        sizes = {"points": solve.z, "variables": solve.v, "rows": solve.s, "defects": solve.lam, "equalities": solve.ye}
        self.sizes = {name: max(1, len(values)) for name, values in sizes.items()}
        options = solve.options
        rows, trigger = int(options.iterations) + 1, options.watchdog_trigger
        self.layout = {
            "filter_rows": min(rows, constant("work.h", "TWX_FILTER_ROWS")),
            "without_watchdog": int(not 0 < trigger < options.iterations),
        }
        intervals = [int(phase.intervals) for phase in transcription.phases]
        self._set_windows(intervals)
        if self.bytes > limit:
            self._set_windows(self._fitting(intervals))

    def _set_windows(self, windows: Sequence[int]) -> None:
        sizes = [self._phase(k, window) for k, window in enumerate(windows)]
        self.windows, self.work, self.scratch = windows, [work for work, _ in sizes], max(size for _, size in sizes)
        self.counts = {
            "data": max(1, self._data),
            "slopes": max(1, sum(slopes.size for slopes in self._transcription.cost_slopes)),
            "phase_work": sum(self.work),
            "workspace": max(self._workspace(self.scratch), sum(self.sizes.values())),
        }
        of_sizes = sum(_ARRAYS[name] * count for name, count in self.sizes.items())
        self.bytes = self._bytes_each * (of_sizes + sum(self.counts.values()))

    def _phase(self, number: int, window: int) -> tuple[int, int]:
        return self._transcription.phase_numbers(number, window, self._shared[number])

    def _fitting(self, intervals: Sequence[int]) -> list[int]:
        """Windows whose derivatives are computed in the memory of the linear system."""
        windows, least = [LANES] * len(intervals), self._workspace(0)
        for k, count in enumerate(intervals):
            while windows[k] < count:
                if self._workspace(self._phase(k, windows[k] + LANES)[1]) > least:
                    break
                windows[k] += LANES
        return windows

    def _workspace(self, scratch: int) -> int:
        return self._solve.workspace_numbers(self._bytes_each, **self.layout, scratch=scratch)
