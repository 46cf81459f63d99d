"""The page of speed: its tables, its figures, and what its template is told."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

from ..pages.drawing import as_svg, panels
from ..pages.page import Table, bar_table, duration
from ..rows import Row
from .case import CASES
from .contender import PLAIN, Contender
from .measure import AGREEMENT, Effort
from .programs import QUANTITIES, Quantity

__all__ = ["BASES", "context", "draw"]

#: Ratios are to these.
BASES = (PLAIN.name, "CasADi C")


def context(
    rows: Sequence[Row],
    contenders: Sequence[Contender],
    bars: Sequence[Row],
    missing: Mapping[str, str],
    effort: Effort,
    empty_call: float,
) -> dict[str, Any]:
    """What the template needs.

    Args:
        contenders: in the order of the tables.
        bars: judged.
        missing: contenders that are not on this machine, and why.
        empty_call: what a call of a compiled function costs that does nothing, s.
    """
    present = {row.by for row in rows}
    wrong = [row for row in rows if row.note.startswith("disagrees")]
    return {
        "bases": BASES,
        "agreement": f"{AGREEMENT:g}",
        "wrong": "; ".join(f"{row.by} on {row.group}, {row.what}, {row.setting} {row.note}" for row in wrong),
        "missing": [f"**{name} is absent**: {reason}." for name, reason in missing.items()],
        "quantities": [_quantity(rows, quantity, contenders) for quantity in QUANTITIES],
        "bars": bar_table(bars),
        "missed": sum(bar.holds is False for bar in bars),
        "bar_count": len(bars),
        "effort": effort,
        "usable": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "empty_call": duration(empty_call),
        "contenders": (
            ["contender", "how"],
            [[each.name, each.how] for each in contenders if each.name in present],
            2,
        ),
    }


def _quantity(rows: Sequence[Row], quantity: Quantity, contenders: Sequence[Contender]) -> dict[str, Any]:
    """Its tables: ratios, times and seconds to compile; and why some are missing."""
    own = [row for row in rows if row.what == quantity.name]
    done = {row.by for row in own if row.done}
    names = [each.name for each in contenders if each.name in done]
    others = [name for name in names if name not in BASES]
    found = {(row.group, row.setting, row.by): row for row in own}
    places = list(dict.fromkeys((row.group, row.setting) for row in own))

    def table(columns: Sequence[str], cell: Any) -> Table:
        cells = [[CASES[case].title, use, *(cell(case, use, name) for name in columns)] for case, use in places]
        return ["function", "use", *columns], cells, 2

    def seconds(case: str, use: str, name: str) -> float:
        row = found.get((case, use, name))
        return row.value if row else math.nan

    def ratios(case: str, use: str, name: str) -> str:
        return " / ".join(_ratio(seconds(case, use, name) / seconds(case, use, base)) for base in BASES)

    notes = {f"{row.by}, {CASES[row.group].title}: {row.note}." for row in own if not row.done}
    return {
        "name": quantity.name,
        "title": quantity.title[:1].upper() + quantity.title[1:],
        "ratios": table(others, ratios) if others else None,
        "times": table(names, lambda *place: _spread(found.get(place))) if names else None,
        "compiling": table(names, lambda *place: _compiled(found.get(place))),
        "notes": sorted(notes),
    }


def _ratio(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value >= 0.095 else f"{value:.3f}"


def _spread(row: Row | None) -> str:
    if row is None or not row.done:
        return "-"
    lower, upper = row.numbers["lower"], row.numbers["upper"]
    return f"{_nanoseconds(row.value)} ({_nanoseconds(lower)} to {_nanoseconds(upper)})"


def _nanoseconds(seconds: float) -> str:
    """Three digits, as the unit stays the same in a table: 1,230 ns."""
    value = 1e9 * seconds
    digits = max(0, 2 - math.floor(math.log10(value)))
    return f"{value:,.{digits}f} ns" if value < 1e6 else duration(seconds)


def _compiled(row: Row | None) -> str:
    seconds = row.numbers.get("compile_seconds", math.nan) if row else math.nan
    return f"{seconds:.2f}" if math.isfinite(seconds) else "-"


def draw(rows: Sequence[Row], quantity: Quantity, contenders: Sequence[Contender]) -> bytes:
    """The figure of a quantity as SVG; dots at the median, lines between the quartiles.

    Raises:
        ImportError: matplotlib is not installed.
    """
    timed = [row for row in rows if row.what == quantity.name and row.done]
    cases = [case for name, case in CASES.items() if any(row.group == name for row in timed)]
    uses = list(dict.fromkeys(row.setting for row in timed))
    shown = [each for each in contenders if any(row.by == each.name for row in timed)]
    size = (7.4, 0.9 + len(cases) * (0.5 + 0.33 * len(uses)))
    figure = panels("", ("time of one evaluation, us (to the left: faster)", ""), size, count=len(cases))
    for axes, case in zip(figure.axes, cases, strict=True):
        for number, contender in enumerate(shown):
            style: dict[str, Any] = {"color": contender.colour}
            axes.plot([], [], marker="o", ls="", label=contender.name, **style)
            for row in (row for row in timed if (row.group, row.by) == (case.name, contender.name)):
                height = uses.index(row.setting) + 0.7 * ((number + 0.5) / len(shown) - 0.5)
                axes.plot([1e6 * row.numbers["lower"], 1e6 * row.numbers["upper"]], [height, height], lw=2.0, **style)
                axes.plot([1e6 * row.value], [height], marker="o", ms=5, ls="", **style)
        axes.set_xscale("log")
        axes.set_yticks(range(len(uses)), uses)
        axes.invert_yaxis()
        axes.set_title(case.title, fontsize=11, loc="left")
    return as_svg(figure, columns=4)
