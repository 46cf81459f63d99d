"""One case at an edge: what it does, what it should do, and why."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import twistax as tx

__all__ = [
    "AtLeast",
    "AtMost",
    "Either",
    "Ended",
    "Ends",
    "Expected",
    "Found",
    "Place",
    "Refused",
    "Row",
    "Section",
    "flown",
    "plain",
]


def plain(number: float | int) -> str:
    """1e5 rather than 1e+05, and 0.05 as it is."""
    text = f"{number:.0e}" if number and not 1e-3 <= abs(number) < 1e4 else f"{number:g}"
    return text.replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


class Ended(Exception):
    """A flight that ended early: how, and when, s."""

    def __init__(self, result: tx.Result, t: float) -> None:
        super().__init__(f"{result.name} at t = {t:.6g} s: {result.sentence}")
        self.result, self.t = result, t


def flown(dynamics: tx.Dynamics, x0: Mapping[str, Any], **options: Any) -> tx.Solution:
    """`tx.integrate` to the end, or to an event.

    Raises:
        Ended: the flight ended early.
        TwistaxError: as `tx.integrate`.
    """
    sol = tx.integrate(dynamics, x0, throw=False, **options)
    if sol.result not in (tx.Result.SUCCESS, tx.Result.EVENT):
        raise Ended(sol.result, float(sol.ts[-1]))
    return sol


@dataclasses.dataclass(frozen=True)
class Found:
    """What a row did: a number, or an exception in place of one.

    Attributes:
        number: error or drift; not a number where there is none.
        failure: what was raised.
    """

    number: float = math.nan
    failure: Exception | None = None

    @property
    def text(self) -> str:
        """For the table."""
        if self.failure is None:
            return f"{self.number:.2g}" if math.isfinite(self.number) else "NOT A NUMBER, AND NOTHING SAID SO"
        first = str(self.failure).splitlines()[0] if str(self.failure) else ""
        kind = "" if isinstance(self.failure, Ended) else f"{type(self.failure).__name__}: "
        return f"{kind}{first}"


class Expected(ABC):
    """What a row should do."""

    @property
    @abstractmethod
    def text(self) -> str:
        """For the table."""

    @abstractmethod
    def met(self, found: Found) -> bool:
        """Whether it did. A number that is none never is what was expected."""


@dataclasses.dataclass(frozen=True)
class AtMost(Expected):
    """A number up to a bar, in a unit."""

    bar: float
    unit: str = ""

    @property
    def text(self) -> str:
        return f"at most {plain(self.bar)} {self.unit}".rstrip()

    def met(self, found: Found) -> bool:
        return found.failure is None and found.number <= self.bar


@dataclasses.dataclass(frozen=True)
class AtLeast(Expected):
    """A finite number from a bar on."""

    bar: float
    unit: str = ""

    @property
    def text(self) -> str:
        return f"at least {self.bar:g} {self.unit}".rstrip()

    def met(self, found: Found) -> bool:
        return found.failure is None and self.bar <= found.number < math.inf


@dataclasses.dataclass(frozen=True)
class Ends(Expected):
    """A flight that ends early with this result, between two times in s."""

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


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a row is drawn in its section's figure: on which line, at which x."""

    line: str
    x: float


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """A case.

    Attributes:
        case: what is done, in a few words with numbers.
        method: by what.
        measure: does it: gives an error or a drift, or raises.
        expected: what it should do.
        why: one plain sentence that explains it.
        slow: whether it is left out of the quick run.
        place: where it is drawn, if it is.
    """

    case: str
    method: str
    measure: Callable[[], Any]
    expected: Expected
    why: str
    slow: bool = False
    place: Place | None = None

    def observe(self) -> Found:
        """What the row does."""
        try:
            return Found(float(self.measure()))
        except Exception as failure:  # whatever comes is what the row found
            return Found(failure=failure)


@dataclasses.dataclass(frozen=True, eq=False)
class Section:
    """Rows that belong together.

    Attributes:
        name: a word, for files.
        title: a few words.
        about: what is done in all of them.
        rows: the rows.
        axes: labels of x and y of the figure; None without one.
    """

    name: str
    title: str
    about: str
    rows: tuple[Row, ...]
    axes: tuple[str, str] | None = None
