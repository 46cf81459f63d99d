"""One line that follows a search."""

from __future__ import annotations

import time
from typing import Any

__all__ = ["Progress"]


class Progress:
    """Shows iteration, violation and mass: on a terminal in one line that is overwritten, else every few seconds.

    `update` is a callback of `tx.trajectory.Problem.solve`; the mass is its cost.
    """

    def __init__(self, out: Any, what: str) -> None:
        self._out, self._what = out, what
        self._live = out.isatty()
        self._pause = 0.1 if self._live else 5.0
        self._begin = time.perf_counter()
        self._shown = 0.0 if self._live else self._begin

    def note(self, text: str) -> None:
        """Show a text until the first iteration, on a terminal only."""
        if self._live:
            self._write(text)

    def update(self, iteration: int, cost: float, violation: float) -> None:
        now = time.perf_counter()
        if now - self._shown < self._pause:
            return
        self._shown = now
        self._write(
            f"iteration {iteration:4d}   violation {violation:8.1e}   mass {cost:9,.0f} kg   {now - self._begin:5.1f} s"
        )

    def _write(self, text: str) -> None:
        line = f"{self._what:<9} {text}"
        self._out.write(f"\r\033[K{line}" if self._live else f"{line}\n")
        self._out.flush()

    def close(self) -> None:
        """Clear the line."""
        if self._live:
            self._out.write("\r\033[K")
            self._out.flush()
