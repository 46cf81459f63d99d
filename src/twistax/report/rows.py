"""What was measured: the one row of all reports, where rows come from, and how they are kept."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import math
import os
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

import twistax

#: The note of a row that has its value.
DONE = "done"
#: What native kernels need, and what stands for the version of a package that is not installed.
KERNELS, ABSENT = "llvmlite", "absent"
_VERSIONED = ("twistax", "jax", "jaxlib", "diffrax", "equinox", "numpy", KERNELS)

Key = tuple[str, str, str, str]


@dataclasses.dataclass(frozen=True)
class Row:
    """One measured value, and whether it is what was asked for."""

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
    def of(cls, record: Mapping[str, Any]) -> Row:
        """The row of a record. Raises KeyError or TypeError for what is none."""
        value, *numbers = (math.nan if v is None else float(v) for v in (record["value"], *record["numbers"].values()))
        return cls(**{**record, "value": value, "numbers": dict(zip(record["numbers"], numbers, strict=True))})


def now() -> str:
    """To the second."""
    return datetime.now().isoformat(timespec="seconds")


def first_line(error: Any) -> str:
    """Of what an error says; its type where it says nothing."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def number(value: float) -> str:
    """Two or three digits, whole numbers and thousands to the unit, and 1e-6 rather than 1e-06."""
    if ((value == int(value) and abs(value) >= 1.0) or abs(value) >= 1e3) and abs(value) < 1e7:
        return f"{value:,.0f}"
    return _short(f"{value:.2g}" if abs(value) < 1e-3 else f"{value:.3g}")


def plain(value: float) -> str:
    """A round number: 1e5 rather than 1e+05, and 0.05 as it is."""
    return _short(f"{value:.0e}" if value and not 1e-3 <= abs(value) < 1e4 else f"{value:g}")


def _short(text: str) -> str:
    return text.replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


def save_csv(path: Path, rows: Iterable[Row]) -> None:
    """One row a line; further numbers are columns of their own."""
    records = [row.record() for row in rows]
    columns = [field.name for field in dataclasses.fields(Row) if field.name != "numbers"]
    numbers = dict.fromkeys(name for record in records for name in record["numbers"] if name not in columns)
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, [*columns, *numbers], lineterminator="\n")
        table.writeheader()
        for record in records:
            values = record.pop("numbers") | record
            table.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in values.items()})


@dataclasses.dataclass(frozen=True)
class Origin:
    """Rows of different origins do not belong together."""

    versions: Mapping[str, str]  # of the packages in use
    code: str  # digest of this package's own code; the demo, and what only writes pages, left out
    machine: str  # processor, cores, Python, JAX and its flags
    effort: Mapping[str, Any]  # what was run, and how often it was repeated, in plain values

    @classmethod
    def now(cls, effort: Mapping[str, Any], versions: Mapping[str, str] | None = None) -> Origin:
        """Of rows measured now; versions are of other packages in use."""
        found = {name: _version(name) for name in _VERSIONED} | dict(versions or {})
        root = Path(twistax.__file__).parent
        left_out = {*(root / "demo").rglob("*"), Path(__file__).with_name("page.py")}
        files = [path for path in sorted({*root.rglob("*")} - left_out) if path.suffix in (".py", ".c", ".json", ".ll")]
        return cls(found, _digest(b"".join(path.read_bytes() for path in files)), _machine(), dict(effort))

    @property
    def digest(self) -> str:
        """A short word that differs where anything does."""
        return _digest(json.dumps(dataclasses.asdict(self), sort_keys=True).encode())


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ABSENT


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]


def _machine() -> str:
    model, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        named = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = named[0].split(":", 1)[1].strip() if named else model
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, JAX {jax.__version__} on "
        f"{jax.devices()[0].platform}, XLA_FLAGS {os.environ.get('XLA_FLAGS', 'none')}"
    )


class Store:
    """Rows of one origin in a JSON file, written whenever some are added: an interrupted run goes on where it stopped.

    Rows of another origin, and a file that is damaged, are dropped when it is opened; `dropped` counts rows.
    """

    def __init__(self, path: Path, origin: Origin) -> None:
        self._path, self.origin = path, origin
        self._rows: dict[Key, Row] = {}
        self.dropped = 0
        try:
            document = json.loads(path.read_text())
            rows = [Row.of(record) for record in document["rows"]]
            if document["digest"] == origin.digest:
                self._rows = {row.key: row for row in rows}
            else:
                self.dropped = len(rows)
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            pass

    def get(self, group: str, what: str, by: str, setting: str = "") -> Row | None:
        """The row of that key, or None."""
        return self._rows.get((group, what, by, setting))

    def add(self, rows: Iterable[Row]) -> None:
        """Keep rows, on disk too."""
        self._rows |= {row.key: row for row in rows}
        self.save()

    def forget(self, group: str) -> None:
        """Drop the rows of a group."""
        self._rows = {key: row for key, row in self._rows.items() if row.group != group}

    def save(self, bars: Sequence[Row] = (), whole: bool = False) -> None:
        """Write strict JSON, a row a line, with rows about rows beside them, and whether the run left nothing out."""
        head = dataclasses.asdict(self.origin) | {"digest": self.origin.digest, "whole": whole}
        parts = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in head.items()]
        for name, rows in (("bars", bars), ("rows", list(self))):
            lines = ",\n".join(json.dumps(row.record(), allow_nan=False) for row in rows)
            parts.append(f"{json.dumps(name)}: [\n{lines}\n]")
        # What is half written never takes the place of what is there.
        draft = self._path.with_suffix(".part")
        draft.write_text("{\n" + ",\n".join(parts) + "\n}\n")
        draft.replace(self._path)

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows.values())

    def __len__(self) -> int:
        return len(self._rows)
