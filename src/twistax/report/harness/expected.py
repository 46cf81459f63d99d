"""The expected result of a measurement, and its outcome: a number, an integration that ended early, or an error."""

import dataclasses
import importlib
import importlib.util
import math
from collections.abc import Callable, Mapping
from typing import Any

import twistax as tx

from .rows import ReportRow, first_line, number

#: The outcome of a measurement: a number, or the error in its place.
Outcome = float | Exception


class Absent(Exception):
    """A measurement needs something that this machine does not have; the message names it."""


def needed(module: str, fix: str = "") -> Any:
    """A module that may not be installed. Raises Absent if it is not; the message ends with the way to install it."""
    if importlib.util.find_spec(module) is None:
        raise Absent(f"not run: {module} is not installed{fix and f'; pip install {fix}'}")
    return importlib.import_module(module)


class EarlyEnd(Exception):
    """An integration that ended early: how, and when, s."""

    def __init__(self, result: tx.Result, t: float) -> None:
        super().__init__(f"{result.name} at t = {t:.6g} s: {result.sentence}")
        self.result, self.t = result, t


def simulated(dynamics: tx.Dynamics, x0: Mapping[str, Any], **options: Any) -> tx.Solution:
    """`tx.integrate` to the end, or to an event. Raises EarlyEnd, and what `tx.integrate` raises."""
    sol = tx.integrate(dynamics, x0, throw=False, **options)
    if sol.result not in (tx.Result.SUCCESS, tx.Result.EVENT):
        raise EarlyEnd(sol.result, float(sol.ts[-1]))
    return sol


@dataclasses.dataclass(frozen=True)
class Expected:
    """The condition that an outcome must meet."""

    text: str  # for tables; empty where any number will do
    met: Callable[[Outcome], bool]  # whether an outcome meets it; NaN never does
    unit: str = ""


def between(low: float = -math.inf, high: float = math.inf, unit: str = "") -> Expected:
    """A finite number within bounds; without bounds any finite number."""
    bounds = (("at least", low), ("at most", high))
    limits = ", ".join(f"{word} {number(bound)}" for word, bound in bounds if math.isfinite(bound))
    text = f"{limits} {unit}".strip() if limits else ""
    return Expected(
        text, lambda value: isinstance(value, float) and math.isfinite(value) and low <= value <= high, unit
    )


def at_most(bar: float | int, unit: str = "") -> Expected:
    """A number up to a bar."""
    return between(high=float(bar), unit=unit)


def ends(result: tx.Result, after: float = 0.0, before: float = math.inf) -> Expected:
    """An integration that ends early with this result, between two times in s."""
    when = "" if before == math.inf else f", {after:g} <= t <= {before:g} s"

    def met(outcome: Outcome) -> bool:
        return isinstance(outcome, EarlyEnd) and outcome.result is result and after <= outcome.t <= before

    return Expected(f"ends: {result.name}{when}", met)


def refused(error: type[tx.TwistaxError], words: str) -> Expected:
    """An error of this type whose first line has these words."""
    met = lambda outcome: isinstance(outcome, error) and words in first_line(outcome)  # noqa: E731
    return Expected(f"{error.__name__} with the words: {words}", met)


def either(first: Expected, second: Expected) -> Expected:
    """One of two expectations, where processors differ."""
    return Expected(f"{first.text}, or {second.text}", lambda outcome: first.met(outcome) or second.met(outcome))


def judged(row: ReportRow, expected: Expected, outcome: Outcome | None = None) -> ReportRow:
    """The row with its bar, and whether the outcome (by default its value) meets it; None where it is missing."""
    missing = math.isnan(row.value) if outcome is None else isinstance(outcome, (Absent, ImportError))
    met = expected.met(row.value if outcome is None else outcome)
    holds = None if missing or (met and not expected.text) else met
    return dataclasses.replace(row, bar=expected.text, holds=holds, unit=expected.unit or row.unit)
