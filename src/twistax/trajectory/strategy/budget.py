"""The limits of a solve: iterations, seconds, and a callback that may end it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy import ndarray as Array

from .status import Status


class Budget:
    """The limits that all runs of one solve share.

    Args:
        max_iterations: the limit for all runs together.
        max_seconds: wall time from now; None means no limit.
        callback: called before each iteration with its number, the cost, the violation, and the largest relative change
            of an unknown since the last iteration; it ends the solve by returning True.

    Attributes:
        used: the number of iterations of the completed runs.
        ended: the reason to end the solve early; None while there is none.
    """

    def __init__(
        self, max_iterations: int, max_seconds: float | None = None, callback: Callable[..., Any] | None = None
    ) -> None:
        self._most, self._callback = max_iterations, callback
        self._due = np.inf if max_seconds is None else time.monotonic() + max_seconds
        self.used = 0
        self._last: Any = None
        self.ended: Status | None = None

    @property
    def left(self) -> int:
        """The remaining iterations."""
        return max(self._most - self.used, 0)

    @property
    def seconds_left(self) -> float | None:
        """The remaining wall time, at least a minimum; None without a limit."""
        return None if np.isinf(self._due) else max(self._due - time.monotonic(), 1e-6)

    @property
    def is_spent(self) -> bool:
        """Whether no further run may start."""
        return self.left == 0 or self.ended is not None

    def ends(self, iteration: int, cost: float, violation: float, z: Array | None = None) -> bool:
        """Whether a run must stop before this iteration, with the unknowns z."""
        stop = None
        if self._callback is not None:
            size = None
            if z is not None and iteration > 0 and np.shape(self._last) == z.shape:
                size = float(np.abs((z - self._last) / (1.0 + np.abs(z))).max(initial=0.0))
            self._last = None if z is None else z.copy()
            stop = self._callback(self.used + iteration, cost, violation, size)
        if isinstance(stop, (bool, np.bool_)) and stop:
            self.ended = Status.STOPPED
        if time.monotonic() > self._due:
            self.ended = Status.OUT_OF_TIME
        return self.ended is not None
