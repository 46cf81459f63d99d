"""How far a run is, in one line of a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

__all__ = ["Progress", "Tell", "quiet"]

#: Called with what is going on, and how much of the present part is done, 0 to 1.
Tell = Callable[[str, float], None]

_WIDTH = 24


def quiet(what: str, share: float) -> None:
    """Tells nobody."""


class Progress:
    """One line that is overwritten; silent where the stream is no terminal, or when told to be.

    Parts are of equal weight.
    """

    def __init__(self, stream: Any, parts: int, shown: bool) -> None:
        self._stream, self._parts, self._done = stream, parts, 0
        self._shown = shown and stream.isatty()
        self._begin, self._part = time.perf_counter(), ""

    def start(self, part: str) -> None:
        """Begin the next part."""
        self._part = part
        self.tell("", 0.0)

    def tell(self, what: str, share: float) -> None:
        """Show what is going on, and how much of the present part is done."""
        whole = (self._done + share) / self._parts
        seconds = time.perf_counter() - self._begin
        bar = "=" * round(_WIDTH * whole)
        self._write(f"[{bar:<{_WIDTH}}] {whole:4.0%} {seconds:4.0f} s  {self._part}  {what}")

    def end(self) -> None:
        """The part is done; the line is cleared."""
        self._done += 1
        self._write("")

    def _write(self, text: str) -> None:
        if self._shown:
            self._stream.write(f"\r\033[K{text}")
            self._stream.flush()
