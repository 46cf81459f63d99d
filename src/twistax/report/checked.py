"""A report made of sections of checks."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from typing import Any

from .checks import Place, Section, measure_section
from .pages.drawing import as_svg, panels
from .pages.page import section_table
from .progress import Tell
from .report import Report
from .rows import DONE, Row

__all__ = ["Checked"]

#: Tables longer than this are folded up, unless something is wrong.
_SHOWN = 14
#: Numbers of zero are drawn here.
_FLOOR = 1e-17


class Checked(Report):
    """Runs every check, or the fast ones with `--quick`.

    Args:
        name, title: see Report.
        about: a few sentences for the page.
        note: on how it was run.
        sections: all there are.
        tells_all: whether every row is printed, or what is wrong alone.
    """

    template = "checks"

    def __init__(
        self,
        arguments: argparse.Namespace,
        sections: Sequence[Section],
        *,
        name: str,
        title: str,
        about: str,
        note: str,
        tells_all: bool = False,
    ) -> None:
        self.name, self.title, self._about, self._note = name, title, about, note
        self._quick, self._tells_all = arguments.quick, tells_all
        self.sections = {each.name: each for each in sections if each.name in (arguments.only or (each.name,))}
        self.parts = list(self.sections)

    def measure(self, part: str, tell: Tell) -> None:
        measure_section(self.sections[part], self._quick, self.store, tell)

    def said(self, part: str) -> list[str]:
        rows = self.sections[part].rows(self.store)
        shown = rows if self._tells_all else [row for row in rows if row.holds is False]
        return [f"{f'{row.what}, {row.by}':<72} {row.came:<16} {row.bar:<20} {row.verdict}".rstrip() for row in shown]

    def rows(self) -> list[Row]:
        return [row for section in self.sections.values() for row in section.rows(self.store)]

    def bars(self) -> list[Row]:
        return self.rows()

    def conclusion(self) -> list[str]:
        # Printed section by section.
        return []

    def problems(self) -> list[str]:
        return [f"{r.what} ({r.by}): {r.came}; asked for: {r.bar}" for r in self.rows() if r.holds is False]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        return {
            f"{self.name}-{name}": lambda section=section: draw(section, section.rows(self.store))  # type: ignore[misc]
            for name, section in self.sections.items()
            if section.axes and section.rows(self.store)
        }

    def context(self) -> dict[str, Any]:
        rows = self.rows()
        return {
            "about": self._about,
            "notes": [self._note],
            "count": len(rows),
            "missed": sum(row.holds is False for row in rows),
            "not_run": sum(row.holds is None and not row.done for row in rows),
            "silent": sum(row.note.startswith("NaN") for row in rows),
            "sections": [self._section(each) for each in self.sections.values() if each.rows(self.store)],
        }

    def _section(self, section: Section) -> dict[str, Any]:
        rows = section.rows(self.store)
        head, table, words = section_table(rows, section.wide)
        whys = {section.key(check): why for why, check in section}
        reasons = [why for why in section.reasons if why] if section.wide else []
        if not section.wide and any(whys.values()):
            head, words = [*head, "why"], words + 1
            table = [[*cells, whys[row.key]] for cells, row in zip(table, rows, strict=True)]
        missed = sum(row.holds is False for row in rows)
        return {
            "name": f"{self.name}-{section.name}",
            "title": section.title,
            "about": section.about,
            "table": (head, table, words),
            "reasons": reasons,
            "folded": len(table) > _SHOWN and not missed,
            "summary": f"{len(rows)} rows, {f'{missed} of them MISSED' if missed else 'none missed'}",
        }


def draw(section: Section, rows: Sequence[Row]) -> bytes:
    """The figure of a section as SVG, a cross at the upper edge where an integration ended early.

    Raises:
        ImportError: matplotlib is not installed.
    """
    figure = panels(section.title, section.axes or ("", ""))
    axes = figure.axes[0]
    found = {row.key: row for row in rows}
    placed: list[tuple[Place, Row]] = [
        (check.place, found[section.key(check)]) for _, check in section if check.place and section.key(check) in found
    ]
    top = 10.0 * max([_FLOOR, *(row.value for _, row in placed if row.note == DONE)])
    for number, line in enumerate(dict.fromkeys(place.line for place, _ in placed)):
        style: dict[str, Any] = {"color": f"C{number % 10}", "label": line}
        points = [(place.x, row.value) for place, row in placed if place.line == line]
        good = [(x, max(value, _FLOOR)) for x, value in points if math.isfinite(value)]
        ended = [x for x, value in points if not math.isfinite(value)]
        if good:
            axes.loglog(*zip(*good, strict=True), marker="osD^vP<>X*"[number % 10], ms=4.5, lw=1.5, **style)
            style.pop("label")
        if ended:
            axes.loglog(ended, [top] * len(ended), marker="x", ms=8, ls="", **style)
            axes.text(0.01, 0.985, "x: ends by name", transform=axes.transAxes, ha="left", va="top", fontsize=9)
    return as_svg(figure)
