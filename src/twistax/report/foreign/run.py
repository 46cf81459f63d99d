"""Both solvers on a problem, successively in this process: the first solve, and a second one."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import math
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from ..harness.expected import Absent
from ..harness.rows import first_line
from .ipopt import nlp_of
from .statement import Foreign, Phased

#: A second solve is the fastest of so many, as many of them as begin within so many seconds.
_REPEATS, _BEGIN = 3, 5.0
#: Relative difference of objectives up to which they are one optimum.
SAME = 1e-6


@dataclasses.dataclass(frozen=True)
class Side:
    """What one side answers: objective, iterations, seconds of the first answer with all building, and of a second."""

    solved: bool
    word: str
    cost: float = math.nan
    iterations: int = 0
    first: float = math.nan
    second: float = math.nan

    NAMES: ClassVar = ("solved", "cost", "iterations", "first", "second")

    @property
    def numbers(self) -> list[tuple[str, float]]:
        """All but the word."""
        return [(name, float(getattr(self, name))) for name in self.NAMES]

    @classmethod
    def of(cls, numbers: Mapping[str, float]) -> Side:
        """The side of these numbers, without its word."""
        values = {name: numbers[name] for name in ("cost", "first", "second")}
        return cls(bool(numbers["solved"]), "", iterations=int(numbers["iterations"]), **values)


class _Overdue(Exception):
    """The time is up."""


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Raise _Overdue after so many seconds of processor time, as busy machines are fair so, once Python runs again.

    Without a limit where the system has no such alarm.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return

    def ring(*_: Any) -> None:
        raise _Overdue

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _overdue(seconds: float) -> Side:
    return Side(False, f"no answer in {seconds:g} s of the processor")


def _fastest(call: Callable[[], Any]) -> float:
    """Seconds of the fastest of several calls."""
    seconds: list[float] = []
    while len(seconds) < _REPEATS and sum(seconds) < _BEGIN:
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def ipopt(problem: Foreign | Phased, seconds: float) -> Side:
    """By plain IPOPT. Raises Absent without CasADi."""
    gc.collect()
    begin = time.perf_counter()
    nlp = nlp_of(problem)
    nlp.prepare(seconds)
    solved, cost, iterations, word = nlp.solve()
    first = time.perf_counter() - begin
    second = _fastest(nlp.solve) if solved else math.nan
    return Side(solved, word, cost, iterations, first, second)


def ours(problem: Foreign | Phased, seconds: float) -> Side:
    """By `Problem.solve` with its defaults; any mesh is taken, for it is the same on both sides."""
    gc.collect()
    begin = time.perf_counter()
    try:
        with _limited(seconds):
            stated_problem = problem.twistax()
            result = stated_problem.solve(mesh_tolerance=np.inf)
            first = time.perf_counter() - begin
            again = lambda: stated_problem.solve(mesh_tolerance=np.inf)  # noqa: E731
            second = _fastest(again) if result.solved else math.nan
    except _Overdue:
        return _overdue(seconds)
    except Absent:
        raise
    except Exception as error:  # whatever comes is what was found
        return Side(False, f"{type(error).__name__}: {first_line(error)}")
    return Side(result.solved, result.status.name, float(result.cost), result.iterations, first, second)


def excess_cost(problem: Foreign | Phased, mine: Side, theirs: Side) -> float:
    """By how much our objective is worse, relative; negative where it is better, NaN unless both are solved."""
    if not (mine.solved and theirs.solved):
        return math.nan
    worse = (mine.cost - theirs.cost) / max(abs(theirs.cost), 1e-12)
    return -worse if problem.maximise else worse


def in_words(worse: float) -> str:
    """Whether two optima are the same."""
    if math.isnan(worse):
        return "-"
    if abs(worse) <= SAME:
        return "same"
    return f"{'worse' if worse > 0.0 else 'better'} by {abs(worse):.1e}"
