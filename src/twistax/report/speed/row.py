"""One figure as the report keeps it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

__all__ = ["COLUMNS", "DONE", "Row"]

DONE = "done"


@dataclasses.dataclass(frozen=True)
class Row:
    """One quantity of one case in one use by one contender.

    Attributes:
        case, quantity, use, contender: names.
        result: "done", or why there is no time.
        difference: of its results from the reference's, relative to the largest entry at each point; the worst.
        median, lower, upper, fastest: of the time of an evaluation, s: median, quartiles, minimum.
        repeats: how often it was called.
        evaluations: in one call.
        compile_seconds: from the expression to what can be called.
        sitting: when the group was measured; rows of one sitting were timed in turn.
    """

    case: str
    quantity: str
    use: str
    contender: str
    result: str
    difference: float = math.nan
    median: float = math.nan
    lower: float = math.nan
    upper: float = math.nan
    fastest: float = math.nan
    repeats: int = 0
    evaluations: int = 0
    compile_seconds: float = math.nan
    sitting: str = ""

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What tells rows apart."""
        return self.case, self.quantity, self.use, self.contender

    @property
    def done(self) -> bool:
        return self.result == DONE

    def record(self) -> dict[str, Any]:
        """For CSV and JSON: plain values by column, None where there is no number."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in dataclasses.asdict(self).items()
        }

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Row:
        """The row of a record. Raises KeyError for a column that is missing."""
        values: dict[str, Any] = {name: record[name] for name in COLUMNS}
        values |= {name: math.nan for name, value in values.items() if value is None}
        return cls(**values)


#: Columns of the tables.
COLUMNS = tuple(field.name for field in dataclasses.fields(Row))
