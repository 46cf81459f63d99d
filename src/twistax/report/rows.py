"""What was measured: the one row of all reports."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

__all__ = ["DONE", "Row", "number", "plain", "save_csv"]

#: The note of a row that has its value.
DONE = "done"

Key = tuple[str, str, str, str]


@dataclasses.dataclass(frozen=True)
class Row:
    """One measured value, and whether it is what was asked for.

    Attributes:
        group: the scene, function or section it belongs to.
        what: what was measured.
        by: the method or contender.
        setting: with which settings.
        value: what came; NaN where nothing did.
        unit: of the value.
        bar: what was asked for, in words; empty where nothing was.
        holds: whether it came; None where nothing was asked for or nothing could be measured.
        note: "done", or why there is no value.
        sitting: when; rows of one sitting were timed in turn.
        numbers: what else was measured, by name.
    """

    group: str
    what: str
    by: str
    setting: str = ""
    value: float = math.nan
    unit: str = ""
    bar: str = ""
    holds: bool | None = None
    note: str = DONE
    sitting: str = ""
    numbers: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def key(self) -> Key:
        """What tells rows apart."""
        return self.group, self.what, self.by, self.setting

    @property
    def done(self) -> bool:
        return self.note == DONE

    @property
    def came(self) -> str:
        """The value with its unit, or the note."""
        return f"{number(self.value)} {self.unit}".rstrip() if math.isfinite(self.value) else self.note

    @property
    def verdict(self) -> str:
        """One word for tables; empty where nothing was asked for."""
        if self.holds is None:
            return "not run" if self.bar else ""
        return "holds" if self.holds else "MISSED"

    def record(self) -> dict[str, Any]:
        """Plain values by name, None in place of what is not finite."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        numbers = {name: _finite(value) for name, value in self.numbers.items()}
        return values | {"value": _finite(self.value), "numbers": numbers}

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Row:
        """The row of a record. Raises KeyError or TypeError for what is none."""
        numbers = {name: _read(value) for name, value in record["numbers"].items()}
        return cls(**{**record, "value": _read(record["value"]), "numbers": numbers})


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _read(value: float | None) -> float:
    return math.nan if value is None else float(value)


def number(value: float) -> str:
    """Two or three digits, whole numbers as they are, and 1e-6 rather than 1e-06."""
    if value == int(value) and 1.0 <= abs(value) < 1e7:
        return f"{int(value):,}"
    return _short(f"{value:.2g}" if abs(value) < 1e-3 else f"{value:.3g}")


def plain(value: float) -> str:
    """A round number: 1e5 rather than 1e+05, and 0.05 as it is."""
    return _short(f"{value:.0e}" if value and not 1e-3 <= abs(value) < 1e4 else f"{value:g}")


def _short(text: str) -> str:
    return text.replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


def save_csv(path: Path, rows: Iterable[Row]) -> None:
    """One row a line; further numbers are columns of their own."""
    records = [row.record() for row in rows]
    numbers = dict.fromkeys(name for record in records for name in record["numbers"])
    columns = [field.name for field in dataclasses.fields(Row) if field.name != "numbers"]
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, [*columns, *numbers], lineterminator="\n")
        table.writeheader()
        for record in records:
            values = record | record.pop("numbers")
            table.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in values.items()})
