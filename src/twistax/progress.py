"""How far a search or an integration is, on one line: `problem.solve(callback=tx.trajectory.Progress())`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

from .errors import TrajectoryError

#: Seconds between lines, on a terminal and elsewhere.
_LIVE, _LOGGED = 0.1, 5.0
#: Of a bar, in characters.
_WIDTH = 24


class Progress:
    """A callback of `Problem.solve`: iteration, cost and violation, and the seconds since it was made.

    On a terminal it is one line that is overwritten, elsewhere a line every five seconds. Its method `reached` shows
    how far an integration is: `tx.integrate(..., progress=tx.trajectory.Progress("flight").reached)`.

    Args:
        what: the word the line begins with.
        cost: how the cost is written, a format such as "mass {:.0f} kg".
        stream: where it is written; standard error if left out.
    Raises:
        TrajectoryError: cost is no format of one number.
    """

    def __init__(self, what: str = "solve", cost: str = "cost {:.6g}", stream: Any = None) -> None:
        try:
            cost.format(0.0)
        except (ValueError, IndexError, KeyError, AttributeError):
            raise TrajectoryError(f"Progress expects cost such as 'mass {{:.0f}} kg', got {cost!r}") from None
        self._what, self._cost = what, cost
        self._stream = sys.stderr if stream is None else stream
        self._live = self._stream.isatty()
        self._begin = time.perf_counter()
        self._shown = 0.0 if self._live else self._begin

    def __call__(self, iteration: int, cost: float, violation: float) -> None:
        self._show(lambda: f"iteration {iteration:4d}   violation {violation:8.1e}   {self._cost.format(cost)}")

    def reached(self, t: float, share: float) -> None:
        """Show the time an integration reached in s, and the share of the way to its end."""
        self._show(lambda: f"t {t:12.6g} s   {100.0 * share:5.1f} %")
        if share >= 1.0:
            self.close()

    def done(self, share: float, what: str, before: float = 0.0) -> None:
        """Show a bar and the seconds left: the share of something that is done, and that of it from an earlier run."""
        took = time.perf_counter() - self._begin
        left = f", {took * (1.0 - share) / (share - before):.0f} s left" if share > before else ""
        self._show(lambda: f"[{'=' * round(_WIDTH * share):<{_WIDTH}}] {share:4.0%} of {what}{left}")

    def note(self, text: str) -> None:
        """Show a text until the first iteration, on a terminal only."""
        if self._live:
            self._write(text)

    def close(self) -> None:
        """Clear the line."""
        if self._live:
            print("\r\033[K", end="", file=self._stream, flush=True)

    def _show(self, seen: Callable[[], str]) -> None:
        """Where it is time for another line."""
        now = time.perf_counter()
        if now - self._shown >= (_LIVE if self._live else _LOGGED):
            self._shown = now
            self._write(f"{seen()}   {now - self._begin:5.1f} s")

    def _write(self, text: str) -> None:
        line = f"{self._what:<9} {text}"
        # Back to the beginning of the line, so that the next text overwrites it.
        print(
            f"\r\033[K{line}\r" if self._live else line, end="" if self._live else "\n", file=self._stream, flush=True
        )
