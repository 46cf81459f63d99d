"""What all reports have in common, and those made of checks: one case each, what is asked of it, and what came."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import importlib.util
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from .page import as_svg, panels, table_of, texts
from .rows import DONE, Row, Store, first_line, now, number
from .timing import Repeats, Tell, Timed, in_turn


class Report(ABC):
    """Measures part by part, and says what came of it."""

    name: str  # of its files
    template: ClassVar[str]  # of its page
    title: str
    #: Whether every call runs in the caller's thread (`jax_cpu_enable_async_dispatch` off), so that short programs are
    #: timed alike whether or not XLA counts them as cheap.
    one_thread: ClassVar[bool] = True
    effort: Mapping[str, Any] = MappingProxyType({})  # what is run, and how often it is repeated
    parts: Sequence[str]  # what is measured one after the other
    missing: Mapping[str, str] = MappingProxyType({})  # who cannot take part on this machine, and why
    versions: Mapping[str, str] = MappingProxyType({})  # of packages that take part beside the usual ones
    store: Store  # of its rows, once it runs

    @abstractmethod
    def measure(self, part: str, tell: Tell) -> None:
        """Put into the store what is not there yet."""

    def rows(self) -> list[Row]:
        """What this run is about, in order."""
        return [row for part in self.parts for row in self.store if row.group == part]

    @abstractmethod
    def bars(self, part: str) -> list[Row]:
        """What a part says of what was asked for: printed, and shown in documents by groups."""

    @abstractmethod
    def problems(self) -> list[str]:
        """What makes the run fail, a line each."""

    @abstractmethod
    def drawings(self) -> dict[str, Callable[[], bytes]]:
        """What draws the figures as SVG, by the name of the file; ImportError without matplotlib."""

    @abstractmethod
    def context(self) -> dict[str, Any]:
        """What the template needs beside what `run_report` gives to all."""


#: What a check gives: a number, or what was raised in place of one.
Outcome = float | Exception


class Absent(Exception):
    """What a check needs is not on this machine; the message says what."""


def needed(module: str, fix: str = "") -> Any:
    """A module that may not be installed. Raises Absent where it is not; the message ends with how to get it."""
    if importlib.util.find_spec(module) is None:
        raise Absent(f"not run: {module} is not installed{fix and f'; pip install {fix}'}")
    return importlib.import_module(module)


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


def apart(ends: Any, others: Any) -> float:
    """The largest difference of an entry; NaN if there is one."""
    # NumPy's maximum hands on NaN; Python's loses it.
    return float(np.max(jax.tree.leaves(jax.tree.map(lambda a, b: jnp.abs(a - b).max(), ends, others))))


def raced(
    ways: dict[str, Timed], bar: float, repeats: Repeats, read: Callable[[Any], Any] = lambda end: end
) -> dict[str, Timed]:
    """The same ways to one result, timed in turn, once what is read of their results agrees with the first."""
    first, *others = (read(way.result()) for way in ways.values())
    for other in others:
        agree(apart(other, first), bar)
    in_turn(list(ways.values()), repeats)
    return ways


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


#: One that the quick run leaves out.
slow = functools.partial(Check, slow=True)

_SILENT = "NaN OR INFINITE, AND NOTHING SAID SO"

#: The checks of a section, those that need it after a plain sentence that explains what comes of them. Its title, and
#: what its page says of it, stand in `sections.toml`.
Section = list[str | Check]

#: Tables longer than this are folded up, unless something is wrong.
_SHOWN = 14
#: Numbers of zero are drawn here.
_FLOOR = 1e-17


def explained(section: Section) -> Iterator[tuple[str, Check]]:
    """Each check after its sentence."""
    why = ""
    for each in section:
        if isinstance(each, str):
            why = each
        else:
            yield why, each


class Checked(Report):
    """Runs all checks of sections, or the fast ones. What its page says beside rows stands in `sections.toml`."""

    template = "checks"

    def __init__(self, name: str, sections: Mapping[str, Section], arguments: argparse.Namespace) -> None:
        self.name, self._quick, self._texts = name, arguments.quick, texts(name)
        self.title = self._texts["title"]
        self.parts = [each for each in sections if each in (arguments.only or sections)]
        self._checks = {part: list(explained(sections[part])) for part in self.parts}

    def measure(self, part: str, tell: Tell) -> None:
        checks = [check for _, check in self._checks[part] if not (self._quick and check.slow)]
        for i, check in enumerate(checks):
            row = self.store.get(part, check.what, check.by)
            # What was not run for want of something is tried again.
            if row is None or (row.holds is None and not row.done):
                tell(f"{check.what}, {check.by}", i / len(checks))
                self.store.add([check.run(part)])

    def _found(self, part: str) -> list[tuple[Row, str, Check]]:
        """The rows there are, each with its sentence and its check."""
        found = [(self.store.get(part, check.what, check.by), why, check) for why, check in self._checks[part]]
        return [(row, why, check) for row, why, check in found if row]

    def rows(self) -> list[Row]:
        return [row for part in self.parts for row in self.bars(part)]

    def bars(self, part: str) -> list[Row]:
        return [row for row, _, _ in self._found(part)]

    def problems(self) -> list[str]:
        return [f"{r.what} ({r.by}): {r.came}; asked for: {r.bar}" for r in self.rows() if r.holds is False]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        said = self._texts["sections"]
        placed = {part: [(row, check.place) for row, _, check in self._found(part)] for part in self.parts}
        return {
            f"{self.name}-{part}": functools.partial(draw, rows, said[part])
            for part, rows in placed.items()
            if rows and "axes" in said[part]
        }

    def context(self) -> dict[str, Any]:
        sections = [self._section(part) for part in self.parts if self._found(part)]
        return {"about": self._texts["about"], "note": self._texts["note"], "sections": sections}

    def _section(self, part: str) -> dict[str, Any]:
        said, rows = self._texts["sections"][part], self.bars(part)
        whys, wide = [why for _, why, _ in self._found(part)], said.get("wide", False)
        head, table, words = table_of(rows, wide)
        if any(whys) and not wide:
            head, words = [*head, "why"], words + 1
            table = [[*cells, why] for cells, why in zip(table, whys, strict=True)]
        folded = len(table) > _SHOWN and not any(row.holds is False for row in rows)
        found = {"name": f"{self.name}-{part}", "table": (head, table, words), "count": len(rows), "folded": folded}
        return {**said, **found, "reasons": list(filter(None, dict.fromkeys(whys))) if wide else []}


def draw(rows: Sequence[tuple[Row, tuple[str, float] | None]], said: Mapping[str, Any]) -> bytes:
    """The figure of a section as SVG, of rows with line and x; a cross at the upper edge where it ended early.

    Both axes are logarithmic, that of x not where things are counted.
    """
    figure = panels(said["title"], said["axes"])
    axes = figure.axes[0]
    lines: dict[str, list[tuple[float, float]]] = {}
    for row, place in rows:
        if place:
            lines.setdefault(place[0], []).append((place[1], row.value))
    top = 10.0 * max(value for value in (_FLOOR, *(row.value for row, _ in rows)) if math.isfinite(value))
    for i, (line, points) in enumerate(lines.items()):
        style: dict[str, Any] = {"color": f"C{i % 10}", "label": line}
        good = [(x, max(value, _FLOOR)) for x, value in points if math.isfinite(value)]
        ended = [x for x, value in points if not math.isfinite(value)]
        if good:
            axes.loglog(*zip(*good, strict=True), marker="osD^vP<>X*"[i % 10], ms=4.5, lw=1.5, **style)
            style.pop("label")
        if ended:
            axes.loglog(ended, [top] * len(ended), marker="x", ms=8, ls="", **style)
            axes.text(0.01, 0.985, "x: ends by name", transform=axes.transAxes, ha="left", va="top", fontsize=9)
    if said.get("counted", False):
        axes.set_xscale("linear")
    return as_svg(figure)
