"""One flight as the report keeps it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

__all__ = ["COLUMNS", "Row"]


@dataclasses.dataclass(frozen=True)
class Row:
    """One scene flown by one method with one setting.

    Attributes:
        scene, method: names.
        unit: what the setting is: "tolerance" (rtol = atol) or "steps".
        setting: its value.
        error: at the end, from `Scene.error`; not a number if the end was not reached.
        seconds: of one call of the compiled function, the median over all repeats; not a number if not timed.
        fastest: the shortest of them, s.
        repeats: how often it was called.
        compile_seconds: tracing and compiling, once for all tolerances.
        evaluations: of the right-hand side.
        accepted, rejected: steps.
        result: "done", or what happened.
        sitting: when the scene was measured; rows of one sitting were timed in turn.
    """

    scene: str
    method: str
    unit: str
    setting: float
    error: float
    seconds: float
    fastest: float
    repeats: int
    compile_seconds: float
    evaluations: int
    accepted: int
    rejected: int
    result: str
    sitting: str

    @property
    def steps(self) -> int:
        """Steps tried."""
        return self.accepted + self.rejected

    @property
    def key(self) -> tuple[str, str, float]:
        """What tells rows apart."""
        return self.scene, self.method, self.setting

    @property
    def done(self) -> bool:
        return self.result == "done"

    def record(self) -> dict[str, Any]:
        """For CSV and JSON: plain values by column, None where there is no number."""
        values = {column: getattr(self, column) for column in COLUMNS}
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in values.items()
        }

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Row:
        """The row of a record. Raises KeyError for a column that is missing."""
        values: dict[str, Any] = {field.name: record[field.name] for field in dataclasses.fields(cls)}
        values |= {name: math.nan for name, value in values.items() if value is None}
        return cls(**values)


#: Columns of the tables.
COLUMNS = (
    *("scene", "method", "unit", "setting", "error", "seconds", "fastest", "repeats", "compile_seconds"),
    *("evaluations", "steps", "accepted", "rejected", "result", "sitting"),
)
