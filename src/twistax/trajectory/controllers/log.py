"""A log of a controller's calls."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...errors import TrajectoryError
from ...plots import Panel, draw
from ..strategy.status import Status


@dataclasses.dataclass(frozen=True)
class StepRecord:
    """One call of `Controller.feedback`.

    Attributes:
        status: status of the solve. SOLVED: the first-order conditions hold within the tolerance, on the mesh.
        iterations: iterations of the solver.
        seconds: wall time of the call, s.
        cost: the objective of the plan.
        violation: the largest scaled violation of dynamics and constraints.
        error: of the first-order conditions, scaled.
    """

    status: Status
    iterations: int
    seconds: float
    cost: float
    violation: float
    error: float


class ControllerLog:
    """The records of a controller's calls, the last `size` of them, oldest first.

    `len(log)`, `log[-1]` and iteration give a `StepRecord` each; `log.seconds`, `log.iterations`, `log.costs`,
    `log.violations` and `log.errors` are arrays (calls,), and `log.statuses` is a list.
    """

    def __init__(self, size: int) -> None:
        self._size, self._records = size, list[StepRecord]()

    def append(self, record: StepRecord) -> None:
        self._records.append(record)
        if len(self._records) >= 2 * self._size:  # rarely, because removal at the front is slow
            del self._records[: -self._size]

    def _last(self) -> list[StepRecord]:
        return self._records[-self._size :]

    def __len__(self) -> int:
        return min(len(self._records), self._size)

    def __getitem__(self, k: int) -> StepRecord:
        return self._last()[k]

    def _of(self, name: str) -> Array:
        return np.array([getattr(record, name) for record in self._last()])

    @property
    def statuses(self) -> list[Status]:
        """The status of each solve."""
        return [record.status for record in self._last()]

    @property
    def iterations(self) -> Array:
        """Iterations of the solver in each call."""
        return self._of("iterations")

    @property
    def seconds(self) -> Array:
        """Wall time of each call, s."""
        return self._of("seconds")

    @property
    def costs(self) -> Array:
        """The objective of each plan."""
        return self._of("cost")

    @property
    def violations(self) -> Array:
        """The largest scaled violation of each plan."""
        return self._of("violation")

    @property
    def errors(self) -> Array:
        """The scaled error of the first-order conditions of each plan."""
        return self._of("error")

    def __repr__(self) -> str:
        if not len(self):
            return "ControllerLog(no calls)"
        counts = {status.name: self.statuses.count(status) for status in dict.fromkeys(self.statuses)}
        median, late = (1e3 * float(np.quantile(self.seconds, share)) for share in (0.5, 0.99))
        ended = ", ".join(f"{count} {name}" for name, count in counts.items())
        return f"ControllerLog({len(self)} calls: {ended}; {median:.3g} ms median, {late:.3g} ms at 99 %)"

    def plot(self) -> Any:
        """A matplotlib figure of times, iterations, objectives and violations by call.

        Raises:
            TrajectoryError: there were no calls.
            ModelError: matplotlib is not installed.
        """
        if not len(self):
            raise TrajectoryError("plot: the controller has not been called\n  fix: call controller.feedback(x) first")
        calls = np.arange(len(self), dtype=float)
        with np.errstate(divide="ignore"):
            logarithm = np.log10(np.maximum(self.violations, 1e-16))
        shown = {
            ("time of a call", "ms"): 1e3 * self.seconds,
            ("iterations", "steps"): self.iterations,
            ("objective of the plan", "its unit"): self.costs,
            ("violation", "log10"): logarithm,
        }
        panels = [Panel(title, unit, [title], (calls, a[:, None]), steps=True) for (title, unit), a in shown.items()]
        return draw(panels, repr(self), over="call")
