"""Checks: one case each, what is asked of it, and what came."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

import twistax as tx

from .rows import DONE, Key, Row, number

#: What a check gives: a number, or what was raised in place of one.
Outcome = float | Exception


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
class Expected:
    """What is asked for.

    Attributes:
        text: for tables; empty where nothing is.
        met: whether a number, or what was raised, is it; NaN never is.
        unit: of the number.
    """

    text: str
    met: Callable[[Outcome], bool]
    unit: str = ""


def between(low: float = -math.inf, high: float = math.inf, unit: str = "") -> Expected:
    """A finite number within bounds."""
    bounds = (("at least", low), ("at most", high))
    said = ", ".join(f"{word} {number(bound)}" for word, bound in bounds if math.isfinite(bound))
    text = f"{said} {unit}".strip() if said else ""
    return Expected(text, lambda came: isinstance(came, float) and math.isfinite(came) and low <= came <= high, unit)


def at_most(bar: float | int, unit: str = "") -> Expected:
    """A number up to a bar."""
    return between(high=float(bar), unit=unit)


def at_least(bar: float | int, unit: str = "") -> Expected:
    """A finite number from a bar on."""
    return between(low=float(bar), unit=unit)


def ends(result: tx.Result, after: float = 0.0, before: float = math.inf) -> Expected:
    """An integration that ends early with this result, between two times in s."""
    when = "" if before == math.inf else f", {after:g} <= t <= {before:g} s"

    def met(came: Outcome) -> bool:
        return isinstance(came, Ended) and came.result is result and after <= came.t <= before

    return Expected(f"ends: {result.name}{when}", met)


def refused(error: type[tx.TwistaxError], words: str) -> Expected:
    """An error of this type whose first line has these words."""

    def met(came: Outcome) -> bool:
        return isinstance(came, error) and words in str(came).splitlines()[0]

    return Expected(f"{error.__name__} with the words: {words}", met)


def either(one: Expected, other: Expected) -> Expected:
    """One of two, where processors differ."""
    return Expected(f"{one.text}, or {other.text}", lambda came: one.met(came) or other.met(came))


def judged(row: Row, expected: Expected, came: Outcome | None = None) -> Row:
    """The row with its bar and whether that holds; what was not measured is not judged.

    Args:
        came: without it the row's value counts, and NaN is one that was not measured.
    """
    missing = math.isnan(row.value) if came is None else isinstance(came, (Absent, ImportError))
    met = expected.met(row.value if came is None else came)
    holds = None if missing or (met and not expected.text) else met
    return dataclasses.replace(row, bar=expected.text, holds=holds, unit=expected.unit or row.unit)


# ---- checks and sections --------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Check:
    """A case.

    Attributes:
        what: what is done, in a few words with numbers.
        by: by what.
        measure: does it: gives a number, or raises.
        expected: what is asked of it; `between()` without bounds asks for nothing.
        slow: whether it is left out of the quick run.
        place: where it is drawn in its section's figure, if it is: on which line, at which x.
    """

    what: str
    by: str
    measure: Callable[[], Any]
    expected: Expected = between()  # noqa: RUF009  frozen
    slow: bool = False
    place: tuple[str, float] | None = None

    def run(self, section: str = "") -> Row:
        """What it does."""
        row = Row(section, self.what, self.by, sitting=datetime.now().isoformat(timespec="seconds"))
        try:
            came: Outcome = float(self.measure())
        except Exception as failure:  # whatever comes is what was found
            came = failure
        if isinstance(came, float):
            row = dataclasses.replace(row, value=came, note=DONE if math.isfinite(came) else _SILENT)
        else:
            first = (str(came).splitlines() or [""])[0]
            named = isinstance(came, (Ended, Absent))
            row = dataclasses.replace(row, note=first if named else f"{type(came).__name__}: {first}")
        return judged(row, self.expected, came)


_SILENT = "NaN OR INFINITE, AND NOTHING SAID SO"


@dataclasses.dataclass(frozen=True, eq=False)
class Section:
    """Checks that belong together.

    Attributes:
        name: a word, for files and the command line; its title and what is done in it stand in `sections.toml`.
        content: checks, those that need it after a plain sentence that explains what comes of them.
        axes: labels of x and y of the figure; None without one.
        wide: whether the table has a column for each `by`.
    """

    name: str
    content: Sequence[str | Check]
    axes: tuple[str, str] | None = None
    wide: bool = False

    def __iter__(self) -> Iterator[tuple[str, Check]]:
        """Each check after its sentence."""
        why = ""
        for each in self.content:
            if isinstance(each, str):
                why = each
            else:
                yield why, each

    def key(self, check: Check) -> Key:
        """That of its row."""
        return self.name, check.what, check.by, ""
