"""`python -m twistax report --speed`: what is run, what we want to be true of it, and what its page is told."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
import os
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any, NamedTuple

from ..checks import at_most, judged
from ..page import Table, as_svg, duration, panels
from ..report import Report
from ..rows import Row
from ..timing import Tell, empty_call_seconds
from .casadi import CASADI
from .case import CASES
from .contenders import ARRAYS, NATIVE, OPENSCVX, PINOCCHIO, PLAIN, SCALARS, Contender
from .measure import AGREEMENT, FULL, QUICK, measure
from .programs import JACOBIAN, LOOP, QUANTITIES, USES, VALUE, Quantity, batch

_CONTENDERS = (SCALARS, NATIVE, ARRAYS, PLAIN, OPENSCVX, CASADI, PINOCCHIO)
#: Ratios are to these.
_BASES = (PLAIN.name, CASADI.name)

# ---- bars: what we want to be true, said beforehand -----------------------------------------------------------------


class _Bar(NamedTuple):
    """Median time of a contender over that of another, at most `limit`; seconds to compile if `against` is None."""

    case: str
    quantity: Quantity
    use: str
    contender: Contender
    against: Contender | None
    limit: float


_MANY = batch(4096).name
_BARS = (
    _Bar("aba-7", VALUE, LOOP.name, SCALARS, PLAIN, 0.2),
    _Bar("aba-7", VALUE, _MANY, SCALARS, PLAIN, 0.5),
    _Bar("free-body", VALUE, LOOP.name, SCALARS, OPENSCVX, 1.0),
    _Bar("aba-7", VALUE, LOOP.name, SCALARS, None, 1.0),
    _Bar("aba-30", VALUE, LOOP.name, SCALARS, None, 7.0),
    _Bar("aba-7", VALUE, _MANY, NATIVE, CASADI, 0.15),
    _Bar("aba-7", VALUE, _MANY, NATIVE, PLAIN, 0.03),
    _Bar("rnea-7", VALUE, _MANY, NATIVE, CASADI, 0.15),
    _Bar("free-body", VALUE, _MANY, NATIVE, CASADI, 0.4),
    _Bar("aba-7", JACOBIAN, _MANY, NATIVE, CASADI, 0.2),
    _Bar("aba-7", VALUE, LOOP.name, NATIVE, CASADI, 1.2),
)


def bar_rows(rows: Sequence[Row], case: str) -> list[Row]:
    """Every bar of a case that was run with its quantity and use."""
    found = {row.key: row for row in rows if row.done}
    result = []
    for bar in _BARS:
        quantity, use, value, setting, unit = bar.quantity.name, bar.use, math.nan, "compiling", "s"
        if bar.case != case or not any((*key[:2], key[3]) == (case, quantity, use) for key in found):
            continue
        own = found.get((case, quantity, bar.contender.name, use))
        if bar.against is None:
            value = own.numbers["compile_seconds"] if own else math.nan
        else:
            other = found.get((case, quantity, bar.against.name, use))
            value, setting, unit = (
                own.value / other.value if own and other else math.nan,
                f"over {bar.against.name}",
                "",
            )
        row = Row("bars", f"{CASES[case].title}, {quantity}, {use}", bar.contender.name, setting, value)
        result.append(judged(row, at_most(bar.limit, unit)))
    return result


class Speed(Report):
    name, template, title = "speed", "speed", "What does one evaluation cost?"
    # Everything as it comes: nothing is set but x64.
    one_thread = False

    def __init__(self, arguments: argparse.Namespace, contenders: Sequence[Contender] = _CONTENDERS) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self.missing = {each.name: why for each in contenders if (why := each.absent()) is not None}
        self._contenders = [each for each in contenders if each.name not in self.missing]
        self.versions = {name: metadata.version(name) for each in self._contenders for name, _ in each.packages}
        self.parts = [name for name in CASES if name in (arguments.case or self._effort.cases or CASES)]

    def measure(self, part: str, tell: Tell) -> None:
        quantities = [each for each in QUANTITIES if each.name in (self._effort.quantities or (each.name,))]
        uses = [use for use in USES if use.count <= self._effort.largest]
        for number, quantity in enumerate(quantities):

            def told(what: str, share: float, number: int = number) -> None:
                tell(what, (number + share) / len(quantities))

            measure(CASES[part], quantity, uses, self._contenders, self._effort, self.store, told)

    def rows(self) -> list[Row]:
        present = {each.name for each in self._contenders}
        return [row for row in super().rows() if row.by in present]

    def _wrong(self) -> list[Row]:
        return [row for row in self.rows() if row.note.startswith("disagrees")]

    def bars(self, part: str) -> list[Row]:
        return bar_rows(self.rows(), part)

    def problems(self) -> list[str]:
        return [f"{row.by} {row.note}: {row.group} {row.what} {row.setting}" for row in self._wrong()]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        rows = self.rows()
        timed = {row.what for row in rows if row.done}
        drawn = [each for each in QUANTITIES if each.name in timed]
        return {f"speed-{each.name}": functools.partial(draw, rows, each, self._contenders) for each in drawn}

    def context(self) -> dict[str, Any]:
        rows = self.rows()
        present = {row.by for row in rows}
        return {
            "bases": _BASES,
            "agreement": AGREEMENT,
            "wrong": self._wrong(),
            "quantities": [_quantity(rows, quantity, self._contenders) for quantity in QUANTITIES],
            "usable": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
            "empty_call": empty_call_seconds(),
            "contenders": [[each.name, each.how] for each in self._contenders if each.name in present],
        }


report = Speed


# ---- tables and figures ---------------------------------------------------------------------------------------------


def _quantity(rows: Sequence[Row], quantity: Quantity, contenders: Sequence[Contender]) -> dict[str, Any]:
    """Its tables: ratios, times and seconds to compile; and why some are missing."""
    own = [row for row in rows if row.what == quantity.name]
    done = {row.by for row in own if row.done}
    names = [each.name for each in contenders if each.name in done]
    others = [name for name in names if name not in _BASES]
    found = {(row.group, row.setting, row.by): row for row in own}
    places = list(dict.fromkeys((row.group, row.setting) for row in own))

    def table(columns: Sequence[str], cell: Callable[[str, str, str], str]) -> Table:
        cells = [[CASES[case].title, use, *(cell(case, use, name) for name in columns)] for case, use in places]
        return ["function", "use", *columns], cells, 2

    def ratios(case: str, use: str, name: str) -> str:
        times = [row.value if (row := found.get((case, use, each))) else math.nan for each in (name, *_BASES)]
        return " / ".join(_ratio(times[0] / base) for base in times[1:])

    return {
        "name": quantity.name,
        "title": quantity.title[:1].upper() + quantity.title[1:],
        "ratios": table(others, ratios) if others else None,
        "times": table(names, lambda *place: _spread(found.get(place))) if names else None,
        "compiling": table(names, lambda *place: _compiled(found.get(place))),
        "notes": sorted({f"{row.by}, {CASES[row.group].title}: {row.note}." for row in own if not row.done}),
    }


def _ratio(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value >= 0.095 else f"{value:.3f}"


def _spread(row: Row | None) -> str:
    if row is None or not row.done:
        return "-"
    return f"{_ns(row.value)} ({_ns(row.numbers['lower'])} to {_ns(row.numbers['upper'])})"


def _ns(seconds: float) -> str:
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
