"""Progress messages of calls that may take long, through the logger "twistax".

If logging is configured for that logger at level INFO, messages are log records. Otherwise they are lines on standard
error. `logging.getLogger("twistax").setLevel(logging.WARNING)` switches them off.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import sys
import threading
import time
import warnings
from collections.abc import Callable, Hashable
from typing import Any, ParamSpec, TypeVar

from .errors import TrajectoryError

P = ParamSpec("P")
T = TypeVar("T")

LOGGER = logging.getLogger("twistax")
#: Seconds between lines, on a terminal and elsewhere.
_LIVE, _LOGGED = 0.1, 5.0
#: Seconds without a line before a call of a user shows one by itself, and between looks of the watching thread; their
#: sum is below two.
_PATIENCE, _TICK = 1.5, 0.25
#: Of a bar, in characters.
_WIDTH = 24


class Progress:
    """Progress lines of a call: `problem.solve(progress=tx.trajectory.Progress(cost="mass {:.0f} kg"))`.

    A solve prints a line for each iteration: its cost, the largest violation and the largest relative change of an
    unknown. An integration and a sweep overwrite one line. Without a terminal a line is printed every five seconds.
    Within `with progress:` a line with the elapsed seconds appears after some time without other output. It is also a
    callback of `Problem.solve`, and its method `reached` is a callback of `tx.integrate`.

    Args:
        what: the first word of the line.
        cost: a format of the cost, such as "mass {:.0f} kg".
        stream: the output stream; standard error by default.
        shown: True: lines appear from the start. None: after two seconds, on a terminal only. False: never.
    Raises:
        TrajectoryError: `cost` is not a format of one number.
    """

    def __init__(
        self, what: str = "solve", cost: str = "cost {:.6g}", stream: Any = None, shown: bool | None = True
    ) -> None:
        try:
            cost.format(0.0)
        except (ValueError, IndexError, KeyError, AttributeError):
            raise TrajectoryError(f"Progress expects cost such as 'mass {{:.0f}} kg', got {cost!r}") from None
        self.what, self._cost, self._text = what, cost, ""
        self._stream = sys.stderr if stream is None else stream
        self._logs = LOGGER.isEnabledFor(logging.INFO) and LOGGER.hasHandlers()
        self._live = not self._logs and _is_terminal(self._stream)
        switched_off = LOGGER.disabled or LOGGER.level > logging.INFO
        self.shown = shown is not False and not switched_off and (shown is True or self._live or self._logs)
        self._patience = 0.0 if shown else _PATIENCE
        self.begin = time.perf_counter()
        self._written = 0.0 if self._live else self.begin
        self._depth, self.thread, self._lock = 0, 0, threading.Lock()
        self._standing = self._waited = False  # a line that the next one overwrites; whether seconds were shown

    def __call__(self, iteration: int, cost: float, violation: float, step: float | None = None) -> None:
        moved = "" if step is None else f"   step {step:8.1e}"
        row = lambda: f"iteration {iteration:4d}   {self._cost.format(cost)}   violation {violation:8.1e}{moved}"  # noqa: E731
        self._show(row, live=False, every=0.0 if self._live and not self._patience else None)

    def __enter__(self) -> Progress:
        self._depth += 1
        if self.shown and self._depth == 1:
            self.thread = threading.get_ident()
            _watch(self)
            if self._live and not self._patience:
                self._write(f"{self._text} ...".lstrip(), live=True)
        return self

    def __exit__(self, *error: object) -> None:
        self._depth -= 1
        if self.shown and not self._depth:
            with contextlib.suppress(ValueError):
                _WATCHED.remove(self)
            self.close()
            # The outer one shows the seconds of both.
            within = any(line.what == self.what and line.thread == self.thread for line in _WATCHED)
            took = time.perf_counter() - self.begin
            if self._waited and self._patience and took >= self._patience and not within:
                self._write(f"took {took:.1f} s", live=False)

    def reached(self, t: float, share: float) -> None:
        """Show the time that an integration has reached, in s, and the completed fraction."""
        self._show(lambda: f"t {t:12.6g} s   {100.0 * share:5.1f} %")
        if share >= 1.0:
            self.close()

    def done(self, share: float, what: str, before: float = 0.0) -> None:
        """Show a bar and the remaining seconds, from the completed fraction and the part of it that an earlier run
        completed.
        """
        took = time.perf_counter() - self.begin
        left = f", {took * (1.0 - share) / (share - before):.0f} s left" if share > before else ""
        self._show(lambda: f"[{'=' * round(_WIDTH * share):<{_WIDTH}}] {share:4.0%} of {what}{left}")

    def note(self, text: str) -> None:
        """Set the text of the line that appears while there is no other output."""
        self._text = text

    def close(self) -> None:
        """Clear the line."""
        if self._standing:
            self._standing = False
            print("\r\033[K", end="", file=self._stream, flush=True)

    def waited(self, since: float) -> None:
        """Show the elapsed seconds if there was no output for some time; `since` is the start of the outermost call."""
        now = time.perf_counter()
        if now - since < max(self._patience, 1.0) or now - self._written < (1.0 if self._live else _LOGGED):
            return
        self._waited = True
        self._write(f"{self._text} ...".lstrip() + f"   {now - self.begin:5.0f} s", live=self._live)

    def _show(self, seen: Callable[[], str], live: bool = True, every: float | None = None) -> None:
        """Where it is time for another line: `every` is the time between two, s."""
        every = (_LIVE if self._live else _LOGGED) if every is None else every
        now = time.perf_counter()
        early = now - self.begin < self._patience
        if self.shown and not early and now - self._written >= every:
            self._written = now
            self._write(f"{seen()}   {now - self.begin:5.1f} s", live and self._live)

    def _write(self, text: str, live: bool) -> None:
        line = f"{self.what:<9} {text}"
        with self._lock:
            if self._logs:
                LOGGER.info(line)
            else:
                # On a terminal the next text overwrites a live line.
                begin, end = ("\r\033[K" if self._live else ""), ("\r" if live else "\n")
                print(f"{begin}{line}", end=end, file=self._stream, flush=True)
        self._written, self._standing = time.perf_counter(), live


def _is_terminal(stream: Any) -> bool:
    """Programs without a console have None, and other streams may lack `isatty` or be closed."""
    try:
        return bool(stream.isatty())
    except (AttributeError, ValueError):
        return False


def watched(what: str, progress: bool | None = None) -> Progress | contextlib.nullcontext[None]:
    """A context that shows elapsed seconds; `progress` is the argument of a public call.

    It has no cost if no line can appear.
    """
    if progress is False or not (progress or _is_terminal(sys.stderr) or LOGGER.isEnabledFor(logging.INFO)):
        return contextlib.nullcontext()
    line = Progress(what, shown=progress)
    return line if line.shown else contextlib.nullcontext()


class FirstCalls:
    """Contexts of a compiled function: the first call for a key may compile, so it shows its seconds.

    Later calls have no cost. They show nothing, also if arguments of another type compile the function again.
    """

    def __init__(self, what: str) -> None:
        self._what, self._keys = what, set[Hashable]()

    def __call__(self, key: Hashable = None) -> Progress | contextlib.nullcontext[None]:
        if key in self._keys:
            return contextlib.nullcontext()
        self._keys.add(key)
        return watched(self._what)

    def of(self, function: Callable[..., T]) -> Callable[..., T]:
        """A function within these contexts; its first argument is the key."""

        def call(key: Hashable, *arguments: Any) -> T:
            with self(key):
                return function(key, *arguments)

        return call


def watching(what: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A decorator of functions whose first call may take long because of imports or compilation."""

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def call(*arguments: P.args, **options: P.kwargs) -> T:
            with watched(what):
                return function(*arguments, **options)

        return call

    return decorate


#: Calls under way in all threads, the innermost of each thread last.
_WATCHED: list[Progress] = []
_ANY = threading.Event()
_THREAD: list[threading.Thread] = []


def _watch(line: Progress) -> None:
    _WATCHED.append(line)
    if not _THREAD or not _THREAD[0].is_alive():  # none yet, or this process is a fork
        _THREAD[:] = [threading.Thread(target=_look, name="twistax progress", daemon=True)]
        _THREAD[0].start()
    _ANY.set()


def _look() -> None:
    """Show a line for the newest unfinished call, again and again; sleep while there is none."""
    while True:
        _ANY.wait()
        time.sleep(_TICK)
        lines = list(_WATCHED)
        if lines:
            outermost = next(line for line in lines if line.thread == lines[-1].thread)
            lines[-1].waited(outermost.begin)
        else:
            _ANY.clear()
            if _WATCHED:  # one began in between
                _ANY.set()


#: Warnings that were given, each once for a process.
_SAID: set[str] = set()


def say_once(message: str) -> None:
    """Issue a RuntimeWarning once per process; repeatedly if a warning filter turns it into an error."""
    if message not in _SAID:
        warnings.warn(message, RuntimeWarning, stacklevel=3)
        _SAID.add(message)
