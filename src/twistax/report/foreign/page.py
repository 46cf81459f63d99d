"""The report of `python -m twistax report --optimal --foreign`: plain IPOPT and this package, problem by problem."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Mapping
from statistics import median
from typing import Any

from ..harness.expected import at_most, between, judged
from ..harness.page import texts
from ..harness.report import Report
from ..harness.rows import DONE, now, number
from ..harness.rows import ReportRow as Row
from ..harness.timing import ProgressCallback as Tell
from .run import SAME, Side, excess_cost, in_words, ipopt, ours
from .statement import Foreign, Phased

#: Seconds of the processor that a side has for a problem, and in the quick run.
_SECONDS, _QUICK = 60.0, 15.0
_BY, _BAR = "twistax over IPOPT", "SOLVED at IPOPT's optimum or better"
#: The part that sums up the others, and the bars of ratios: their median, and the worst.
_ALL = "all"
_RATIOS = {"steps": (1.0, 1.5), "second solve": (0.08, 0.3), "first answer": (math.inf, math.inf)}
_HEAD = [
    *("", "transcription", "IPOPT", "twistax", "optimum", "IPOPT", "twistax", "twistax is"),
    *("steps, IPOPT", "twistax", "ratio", "first answer, s, IPOPT", "twistax", "ratio"),
    *("second solve, ms, IPOPT", "twistax", "ratio"),
]


def _ratios(theirs: Side, mine: Side) -> dict[str, float]:
    steps = (mine.iterations or math.nan) / (theirs.iterations or math.nan)
    return {"steps": steps, "second solve": mine.second / theirs.second, "first answer": mine.first / theirs.first}


class ForeignReport(Report):
    """Each problem by both sides in turn, in this process. A row of the store is a problem, its numbers both sides."""

    name, template = "foreign", "foreign"

    def __init__(self, problems: Mapping[str, Foreign | Phased], arguments: argparse.Namespace) -> None:
        self._problems = {key: it for key, it in problems.items() if key in (arguments.only or problems)}
        self._texts = texts(self.name)
        self.title = self._texts["title"]
        self.parts = [*self._problems, _ALL]
        self._seconds = _QUICK if arguments.quick else _SECONDS
        self.effort = {"seconds": self._seconds}

    def measure(self, part: str, tell: Tell) -> None:
        if part == _ALL or self._row(part):
            return
        problem = self._problems[part]
        tell("IPOPT", 0.0)
        theirs = ipopt(problem, self._seconds)
        tell("twistax", 0.5)
        mine = ours(problem, self._seconds)
        numbers = {
            f"{name}, {by}": x for by, side in (("IPOPT", theirs), ("twistax", mine)) for name, x in side.numbers
        }
        holds = mine.solved and not excess_cost(problem, mine, theirs) > SAME
        note = DONE if mine.solved and theirs.solved else f"IPOPT: {theirs.word}; twistax: {mine.word}"
        row = Row(part, problem.name, _BY, problem.transcription, mine.second / theirs.second, "of its time", _BAR)
        self.store.add([dataclasses.replace(row, holds=holds, note=note, sitting=now(), numbers=numbers)])

    def _row(self, part: str) -> Row | None:
        problem = self._problems[part]
        return self.store.get(part, problem.name, _BY, problem.transcription)

    def _measured(self) -> dict[str, tuple[Side, Side]]:
        """IPOPT and this package, of the problems that were measured."""
        rows = {part: self._row(part) for part in self._problems}
        return {part: _sides(row) for part, row in rows.items() if row}

    def bars(self, part: str) -> list[Row]:
        return self._summary() if part == _ALL else [row] if (row := self._row(part)) else []

    def _summary(self) -> list[Row]:
        """Counts, and ratios over the problems that both solve at one optimum."""
        measured = self._measured()
        worse = {part: excess_cost(self._problems[part], mine, theirs) for part, (theirs, mine) in measured.items()}
        pairs = [measured[part] for part, size in worse.items() if abs(size) <= SAME]
        good = [mine.solved and not worse[part] > SAME for part, (_, mine) in measured.items()]
        counts = {
            "problems": len(measured),
            "SOLVED by IPOPT": sum(theirs.solved for theirs, _ in measured.values()),
            "SOLVED by twistax": sum(mine.solved for _, mine in measured.values()),
            "SOLVED at IPOPT's optimum or better": sum(good),
            "SOLVED at one optimum": len(pairs),
        }
        rows = [judged(Row(_ALL, what, "count", value=float(count)), between()) for what, count in counts.items()]
        for what, bars in _RATIOS.items():
            values = [ratio for pair in pairs if math.isfinite(ratio := _ratios(*pair)[what])]
            for word, pick, bar in (("median", median, bars[0]), ("worst", max, bars[1])):
                row = Row(
                    _ALL, f"{what}, {word}, at one optimum", _BY, value=float(pick(values)) if values else math.nan
                )
                rows.append(judged(row, at_most(bar)))
        return rows

    def problems(self) -> list[str]:
        rows = [row for part in self.parts for row in self.bars(part) if row.holds is False]
        return [f"{row.what}: {row.came if row.done else row.note}; asked for: {row.bar}" for row in rows]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        return {}

    def context(self) -> dict[str, Any]:
        measured = self._measured()
        table = [self._line(part, *sides) for part, sides in measured.items()]
        summary = [[row.what, row.came, row.bar, row.verdict] for row in self._summary()]
        return {
            "about": self._texts["about"],
            "note": self._texts["note"],
            "table": (_HEAD, table, 1),
            "summary": (["", "came", "asked for", ""], summary, 1),
            "sources": [self._source(self._problems[part]) for part in measured],
        }

    def _line(self, part: str, theirs: Side, mine: Side) -> list[str]:
        problem, row = self._problems[part], self._row(part)
        words = dict(entry.split(": ", 1) for entry in row.note.split("; ") if ": " in entry) if row else {}
        ratios = _ratios(theirs, mine)
        shown = lambda x: number(x) if math.isfinite(x) else "-"  # noqa: E731
        both = lambda name, scale: [shown(scale * getattr(side, name)) for side in (theirs, mine)]  # noqa: E731
        return [
            problem.name,
            problem.transcription,
            *("SOLVED" if side.solved else words.get(by, "-") for by, side in (("IPOPT", theirs), ("twistax", mine))),
            "-" if problem.published is None else f"{problem.published:.7g}",
            *(f"{side.cost:.8g}" if math.isfinite(side.cost) else "-" for side in (theirs, mine)),
            in_words(excess_cost(problem, mine, theirs)),
            *(shown(float(side.iterations or math.nan)) for side in (theirs, mine)),
            shown(ratios["steps"]),
            *both("first", 1.0),
            shown(ratios["first answer"]),
            *both("second", 1e3),
            shown(ratios["second solve"]),
        ]

    def _source(self, problem: Foreign | Phased) -> str:
        return f"{problem.name}: {problem.source}." + (f" There: {problem.theirs}." if problem.theirs else "")


def _sides(row: Row) -> tuple[Side, Side]:
    """What a row keeps of both sides."""
    theirs, mine = (Side.of({n: row.numbers[f"{n}, {by}"] for n in Side.NAMES}) for by in ("IPOPT", "twistax"))
    return theirs, mine
