"""Checks: one case each, what is asked of it, and what came."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import twistax as tx

from .rows import DONE, Row, first_line, now, number

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
    """`tx.integrate` to the end, or to an event. Raises Ended if it ended early, and what `tx.integrate` raises."""
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
    """What is asked for."""

    text: str  # for tables; empty where nothing is
    met: Callable[[Outcome], bool]  # whether a number, or what was raised, is it; NaN never is
    unit: str = ""


def between(low: float = -math.inf, high: float = math.inf, unit: str = "") -> Expected:
    """A finite number within bounds; without bounds nothing is asked for but a number."""
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
    met = lambda came: isinstance(came, error) and words in first_line(came)  # noqa: E731
    return Expected(f"{error.__name__} with the words: {words}", met)


def either(one: Expected, other: Expected) -> Expected:
    """One of two, where processors differ."""
    return Expected(f"{one.text}, or {other.text}", lambda came: one.met(came) or other.met(came))


def judged(row: Row, expected: Expected, came: Outcome | None = None) -> Row:
    """The row with its bar and whether that holds, of its value if nothing else came; what is missing is not judged."""
    missing = math.isnan(row.value) if came is None else isinstance(came, (Absent, ImportError))
    met = expected.met(row.value if came is None else came)
    holds = None if missing or (met and not expected.text) else met
    return dataclasses.replace(row, bar=expected.text, holds=holds, unit=expected.unit or row.unit)


class Check:
    """A case: what is done, in a few words with numbers; by what; and what is asked of the number that comes.

    `measure` gives the number of the arguments after it, or raises. Slow ones are left out of the quick run. A place is
    where the section's figure has it: on which line, at which x.
    """

    def __init__(
        self,
        what: str,
        by: str,
        expected: Expected,
        measure: Callable[..., Any],
        *arguments: Any,
        slow: bool = False,
        place: tuple[str, float] | None = None,
        **options: Any,
    ) -> None:
        self.what, self.by, self.expected, self.slow, self.place = what, by, expected, slow, place
        self._measure = functools.partial(measure, *arguments, **options)

    def run(self, section: str = "") -> Row:
        """What it does."""
        row = Row(section, self.what, self.by, sitting=now())
        try:
            came: Outcome = float(self._measure())
        except Exception as failure:  # whatever comes is what was found
            came = failure
        if isinstance(came, float):
            row = dataclasses.replace(row, value=came, note=DONE if math.isfinite(came) else _SILENT)
        else:
            kind = "" if isinstance(came, (Ended, Absent)) else f"{type(came).__name__}: "
            row = dataclasses.replace(row, note=kind + first_line(came))
        return judged(row, self.expected, came)


_SILENT = "NaN OR INFINITE, AND NOTHING SAID SO"

#: The checks of a section, those that need it after a plain sentence that explains what comes of them. Its title, and
#: what its page says of it, stand in `sections.toml`.
Section = list[str | Check]
