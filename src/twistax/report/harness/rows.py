"""The row type of all reports, and the format of numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any

#: The note of a row that has its value.
DONE = "done"

Key = tuple[str, str, str, str]


@dataclasses.dataclass(frozen=True)
class ReportRow:
    """A measured value, and whether it meets its expectation."""

    group: str  # the scene, function or section it belongs to
    what: str  # was measured
    by: str  # the method or contender
    setting: str = ""
    value: float = math.nan  # NaN where nothing came
    unit: str = ""
    bar: str = ""  # what was asked for, in words; empty where nothing was
    holds: bool | None = None  # whether that came; None where nothing was asked for or nothing could be measured
    note: str = DONE  # or why there is no value
    sitting: str = ""  # when; rows of one sitting were timed in turn
    numbers: Mapping[str, float] = dataclasses.field(default_factory=dict)  # what else was measured

    @property
    def key(self) -> Key:
        """What tells rows apart."""
        return self.group, self.what, self.by, self.setting

    @property
    def done(self) -> bool:
        return self.note == DONE

    @property
    def came(self) -> str:
        """The value with its unit, or the note that says why there is none."""
        if math.isfinite(self.value):
            return f"{number(self.value)} {self.unit}".rstrip()
        return "-" if self.done else self.note

    @property
    def verdict(self) -> str:
        """One word for tables; empty where nothing was asked for."""
        if self.holds is None:
            return "not run" if self.bar else ""
        return "holds" if self.holds else "MISSED"

    def record(self) -> dict[str, Any]:
        """Plain values by name, None in place of what is not finite."""
        value, *numbers = (float(v) if math.isfinite(v) else None for v in (self.value, *self.numbers.values()))
        return dataclasses.asdict(self) | {"value": value, "numbers": dict(zip(self.numbers, numbers, strict=True))}

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> ReportRow:
        """The row of a record. Raises KeyError or TypeError for what is none."""
        value, *numbers = (math.nan if v is None else float(v) for v in (record["value"], *record["numbers"].values()))
        return cls(**{**record, "value": value, "numbers": dict(zip(record["numbers"], numbers, strict=True))})


def now() -> str:
    """The present time in ISO format, to the second."""
    return datetime.now().isoformat(timespec="seconds")


def first_line(error: Any) -> str:
    """The first line of an error's message; its type where it has none."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def number(value: float) -> str:
    """A measured number: two or three digits, whole numbers and thousands to the unit, 1e-6 rather than 1e-06."""
    if ((value == int(value) and abs(value) >= 1.0) or abs(value) >= 1e3) and abs(value) < 1e7:
        return f"{value:,.0f}"
    return _short(f"{value:.2g}" if abs(value) < 1e-3 else f"{value:.3g}")


def plain(value: float) -> str:
    """A round number as a person writes it: 1e5 rather than 1e+05, and 0.05 as it is."""
    return _short(f"{value:.0e}" if value and not 1e-3 <= abs(value) < 1e4 else f"{value:g}")


def _short(text: str) -> str:
    return text.replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


def duration(seconds: float) -> str:
    """Seconds with three digits and a unit: 1.5 ms."""
    if not math.isfinite(seconds):
        return "-"
    unit, size = ("s", 1.0) if seconds >= 1.0 else ("ms", 1e-3) if seconds >= 1e-3 else ("us", 1e-6)
    return f"{seconds / size:.3g} {unit}"
