"""A measurement with its expected result, and the sections that contain measurements."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

from .expected import Absent, EarlyEnd, Expected, Outcome, judged
from .rows import DONE, ReportRow, first_line, now

T = TypeVar("T")
#: The expected result of a column, or a function of the row that gives it; and the function that measures a row.
Column = tuple[Expected | Callable[[T], Expected], Callable[[T], Any]]

_SILENT = "NaN OR INFINITE, AND NOTHING SAID SO"


class MeasuredCase:
    """One case of a section.

    Args:
        what: the case, in a few words with numbers.
        by: the method, package or function that is measured.
        expected: the expected result.
        measure: a function of the arguments and options after it that returns the number, or raises.
        slow: whether the quick run leaves it out.
        place: its line and its x in the figure of its section.
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

    def run(self, section: str = "") -> ReportRow:
        """Measure. An error is an outcome too; the note has its first line."""
        row = ReportRow(section, self.what, self.by, sitting=now())
        try:
            outcome: Outcome = float(self._measure())
        except Exception as failure:
            outcome = failure
        if isinstance(outcome, float):
            row = dataclasses.replace(row, value=outcome, note=DONE if math.isfinite(outcome) else _SILENT)
        else:
            kind = "" if isinstance(outcome, (EarlyEnd, Absent)) else f"{type(outcome).__name__}: "
            row = dataclasses.replace(row, note=kind + first_line(outcome))
        return judged(row, self.expected, outcome)


#: A measurement of every run, and one that the quick run leaves out.
quick, slow = MeasuredCase, functools.partial(MeasuredCase, slow=True)

#: The measurements of a section; a sentence in front of one explains its result. The title and the text of the section
#: are in `templates/sections.toml`.
Section = list[str | MeasuredCase]


def explained(section: Section) -> Iterator[tuple[str, MeasuredCase]]:
    """Each measurement with the sentence before it."""
    why = ""
    for item in section:
        if isinstance(item, str):
            why = item
        else:
            yield why, item


def table(rows: Mapping[str, T], columns: Mapping[str, Column[T]], kind: Callable[..., MeasuredCase] = slow) -> Section:
    """A measurement for each row and column, each of which has a name; they are `quick` or `slow`."""
    return [
        kind(what, by, expected if isinstance(expected, Expected) else expected(row), measure, row)
        for what, row in rows.items()
        for by, (expected, measure) in columns.items()
    ]
