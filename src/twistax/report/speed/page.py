"""`python -m twistax report --speed`: its comparisons, its bars, and the tables and figures of its page."""

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

from ...trajectory.strategy.batch import processors
from ..harness.expected import at_most, judged
from ..harness.page import Table, as_svg, panels, texts
from ..harness.report import Report
from ..harness.rows import ReportRow, duration, first_line, now
from ..harness.store import Store
from ..harness.timing import ProgressCallback, Repeats, Timed, empty_call_seconds, keep, quiet, within
from .cases import CASES, EvaluatedFunction
from .contenders import (
    PLAIN,
    QUANTITIES,
    USES,
    Contender,
    DerivativeKind,
    Lacks,
    Task,
    Use,
    relative_difference,
    values,
)
from .peers import ALL, CASADI

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
    case: EvaluatedFunction,
    quantity: DerivativeKind,
    uses: Sequence[Use],
    contenders: Sequence[Contender],
    effort: Effort,
    store: Store,
    progress: ProgressCallback = quiet,
) -> None:
    """Rows of all uses, kept use by use; those that are there already are not measured again.

    The first contender that has the task is the reference.
    """
    tasks: dict[str, Task] = {}
    for number, use in enumerate(uses):
        if all(store.get(case.name, quantity.name, contender.name, use.name) for contender in contenders):
            continue
        use_progress = within(progress, number, len(uses), f"{quantity.name}, {use.name}: ")
        pairs: list[tuple[ReportRow, Timed | None]] = []
        reference, sitting = None, now()
        for i, contender in enumerate(contenders):
            use_progress(f"compiling {contender.name}", 0.5 * i / len(contenders))
            row = ReportRow(case.name, quantity.name, contender.name, use.name, unit="s", sitting=sitting)
            smaller = [store.get(*row.key[:3], it.name) for it in uses if 0 < it.count < use.count]
            try:
                timed, result = _first_call(case, quantity, use, contender, tasks, effort, smaller)
            except Lacks as error:
                tasks.setdefault(contender.name, error)
                pairs.append((dataclasses.replace(row, note=str(error)), None))
                continue
            except (RuntimeError, MemoryError, subprocess.SubprocessError) as error:  # of a compiler, or no memory
                pairs.append((dataclasses.replace(row, note=f"failed: {first_line(error)[:120]}"), None))
                continue
            reference = result if reference is None else reference
            off = relative_difference(result, reference, len(quantity.shape(case)))
            numbers = {"evaluations": float(timed.evaluations), "compile_seconds": timed.compile_seconds}
            note = row.note if off <= AGREEMENT else f"disagrees by {off:.0e}"
            pairs.append((dataclasses.replace(row, note=note, numbers={"difference": off, **numbers}), timed))
        keep(pairs, effort.repeats, store, use_progress)


def _first_call(
    case: EvaluatedFunction,
    quantity: DerivativeKind,
    use: Use,
    contender: Contender,
    tasks: dict[str, Task],
    effort: Effort,
    smaller: Sequence[ReportRow | None],
) -> tuple[Timed, Any]:
    """The program of a use, and its result. Raises Lacks where there is none, or where a call would take too long."""
    wait = max((row.value * use.count for row in smaller if row is not None and row.done), default=0.0)
    if wait > effort.longest:
        raise Lacks(f"a call would take {wait:.0f} s")
    # Made once for all uses, and refused once.
    if contender.name not in tasks:
        tasks[contender.name] = contender.task(case, quantity)
    if isinstance(task := tasks[contender.name], Lacks):
        raise task
    timed = use.of(task)
    result = values(timed)
    if timed.compile_seconds > effort.patience:
        tasks[contender.name] = Lacks(f"compiling another use took {timed.compile_seconds:.0f} s")
    if timed.rough > effort.longest:
        timed.samples.append(timed.rough)
    return timed, result


#: Ratios are to these.
_BASES = (PLAIN.name, CASADI.name)

#: Bars: of a case, quantity and use the median time of a contender over that of another is at most so much; seconds to
#: compile if there is no other.
_BARS = json.loads(Path(__file__).with_name("bars.json").read_text())


def bar_rows(rows: Sequence[ReportRow], case: str) -> list[ReportRow]:
    """Every bar of a case that was run with its quantity and use."""
    done = {row.key: row for row in rows if row.done}
    result = []
    for place, quantity, use, name, against, limit in _BARS:
        if place != case or not any((*key[:2], key[3]) == (case, quantity, use) for key in done):
            continue
        row, base = (done.get((case, quantity, contender, use)) for contender in (name, against))
        if against is None:
            value, setting, unit = row.numbers["compile_seconds"] if row else math.nan, "compiling", "s"
        else:
            value, setting, unit = row.value / base.value if row and base else math.nan, f"over {against}", ""
        ratio = ReportRow("bars", f"{CASES[case].title}, {quantity}, {use}", name, setting, value)
        result.append(judged(ratio, at_most(limit, unit)))
    return result


class Speed(Report):
    name, template, title = "speed", "speed", "What does one evaluation cost?"
    # Everything as it comes: nothing is set but x64.
    one_thread = False

    def __init__(self, arguments: argparse.Namespace, contenders: Sequence[Contender] = ALL) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self.missing = {it.name: why for it in contenders if (why := it.absent()) is not None}
        self._contenders = [it for it in contenders if it.name not in self.missing]
        self.versions = {it.package: metadata.version(it.package) for it in self._contenders if it.package}
        self.parts = [name for name in CASES if name in (arguments.case or self._effort.cases or CASES)]

    def measure(self, part: str, progress: ProgressCallback) -> None:
        quantities = [it for it in QUANTITIES if it.name in (self._effort.quantities or (it.name,))]
        uses = [use for use in USES if use.count <= self._effort.largest]
        for number, quantity in enumerate(quantities):
            quantity_progress = within(progress, number, len(quantities))
            measure(CASES[part], quantity, uses, self._contenders, self._effort, self.store, quantity_progress)

    def rows(self) -> list[ReportRow]:
        present = {it.name for it in self._contenders}
        return [row for row in super().rows() if row.by in present]

    def bars(self, part: str) -> list[ReportRow]:
        return bar_rows(self.rows(), part)

    def _wrong(self) -> list[ReportRow]:
        return [row for row in self.rows() if row.note.startswith("disagrees")]

    def problems(self) -> list[str]:
        return [f"{row.by} {row.note}: {row.group} {row.what} {row.setting}" for row in self._wrong()]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        timed: dict[str, list[ReportRow]] = {}
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


def _quantity(rows: Sequence[ReportRow], quantity: DerivativeKind, contenders: Sequence[Contender]) -> dict[str, Any]:
    """The tables of a quantity: ratios, times, seconds to compile; and why some are missing."""
    cells = {(row.group, row.setting, row.by): row for row in rows if row.what == quantity.name}
    done = {row.by for row in cells.values() if row.done}
    names = [it.name for it in contenders if it.name in done]
    compared = [name for name in names if name not in _BASES]

    def table(columns: Sequence[str], text: Callable[[ReportRow], str]) -> Table:
        lines = [
            [CASES[case].title, use, *(text(row) if (row := cells.get((case, use, name))) else "-" for name in columns)]
            for case, use in dict.fromkeys(key[:2] for key in cells)
        ]
        return ["function", "use", *columns], lines, 2

    def ratios(row: ReportRow) -> str:
        bases = [cells.get((row.group, row.setting, name)) for name in _BASES]
        over = [row.value / base.value if base else math.nan for base in bases]
        return " / ".join(_digits(ratio, 2 if ratio >= 0.095 else 3) for ratio in over)

    def spread(row: ReportRow) -> str:
        return f"{_ns(row.value)} ({_ns(row.numbers['lower'])} to {_ns(row.numbers['upper'])})" if row.done else "-"

    return {
        "name": quantity.name,
        "title": quantity.title[:1].upper() + quantity.title[1:],
        "ratios": table(compared, ratios) if compared else None,
        "times": table(names, spread) if names else None,
        "compiling": table(names, lambda row: _digits(row.numbers.get("compile_seconds", math.nan), 2)),
        "notes": sorted({f"{row.by}, {CASES[row.group].title}: {row.note}." for row in cells.values() if not row.done}),
    }


def _digits(value: float, digits: int) -> str:
    return f"{value:,.{digits}f}" if math.isfinite(value) else "-"


def _ns(seconds: float) -> str:
    """A time in ns with three digits, as the unit stays the same in a table: 1,230 ns."""
    value = 1e9 * seconds
    return f"{_digits(value, max(0, 2 - math.floor(math.log10(value))))} ns" if value < 1e6 else duration(seconds)


def draw(timed: Sequence[ReportRow], contenders: Sequence[Contender]) -> bytes:
    """The figure of a quantity as SVG; dots at the median, lines between the quartiles."""
    cases = [case for name, case in CASES.items() if any(row.group == name for row in timed)]
    uses = list(dict.fromkeys(row.setting for row in timed))
    shown = [it for it in contenders if any(row.by == it.name for row in timed)]
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
