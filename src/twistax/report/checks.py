"""Checks: one case each, what is asked of it, and what came."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

import twistax as tx

from .progress import Tell
from .rows import DONE, Key, Row, number
from .store import Store

__all__ = [
    *("Absent", "Between", "Check", "Either", "Ended", "Ends", "Expected", "Found", "Place", "Refused", "Section"),
    *("agree", "at_least", "at_most", "judged", "measure_section", "simulated"),
]


class Absent(Exception):
    """What a check needs is not on this machine; the message says what."""


class Ended(Exception):
    """An integration that ended early: how, and when, s."""

    def __init__(self, result: tx.Result, t: float) -> None:
        super().__init__(f"{result.name} at t = {t:.6g} s: {result.sentence}")
        self.result, self.t = result, t


def simulated(dynamics: tx.Dynamics, x0: Mapping[str, Any], **options: Any) -> tx.Solution:
    """`tx.integrate` to the end, or to an event.

    Raises:
        Ended: it ended early.
        TwistaxError: as `tx.integrate`.
    """
    sol = tx.integrate(dynamics, x0, throw=False, **options)
    if sol.result not in (tx.Result.SUCCESS, tx.Result.EVENT):
        raise Ended(sol.result, float(sol.ts[-1]))
    return sol


def agree(apart: float, bar: float) -> None:
    """Asked before times are compared. Raises RuntimeError where results are farther apart than the bar, or NaN."""
    if not apart <= bar:
        raise RuntimeError(f"DISAGREES by {apart:.1e}, more than {bar:.0e}")


# ---- what is asked --------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Found:
    """What a check gave: a number, or an exception in place of one."""

    number: float = math.nan
    failure: Exception | None = None

    @classmethod
    def of(cls, measure: Callable[[], Any]) -> Found:
        try:
            return cls(float(measure()))
        except Exception as failure:  # whatever comes is what was found
            return cls(failure=failure)

    @property
    def absent(self) -> bool:
        """Whether something it needs is missing."""
        return isinstance(self.failure, (Absent, ImportError))

    @property
    def note(self) -> str:
        """That of a row: the first line of what happened where there is no number."""
        if self.failure is None:
            return DONE if math.isfinite(self.number) else "NaN OR INFINITE, AND NOTHING SAID SO"
        first = (str(self.failure).splitlines() or [""])[0]
        named = isinstance(self.failure, (Ended, Absent))
        return first if named else f"{type(self.failure).__name__}: {first}"


class Expected(ABC):
    """What is asked for."""

    #: Of the number.
    unit = ""

    @property
    @abstractmethod
    def text(self) -> str:
        """For tables."""

    @abstractmethod
    def met(self, found: Found) -> bool:
        """Whether it came. NaN never is what was asked for."""


@dataclasses.dataclass(frozen=True)
class Between(Expected):
    """A finite number within bounds."""

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    @property
    def text(self) -> str:
        bounds = (("at least", self.low), ("at most", self.high))
        said = ", ".join(f"{word} {number(bound)}" for word, bound in bounds if math.isfinite(bound))
        return f"{said} {self.unit}".strip() if said else ""

    def met(self, found: Found) -> bool:
        return found.failure is None and math.isfinite(found.number) and self.low <= found.number <= self.high


def at_most(bar: float | int, unit: str = "") -> Between:
    """A number up to a bar."""
    return Between(high=float(bar), unit=unit)


def at_least(bar: float | int, unit: str = "") -> Between:
    """A finite number from a bar on."""
    return Between(low=float(bar), unit=unit)


@dataclasses.dataclass(frozen=True)
class Ends(Expected):
    """An integration that ends early with this result, between two times in s."""

    result: tx.Result
    after: float = 0.0
    before: float = math.inf

    @property
    def text(self) -> str:
        when = "" if self.before == math.inf else f", {self.after:g} <= t <= {self.before:g} s"
        return f"ends: {self.result.name}{when}"

    def met(self, found: Found) -> bool:
        ended = found.failure
        return isinstance(ended, Ended) and ended.result is self.result and self.after <= ended.t <= self.before


@dataclasses.dataclass(frozen=True)
class Refused(Expected):
    """An error of this type whose first line has these words."""

    error: type[tx.TwistaxError]
    words: str

    @property
    def text(self) -> str:
        return f"{self.error.__name__} with the words: {self.words}"

    def met(self, found: Found) -> bool:
        said = found.failure
        return isinstance(said, self.error) and self.words in str(said).splitlines()[0]


@dataclasses.dataclass(frozen=True)
class Either(Expected):
    """One of two, where processors differ."""

    one: Expected
    other: Expected

    @property
    def text(self) -> str:
        return f"{self.one.text}, or {self.other.text}"

    def met(self, found: Found) -> bool:
        return self.one.met(found) or self.other.met(found)


def judged(row: Row, expected: Expected, found: Found | None = None) -> Row:
    """The row with its bar and whether that holds; what was not measured is not judged.

    Args:
        found: what came; without it the row's value counts, and NaN is one that was not measured.
    """
    missing = math.isnan(row.value) if found is None else found.absent
    met = expected.met(found or Found(row.value))
    holds = None if missing or (met and not expected.text) else met
    return dataclasses.replace(row, bar=expected.text, holds=holds, unit=expected.unit or row.unit)


# ---- checks and sections --------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a check is drawn in its section's figure: on which line, at which x."""

    line: str
    x: float


@dataclasses.dataclass(frozen=True, eq=False)
class Check:
    """A case.

    Attributes:
        what: what is done, in a few words with numbers.
        by: by what.
        measure: does it: gives a number, or raises.
        expected: what is asked of it; a `Between()` without bounds asks for nothing.
        slow: whether it is left out of the quick run.
        place: where it is drawn, if it is.
    """

    what: str
    by: str
    measure: Callable[[], Any]
    expected: Expected = Between()
    slow: bool = False
    place: Place | None = None

    def row(self, section: Section) -> Row:
        """What it does."""
        found, when = Found.of(self.measure), datetime.now().isoformat(timespec="seconds")
        row = Row(section.name, self.what, self.by, value=found.number, note=found.note, sitting=when)
        return judged(row, self.expected, found)


@dataclasses.dataclass(frozen=True, eq=False)
class Section:
    """Checks that belong together.

    Attributes:
        name: a word, for files and the command line.
        title: a few words.
        about: what is done in all of them.
        reasons: the checks, by one plain sentence that explains what comes.
        axes: labels of x and y of the figure; None without one.
        wide: whether the table has a column for each `by`.
    """

    name: str
    title: str
    about: str
    reasons: Mapping[str, Sequence[Check]]
    axes: tuple[str, str] | None = None
    wide: bool = False

    def __iter__(self) -> Iterator[tuple[str, Check]]:
        return ((why, check) for why, checks in self.reasons.items() for check in checks)

    def key(self, check: Check) -> Key:
        return self.name, check.what, check.by, ""

    def rows(self, store: Store) -> list[Row]:
        """Those that were measured, in order."""
        return [row for _, check in self if (row := store.get(*self.key(check)))]


def measure_section(section: Section, quick: bool, store: Store, tell: Tell) -> None:
    """Run what is not in the store yet, or was not run for want of something."""
    checks = [check for _, check in section if not (quick and check.slow)]
    for i, check in enumerate(checks):
        row = store.get(*section.key(check))
        if row is None or (row.holds is None and not row.done):
            tell(check.what, i / len(checks))
            store.add([check.row(section)])
