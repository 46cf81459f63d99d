"""What all reports have in common, and the report that is made of sections of checks."""

from __future__ import annotations

import argparse
import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

from .checks import Section
from .page import as_svg, panels, table_of, texts
from .rows import Row, Store
from .timing import Tell


class Report(ABC):
    """Measures part by part, and says what came of it.

    Attributes:
        name: of its files.
        template: of its page.
        title: of its page.
        one_thread: whether every call runs in the caller's thread (`jax_cpu_enable_async_dispatch` off), so that short
            programs are timed alike whether or not XLA counts them as cheap.
        effort: what is run, and how often it is repeated.
        parts: what is measured one after the other.
        missing: who cannot take part on this machine, and why.
        versions: of packages that take part beside the usual ones.
        store: of its rows, once it runs.
    """

    name: str
    template: ClassVar[str]
    title: str
    one_thread: ClassVar[bool] = True
    effort: Mapping[str, Any] = MappingProxyType({})
    parts: Sequence[str]
    missing: Mapping[str, str] = MappingProxyType({})
    versions: Mapping[str, str] = MappingProxyType({})
    store: Store

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


# ---- a report made of checks ----------------------------------------------------------------------------------------

#: Tables longer than this are folded up, unless something is wrong.
_SHOWN = 14
#: Numbers of zero are drawn here.
_FLOOR = 1e-17


class Checked(Report):
    """Runs every check, or the fast ones with `--quick`. What its page says beside rows stands in `sections.toml`.

    Args:
        name: see Report.
        sections: all there are.
    """

    template = "checks"

    def __init__(self, name: str, sections: Sequence[Section], arguments: argparse.Namespace) -> None:
        self.name, self._quick, self._texts = name, arguments.quick, texts(name)
        self.title = self._texts["title"]
        self._sections = {each.name: each for each in sections if each.name in (arguments.only or (each.name,))}
        self.parts = list(self._sections)

    def measure(self, part: str, tell: Tell) -> None:
        section = self._sections[part]
        checks = [check for _, check in section if not (self._quick and check.slow)]
        for i, check in enumerate(checks):
            row = self.store.get(*section.key(check))
            # What was not run for want of something is tried again.
            if row is None or (row.holds is None and not row.done):
                tell(check.what, i / len(checks))
                self.store.add([check.run(section.name)])

    def _rows(self, section: Section) -> list[Row]:
        return [row for _, check in section if (row := self.store.get(*section.key(check)))]

    def rows(self) -> list[Row]:
        return [row for section in self._sections.values() for row in self._rows(section)]

    def bars(self, part: str) -> list[Row]:
        return self._rows(self._sections[part])

    def problems(self) -> list[str]:
        return [f"{r.what} ({r.by}): {r.came}; asked for: {r.bar}" for r in self.rows() if r.holds is False]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        return {
            f"{self.name}-{name}": functools.partial(draw, section, self._rows(section), self._texts["sections"][name])
            for name, section in self._sections.items()
            if section.axes and self._rows(section)
        }

    def context(self) -> dict[str, Any]:
        rows = self.rows()
        return {
            "about": self._texts["about"],
            "note": self._texts["note"],
            "not_run": sum(row.holds is None and not row.done for row in rows),
            "silent": sum(row.note.startswith("NaN") for row in rows),
            "sections": [self._section(each) for each in self._sections.values() if self._rows(each)],
        }

    def _section(self, section: Section) -> dict[str, Any]:
        rows = self._rows(section)
        head, table, words = table_of(rows, section.wide)
        whys = {section.key(check): why for why, check in section}
        if not section.wide and any(whys.values()):
            head, words = [*head, "why"], words + 1
            table = [[*cells, whys[row.key]] for cells, row in zip(table, rows, strict=True)]
        return {
            **self._texts["sections"][section.name],
            "name": f"{self.name}-{section.name}",
            "table": (head, table, words),
            "reasons": list(filter(None, dict.fromkeys(whys.values()))) if section.wide else [],
            "long": len(table) > _SHOWN,
            "count": len(rows),
            "missed": sum(row.holds is False for row in rows),
        }


def draw(section: Section, rows: Sequence[Row], said: Mapping[str, str]) -> bytes:
    """The figure of a section as SVG, a cross at the upper edge where an integration ended early.

    Raises:
        ImportError: matplotlib is not installed.
    """
    figure = panels(said["title"], section.axes or ("", ""))
    axes = figure.axes[0]
    found = {row.key: row.value for row in rows}
    lines: dict[str, list[tuple[float, float]]] = {}
    for _, check in section:
        if check.place and section.key(check) in found:
            line, x = check.place
            lines.setdefault(line, []).append((x, found[section.key(check)]))
    top = 10.0 * max(value for value in (_FLOOR, *found.values()) if math.isfinite(value))
    for number, (line, points) in enumerate(lines.items()):
        style: dict[str, Any] = {"color": f"C{number % 10}", "label": line}
        good = [(x, max(value, _FLOOR)) for x, value in points if math.isfinite(value)]
        ended = [x for x, value in points if not math.isfinite(value)]
        if good:
            axes.loglog(*zip(*good, strict=True), marker="osD^vP<>X*"[number % 10], ms=4.5, lw=1.5, **style)
            style.pop("label")
        if ended:
            axes.loglog(ended, [top] * len(ended), marker="x", ms=8, ls="", **style)
            axes.text(0.01, 0.985, "x: ends by name", transform=axes.transAxes, ha="left", va="top", fontsize=9)
    return as_svg(figure)
