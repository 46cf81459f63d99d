"""A bar on the terminal."""

from __future__ import annotations

import time
from typing import Any

__all__ = ["Progress"]

_WIDTH = 24


class Progress:
    """One line that is overwritten; silent where the stream is no terminal, or when told to be.

    `tell(what, share)` shows how much of the present part is done; parts are of equal weight.
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
        if not self._shown:
            return
        whole = (self._done + share) / self._parts
        bar = "=" * round(_WIDTH * whole)
        seconds = time.perf_counter() - self._begin
        self._stream.write(f"\r\033[K[{bar:<{_WIDTH}}] {whole:4.0%} {seconds:4.0f} s  {self._part}  {what}")
        self._stream.flush()

    def end(self) -> None:
        """The part is done; the line is cleared."""
        self._done += 1
        if self._shown:
            self._stream.write("\r\033[K")
            self._stream.flush()
