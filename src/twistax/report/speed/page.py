"""The page of the report."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence

from ..work_precision.blocks import Block, Bullets, Details, Figure, Heading, Paragraph, Table
from ..work_precision.origin import Origin
from ..work_precision.words import duration
from .bars import Outcome
from .case import CASES
from .contenders import BASES, CONTENDERS
from .measure import AGREEMENT
from .quantity import QUANTITIES, Quantity
from .row import Row
from .use import LOOP

__all__ = ["TITLE", "page"]

TITLE = "What does one evaluation cost?"


def page(
    rows: Sequence[Row],
    outcomes: Sequence[Outcome],
    missing: Mapping[str, str],
    origin: Origin,
    empty_call: float,
    figures: Mapping[str, bytes],
    command: str,
) -> list[Block]:
    """All blocks.

    Args:
        outcomes: of the bars.
        missing: contenders that are not on this machine, and why.
        origin: of the rows.
        empty_call: what a call of a compiled function costs that does nothing, s.
        figures: SVG by quantity; empty without matplotlib.
        command: how to get this page again.
    """
    absent = [f"**{name} is absent**: {reason}." for name, reason in missing.items()]
    wrong = [row for row in rows if row.result.startswith("disagrees")]
    agreed = f"All results agree to {AGREEMENT:g} of the largest entry; what agrees is timed."
    if wrong:
        said = "; ".join(f"{row.contender} on {row.case}, {row.quantity}, {row.use} {row.result}" for row in wrong)
        agreed = f"**Not all results agree**: {said}. What disagrees is not timed."
    return [
        Heading(1, TITLE),
        Paragraph(
            "Dynamics of a free body and of chains, with their derivatives: ours, plain jax.numpy and other packages, "
            f"each as it runs by default. This is a {origin.effort['name']} run."
        ),
        Bullets([agreed, *absent]),
        Heading(2, "Ratios"),
        Paragraph(
            f"Median time over that of {BASES[0]} / of {BASES[1]}, measured in turn in one run. Below 1 is faster."
        ),
        *(block for quantity in QUANTITIES for block in _ratios(rows, quantity)),
        *_bars(outcomes),
        Heading(2, "Times"),
        *(block for quantity in QUANTITIES for block in _times(rows, quantity, figures.get(quantity.name))),
        *([] if figures else [Paragraph("No figures: they need matplotlib, `pip install 'twistax[plot]'`.")]),
        Heading(2, "How it was measured"),
        *_how(rows, origin, empty_call, command),
    ]


def _places(rows: Sequence[Row], quantity: Quantity) -> list[tuple[str, str]]:
    return list(dict.fromkeys((row.case, row.use) for row in rows if row.quantity == quantity.name))


def _shown(rows: Sequence[Row], quantity: Quantity) -> list[str]:
    """Contenders with a time."""
    found = {row.contender for row in rows if row.quantity == quantity.name and row.done}
    return [each.name for each in CONTENDERS if each.name in found]


def _ratios(rows: Sequence[Row], quantity: Quantity) -> list[Block]:
    medians = {row.key: row.median for row in rows}
    names = [name for name in _shown(rows, quantity) if name not in BASES]
    if not names:
        return []

    def ratio(case: str, use: str, name: str, base: str) -> str:
        place = (case, quantity.name, use)
        return _number(medians.get((*place, name), math.nan) / medians.get((*place, base), math.nan))

    table = [
        [CASES[case].title, use, *(" / ".join(ratio(case, use, name, base) for base in BASES) for name in names)]
        for case, use in _places(rows, quantity)
    ]
    return [Heading(3, _title(quantity)), Table(["function", "use", *names], table, words=2)]


def _title(quantity: Quantity) -> str:
    return quantity.title[:1].upper() + quantity.title[1:]


def _times(rows: Sequence[Row], quantity: Quantity, figure: bytes | None) -> list[Block]:
    names = _shown(rows, quantity)
    if not names:
        return []
    found = {row.key: row for row in rows}
    drawn = [Figure(f"figures/speed-{quantity.name}.svg", figure, f"times, {quantity.title}")] if figure else []
    times, compiling = [], []
    for case, use in _places(rows, quantity):
        row = [found.get((case, quantity.name, use, name)) for name in names]
        times.append([CASES[case].title, use, *(_spread(each) for each in row)])
        compiling.append([CASES[case].title, use, *(_compiled(each) for each in row)])
    notes = {
        f"{row.contender}, {CASES[row.case].title}: {row.result}."
        for row in rows
        if row.quantity == quantity.name and not row.done
    }
    return [
        Heading(3, _title(quantity)),
        *drawn,
        Details(
            "Times of one evaluation: median (lower to upper quartile)",
            [Table(["function", "use", *names], times, words=2), Bullets(sorted(notes))],
        ),
        Details("Seconds to compile", [Table(["function", "use", *names], compiling, words=2)]),
    ]


def _spread(row: Row | None) -> str:
    if row is None or not row.done:
        return "-"
    return f"{_nanoseconds(row.median)} ({_nanoseconds(row.lower)} to {_nanoseconds(row.upper)})"


def _nanoseconds(seconds: float) -> str:
    """Three digits, as the unit stays the same in a table: 1,230 ns."""
    value = 1e9 * seconds
    digits = max(0, 2 - math.floor(math.log10(value)))
    return f"{value:,.{digits}f} ns" if value < 1e6 else duration(seconds)


def _compiled(row: Row | None) -> str:
    return "-" if row is None or not math.isfinite(row.compile_seconds) else f"{row.compile_seconds:.2f}"


def _bars(outcomes: Sequence[Outcome]) -> list[Block]:
    if not outcomes:
        return []
    rows = [
        [
            CASES[each.bar.case].title,
            each.bar.quantity.name,
            each.bar.use.name,
            each.bar.contender,
            each.bar.against or "seconds to compile",
            _number(each.found),
            f"{each.bar.limit:g}",
            each.verdict,
        ]
        for each in outcomes
    ]
    missed = sum(each.verdict == "MISSED" for each in outcomes)
    known = sum(each.verdict != "not measured" for each in outcomes)
    said = f"{missed} of {known} are missed." if missed else f"All {known} that were measured hold."
    head = ["function", "", "use", "of", "against", "ratio or s", "at most", ""]
    return [
        Heading(2, "Bars"),
        Paragraph(f"Set before measuring. {said}"),
        Details("The bars", [Table(head, rows, words=5)]),
    ]


def _how(rows: Sequence[Row], origin: Origin, empty_call: float, command: str) -> list[Block]:
    effort = origin.effort
    versions = ", ".join(f"{name} {version}" for name, version in origin.versions.items())
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    present = {row.contender for row in rows}
    lines = [
        f"Machine: {origin.machine}; this process may use {usable} of the cores. Double precision.",
        f"Versions: {versions}; code {origin.code}.",
        f"Run again: `{command}` ({effort['name']} run). All figures are in `speed.csv` and `speed.json`.",
        "Nothing is set for the process but JAX's x64 switch: no XLA flag, no compiler option.",
        "The results of the very programs that are timed are compared with those of the first contender in the tables, "
        "at random states, before anything is timed.",
        f"Contenders take turns: up to {effort['rounds']} rounds of 3 calls after one that does not count (of long "
        f"calls fewer, at least {effort['least']}; a call over {effort['longest']:g} s counts alone, and is left out "
        "if a smaller batch foretells it). Every call is waited for. The table has medians "
        "and quartiles; the CSV the minimum too.",
        "A single call goes from Python with arguments that are there already, twenty at a time. Calling a compiled "
        f"JAX function that does nothing takes {duration(empty_call)}, part of every single call of JAX here.",
        f"In a loop: {LOOP.steps:,} evaluations in one `lax.scan` or C loop; each adds 1e-200 of the results of the "
        "one before to all its arguments, so that nothing can be worked out once for all.",
        "A batch is `jax.vmap` over random points, or a C loop. XLA may share large arrays among the cores that the "
        "process may use; the loops in C and Python use one. For one core each: `taskset -c 0`.",
        "Compiling is apart: from the expression to what can be called, the C compiler included. What took over "
        f"{effort['patience']:g} s is not compiled for further uses.",
    ]
    table = Table(["contender", "how"], [[each.name, each.how] for each in CONTENDERS if each.name in present], words=2)
    return [Bullets(lines), table]


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value >= 0.095 else f"{value:.3f}"
