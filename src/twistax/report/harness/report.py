"""Reports: parts that are measured one after another, compared with their limits, drawn and written as a page."""

import argparse
import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

from .measurement import MeasuredCase, Section, explained
from .page import as_svg, panels, table_of, texts
from .rows import ReportRow
from .store import Store
from .timing import ProgressCallback


class Report(ABC):
    """Measurements in parts, and their page."""

    name: str  # of its files
    template: ClassVar[str]  # of its page
    title: str
    #: Whether every call runs in the caller's thread (`jax_cpu_enable_async_dispatch` off), so that short programs are
    #: timed alike whether or not XLA counts them as cheap.
    one_thread: ClassVar[bool] = True
    effort: Mapping[str, Any] = MappingProxyType({})  # what is run, and the number of repetitions
    parts: Sequence[str]  # their names, in the order of measurement
    missing: Mapping[str, str] = MappingProxyType({})  # packages that cannot run on this machine, and why
    versions: Mapping[str, str] = MappingProxyType({})  # of packages beside the usual ones
    store: Store  # of its rows, while it runs

    @abstractmethod
    def measure(self, part: str, progress: ProgressCallback) -> None:
        """Measure the rows of a part that the store does not have, and add them to it."""

    def rows(self) -> list[ReportRow]:
        """The rows of this run, in order."""
        return [row for part in self.parts for row in self.store if row.group == part]

    @abstractmethod
    def bars(self, part: str) -> list[ReportRow]:
        """The rows of a part with their bars, as they are printed and written into pages."""

    @abstractmethod
    def problems(self) -> list[str]:
        """The reasons why the run fails, a line each."""

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        """Functions that draw the figures as SVG, by file name. They raise ImportError without matplotlib."""
        return {}

    @abstractmethod
    def context(self) -> dict[str, Any]:
        """The values of the template beside those that `run_report` adds."""


#: Longer tables are folded, unless a bar is missed.
_SHOWN = 14
#: Zeros are drawn here.
_FLOOR = 1e-17


class SectionReport(Report):
    """A report of sections: runs all of their measurements, or the quick ones."""

    template = "checks"

    def __init__(self, name: str, sections: Mapping[str, Section], arguments: argparse.Namespace) -> None:
        self.name, self._quick, self._texts = name, arguments.quick, texts(name)
        self.title = self._texts["title"]
        self.parts = [part for part in sections if part in (arguments.only or sections)]
        self._sections = {part: list(explained(sections[part])) for part in self.parts}

    def measure(self, part: str, progress: ProgressCallback) -> None:
        measurements = [it for _, it in self._sections[part] if not (self._quick and it.slow)]
        for i, it in enumerate(measurements):
            row = self.store.get(part, it.what, it.by)
            # Rows that could not run because something was missing are tried again.
            if row is None or (row.holds is None and not row.done):
                progress(f"{it.what}, {it.by}", i / len(measurements))
                self.store.add([it.run(part)])

    def _measured(self, part: str) -> list[tuple[ReportRow, str, MeasuredCase]]:
        """The rows there are, each with its sentence and its measurement."""
        rows = [(self.store.get(part, it.what, it.by), why, it) for why, it in self._sections[part]]
        return [(row, why, it) for row, why, it in rows if row]

    def rows(self) -> list[ReportRow]:
        return [row for part in self.parts for row in self.bars(part)]

    def bars(self, part: str) -> list[ReportRow]:
        return [row for row, _, _ in self._measured(part)]

    def problems(self) -> list[str]:
        return [f"{r.what} ({r.by}): {r.came}; asked for: {r.bar}" for r in self.rows() if r.holds is False]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        about = self._texts["sections"]
        placed = {part: [(row, it.place) for row, _, it in self._measured(part)] for part in self.parts}
        return {
            f"{self.name}-{part}": functools.partial(draw, rows, about[part])
            for part, rows in placed.items()
            if rows and "axes" in about[part]
        }

    def context(self) -> dict[str, Any]:
        sections = [self._section(part) for part in self.parts if self._measured(part)]
        return {"about": self._texts["about"], "note": self._texts["note"], "sections": sections}

    def _section(self, part: str) -> dict[str, Any]:
        about, rows = self._texts["sections"][part], self.bars(part)
        whys, wide = [why for _, why, _ in self._measured(part)], about.get("wide", False)
        head, table, words = table_of(rows, wide)
        if any(whys) and not wide:
            head, words = [*head, "why"], words + 1
            table = [[*cells, why] for cells, why in zip(table, whys, strict=True)]
        folded = len(table) > _SHOWN and not any(row.holds is False for row in rows)
        values = {"name": f"{self.name}-{part}", "table": (head, table, words), "count": len(rows), "folded": folded}
        return {**about, **values, "reasons": list(filter(None, dict.fromkeys(whys))) if wide else []}


def draw(rows: Sequence[tuple[ReportRow, tuple[str, float] | None]], about: Mapping[str, Any]) -> bytes:
    """The figure of a section as SVG, of rows with line and x; a cross at the upper edge where it ended early.

    Both axes are logarithmic, that of x not where things are counted.
    """
    figure = panels(about["title"], about["axes"])
    axes = figure.axes[0]
    lines: dict[str, list[tuple[float, float]]] = {}
    for row, place in rows:
        if place:
            lines.setdefault(place[0], []).append((place[1], row.value))
    top = 10.0 * max(value for value in (_FLOOR, *(row.value for row, _ in rows)) if math.isfinite(value))
    for i, (line, points) in enumerate(lines.items()):
        style: dict[str, Any] = {"color": f"C{i % 10}", "label": line}
        finite = [(x, max(value, _FLOOR)) for x, value in points if math.isfinite(value)]
        ended = [x for x, value in points if not math.isfinite(value)]
        if finite:
            axes.loglog(*zip(*finite, strict=True), marker="osD^vP<>X*"[i % 10], ms=4.5, lw=1.5, **style)
            style.pop("label")
        if ended:
            axes.loglog(ended, [top] * len(ended), marker="x", ms=8, ls="", **style)
            axes.text(0.01, 0.985, "x: ends by name", transform=axes.transAxes, ha="left", va="top", fontsize=9)
    if about.get("counted", False):
        axes.set_xscale("linear")
    return as_svg(figure)
