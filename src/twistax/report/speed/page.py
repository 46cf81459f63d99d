"""`python -m twistax report --speed`: what is compared and timed, what we want of it, what its page is told."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import math
import subprocess
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...trajectory.strategy.batch import processors
from ..checks import Report, at_most, judged
from ..page import Table, as_svg, duration, panels, texts
from ..rows import Row, Store, first_line, now
from ..timing import Repeats, Tell, Timed, empty_call_seconds, keep, quiet, within
from .cases import CASES, Case
from .contenders import ALL, CASADI, PLAIN, QUANTITIES, USES, Contender, Lacks, Quantity, Task, Use, values

#: The largest difference from the reference with which a contender is timed.
AGREEMENT = 1e-9


@dataclasses.dataclass(frozen=True)
class Effort:
    """What is run, and how often it is repeated."""

    name: str  # for the page
    cases: tuple[str, ...]  # names of those that are run if none is asked for; empty for all
    quantities: tuple[str, ...]  # the same
    largest: int  # batches of more points are left out
    longest: float  # a call that takes longer, s, is timed once; left out if a smaller batch says so before
    patience: float  # where compiling takes longer, s, further uses of the same are left out
    repeats: Repeats  # of every call of a group, in turn


FULL = Effort("full", (), (), 65536, 10.0, 150.0, Repeats(31, 3, 0.5))
QUICK = Effort("quick", ("free-body", "aba-7"), ("value",), 4096, 1.0, 60.0, Repeats(15, 3, 0.1))


def measure(
    case: Case,
    quantity: Quantity,
    uses: Sequence[Use],
    contenders: Sequence[Contender],
    effort: Effort,
    store: Store,
    tell: Tell = quiet,
) -> None:
    """Rows of all uses, kept use by use; those that are there already are not measured again.

    The first contender that has the task is the reference.
    """
    tasks: dict[str, Task] = {}
    for number, use in enumerate(uses):
        if all(store.get(case.name, quantity.name, each.name, use.name) for each in contenders):
            continue
        told = within(tell, number, len(uses), f"{quantity.name}, {use.name}: ")
        pairs: list[tuple[Row, Timed | None]] = []
        reference, sitting = None, now()
        for i, contender in enumerate(contenders):
            told(f"compiling {contender.name}", 0.5 * i / len(contenders))
            row = Row(case.name, quantity.name, contender.name, use.name, unit="s", sitting=sitting)
            smaller = [store.get(*row.key[:3], other.name) for other in uses if 0 < other.count < use.count]
            wait = max((row.value * use.count for row in smaller if row is not None and row.done), default=0.0)
            try:
                if wait > effort.longest:
                    raise Lacks(f"a call would take {wait:.0f} s")
                # Made once for all uses, and refused once.
                if contender.name not in tasks:
                    tasks[contender.name] = contender.task(case, quantity)
                if isinstance(task := tasks[contender.name], Lacks):
                    raise task
                timed = use.of(task)
                result = values(timed)
            except Lacks as error:
                tasks.setdefault(contender.name, error)
                pairs.append((dataclasses.replace(row, note=str(error)), None))
                continue
            except (RuntimeError, MemoryError, subprocess.SubprocessError) as error:  # of a compiler, or no memory
                pairs.append((dataclasses.replace(row, note=f"failed: {first_line(error)[:120]}"), None))
                continue
            if timed.compile_seconds > effort.patience:
                tasks[contender.name] = Lacks(f"compiling another use took {timed.compile_seconds:.0f} s")
            reference = result if reference is None else reference
            off = apart(result, reference, len(quantity.shape(case)))
            numbers = {"evaluations": float(timed.evaluations), "compile_seconds": timed.compile_seconds}
            note = row.note if off <= AGREEMENT else f"disagrees by {off:.0e}"
            pairs.append((dataclasses.replace(row, note=note, numbers={"difference": off, **numbers}), timed))
            if timed.rough > effort.longest:
                timed.samples.append(timed.rough)
        keep(pairs, effort.repeats, store, told)


def apart(found: NDArray[np.float64], reference: NDArray[np.float64], rank: int) -> float:
    """The largest difference of entries over the largest of the reference, the worst of all points.

    Infinite where shapes differ or something is not finite. The rank is that of one result.
    """
    if found.shape != reference.shape or not np.all(np.isfinite(found)):
        return math.inf
    axes = tuple(range(found.ndim - rank, found.ndim))
    return float(np.max(np.max(np.abs(found - reference), axis=axes) / np.max(np.abs(reference), axis=axes)))


#: Ratios are to these.
_BASES = (PLAIN.name, CASADI.name)

#: What we want to be true, said beforehand: of a case, quantity and use the median time of a contender over that of
#: another is at most so much; seconds to compile if there is no other.
_BARS = json.loads(Path(__file__).with_name("bars.json").read_text())


def bar_rows(rows: Sequence[Row], case: str) -> list[Row]:
    """Every bar of a case that was run with its quantity and use."""
    found = {row.key: row for row in rows if row.done}
    result = []
    for place, quantity, use, name, against, limit in _BARS:
        if place != case or not any((*key[:2], key[3]) == (case, quantity, use) for key in found):
            continue
        own, other = (found.get((case, quantity, each, use)) for each in (name, against))
        if against is None:
            value, setting, unit = own.numbers["compile_seconds"] if own else math.nan, "compiling", "s"
        else:
            value, setting, unit = own.value / other.value if own and other else math.nan, f"over {against}", ""
        row = Row("bars", f"{CASES[case].title}, {quantity}, {use}", name, setting, value)
        result.append(judged(row, at_most(limit, unit)))
    return result


class Speed(Report):
    name, template, title = "speed", "speed", "What does one evaluation cost?"
    # Everything as it comes: nothing is set but x64.
    one_thread = False

    def __init__(self, arguments: argparse.Namespace, contenders: Sequence[Contender] = ALL) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self.missing = {each.name: why for each in contenders if (why := each.absent()) is not None}
        self._contenders = [each for each in contenders if each.name not in self.missing]
        self.versions = {each.package: metadata.version(each.package) for each in self._contenders if each.package}
        self.parts = [name for name in CASES if name in (arguments.case or self._effort.cases or CASES)]

    def measure(self, part: str, tell: Tell) -> None:
        quantities = [each for each in QUANTITIES if each.name in (self._effort.quantities or (each.name,))]
        uses = [use for use in USES if use.count <= self._effort.largest]
        for number, quantity in enumerate(quantities):
            told = within(tell, number, len(quantities))
            measure(CASES[part], quantity, uses, self._contenders, self._effort, self.store, told)

    def rows(self) -> list[Row]:
        present = {each.name for each in self._contenders}
        return [row for row in super().rows() if row.by in present]

    def bars(self, part: str) -> list[Row]:
        return bar_rows(self.rows(), part)

    def _wrong(self) -> list[Row]:
        return [row for row in self.rows() if row.note.startswith("disagrees")]

    def problems(self) -> list[str]:
        return [f"{row.by} {row.note}: {row.group} {row.what} {row.setting}" for row in self._wrong()]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        timed: dict[str, list[Row]] = {}
        for row in self.rows():
            if row.done:
                timed.setdefault(f"speed-{row.what}", []).append(row)
        return {name: functools.partial(draw, rows, self._contenders) for name, rows in timed.items()}

    def context(self) -> dict[str, Any]:
        rows = self.rows()
        present = {row.by for row in rows}
        return {
            "bases": _BASES,
            "agreement": AGREEMENT,
            "wrong": self._wrong(),
            "quantities": [_quantity(rows, quantity, self._contenders) for quantity in QUANTITIES],
            "usable": processors(),
            "empty_call": empty_call_seconds(),
            "contenders": [[name, how] for name, how in texts("speed")["contenders"].items() if name in present],
        }


def _quantity(rows: Sequence[Row], quantity: Quantity, contenders: Sequence[Contender]) -> dict[str, Any]:
    """Its tables: ratios, times and seconds to compile; and why some are missing."""
    found = {(row.group, row.setting, row.by): row for row in rows if row.what == quantity.name}
    done = {row.by for row in found.values() if row.done}
    names = [each.name for each in contenders if each.name in done]
    others = [name for name in names if name not in _BASES]

    def table(columns: Sequence[str], cell: Callable[[Row], str]) -> Table:
        places = dict.fromkeys(place[:2] for place in found)
        cells = [[((row := found.get((*place, name))) and cell(row)) or "-" for name in columns] for place in places]
        heads = [[CASES[case].title, use] for case, use in places]
        return ["function", "use", *columns], [[*head, *line] for head, line in zip(heads, cells, strict=True)], 2

    def ratios(row: Row) -> str:
        bases = [found.get((row.group, row.setting, name)) for name in _BASES]
        over = [row.value / base.value if base else math.nan for base in bases]
        return " / ".join(_digits(ratio, 2 if ratio >= 0.095 else 3) for ratio in over)

    def spread(row: Row) -> str:
        return f"{_ns(row.value)} ({_ns(row.numbers['lower'])} to {_ns(row.numbers['upper'])})" if row.done else "-"

    return {
        "name": quantity.name,
        "title": quantity.title[:1].upper() + quantity.title[1:],
        "ratios": table(others, ratios) if others else None,
        "times": table(names, spread) if names else None,
        "compiling": table(names, lambda row: _digits(row.numbers.get("compile_seconds", math.nan), 2)),
        "notes": sorted({f"{row.by}, {CASES[row.group].title}: {row.note}." for row in found.values() if not row.done}),
    }


def _digits(value: float, digits: int) -> str:
    return f"{value:,.{digits}f}" if math.isfinite(value) else "-"


def _ns(seconds: float) -> str:
    """Three digits, as the unit stays the same in a table: 1,230 ns."""
    value = 1e9 * seconds
    return f"{_digits(value, max(0, 2 - math.floor(math.log10(value))))} ns" if value < 1e6 else duration(seconds)


def draw(timed: Sequence[Row], contenders: Sequence[Contender]) -> bytes:
    """The figure of a quantity as SVG; dots at the median, lines between the quartiles."""
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
