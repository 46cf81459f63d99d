"""A measurement: what is done, what is asked of the number that comes, and the sections that measurements stand in."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

from .expected import Absent, EarlyEnd, Expected, Outcome, judged
from .rows import DONE, ReportRow, first_line, now

T = TypeVar("T")
#: The bar of the numbers of a column, maybe by row; and the function that gives the number of a row.
Column = tuple[Expected | Callable[[T], Expected], Callable[[T], Any]]

_SILENT = "NaN OR INFINITE, AND NOTHING SAID SO"


class MeasuredCase:
    """One case of a section.

    Args:
        what: what is done, in a few words with numbers.
        by: the method, package or function that does it.
        expected: what is asked of the number.
        measure: gives the number of the arguments and options after it, or raises.
        slow: left out of the quick run.
        place: where the figure of its section has it: on which line, at which x.
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
        """Measure. What is raised is the outcome, and stands in the note."""
        row = ReportRow(section, self.what, self.by, sitting=now())
        try:
            came: Outcome = float(self._measure())
        except Exception as failure:
            came = failure
        if isinstance(came, float):
            row = dataclasses.replace(row, value=came, note=DONE if math.isfinite(came) else _SILENT)
        else:
            kind = "" if isinstance(came, (EarlyEnd, Absent)) else f"{type(came).__name__}: "
            row = dataclasses.replace(row, note=kind + first_line(came))
        return judged(row, self.expected, came)


#: A measurement of every run, and one that the quick run leaves out.
quick, slow = MeasuredCase, functools.partial(MeasuredCase, slow=True)

#: The measurements of a section, those that need it after a plain sentence that explains what comes of them. Its title,
#: and what its page says of it, stand in `templates/sections.toml`.
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
