"""Storage of rows, and the identification of rows that belong together: versions, code, machine and effort."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import os
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

import twistax

from .rows import Key, ReportRow

#: The package of native kernels, and the text in place of the version of a missing package.
KERNELS, ABSENT = "llvmlite", "absent"
_VERSIONED = ("twistax", "jax", "jaxlib", "diffrax", "equinox", "numpy", KERNELS)


@dataclasses.dataclass(frozen=True)
class Origin:
    """The origin of rows. Rows of different origins are not compared."""

    versions: Mapping[str, str]  # of the packages in use
    code: str  # digest of the package's code; the demo, and what only writes pages, left out
    machine: str  # processor, cores, Python, JAX and its flags
    effort: Mapping[str, Any]  # what was run, and how often it was repeated, in plain values

    @classmethod
    def now(cls, effort: Mapping[str, Any], versions: Mapping[str, str] | None = None) -> Origin:
        """The origin of rows that are measured now; `versions` are of further packages."""
        root = Path(twistax.__file__).parent
        pages = {Path(__file__).with_name("page.py"), *Path(__file__).with_name("templates").rglob("*")}
        read = {path for path in root.rglob("*") if path.suffix in (".py", ".c", ".json", ".ll", ".toml")}
        files = sorted(read - pages - {*(root / "demo").rglob("*")})
        code = _digest(b"".join(path.read_bytes() for path in files))
        return cls({name: _version(name) for name in _VERSIONED} | dict(versions or {}), code, _machine(), dict(effort))

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
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, JAX {jax.__version__} on "
        f"{jax.devices()[0].platform}, XLA_FLAGS {os.environ.get('XLA_FLAGS', 'none')}"
    )


class Store:
    """Rows of one origin in a JSON file, which is written whenever rows are added, so that an interrupted run can be
    resumed.

    Rows of another origin, and a file that is damaged, are dropped when it is opened; `dropped` counts rows.
    """

    def __init__(self, path: Path, origin: Origin) -> None:
        self._path, self.origin = path, origin
        self._rows: dict[Key, ReportRow] = {}
        self.dropped = 0
        try:
            document = json.loads(path.read_text())
            rows = [ReportRow.of(record) for record in document["rows"]]
            if document["digest"] == origin.digest:
                self._rows = {row.key: row for row in rows}
            else:
                self.dropped = len(rows)
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            pass

    def get(self, group: str, what: str, by: str, setting: str = "") -> ReportRow | None:
        """The row of that key, or None."""
        return self._rows.get((group, what, by, setting))

    def add(self, rows: Iterable[ReportRow]) -> None:
        """Keep rows, on disk too."""
        self._rows |= {row.key: row for row in rows}
        self.save()

    def forget(self, group: str) -> None:
        """Drop the rows of a group."""
        self._rows = {key: row for key, row in self._rows.items() if row.group != group}

    def save(self, bars: Sequence[ReportRow] = (), complete: bool = False) -> None:
        """Write strict JSON, a row a line, with rows about rows beside them, and whether the run left nothing out."""
        head = dataclasses.asdict(self.origin) | {"digest": self.origin.digest, "whole": complete}
        parts = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in head.items()]
        for name, rows in (("bars", bars), ("rows", list(self))):
            lines = ",\n".join(json.dumps(row.record(), allow_nan=False) for row in rows)
            parts.append(f"{json.dumps(name)}: [\n{lines}\n]")
        # What is half written never takes the place of what is there.
        draft = self._path.with_suffix(".part")
        draft.write_text("{\n" + ",\n".join(parts) + "\n}\n")
        draft.replace(self._path)

    def __iter__(self) -> Iterator[ReportRow]:
        return iter(self._rows.values())

    def __len__(self) -> int:
        return len(self._rows)


def save_csv(path: Path, rows: Iterable[ReportRow]) -> None:
    """Write one row per line; additional numbers are separate columns."""
    records = [row.record() for row in rows]
    columns = [field.name for field in dataclasses.fields(ReportRow) if field.name != "numbers"]
    numbers = dict.fromkeys(name for record in records for name in record["numbers"] if name not in columns)
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, [*columns, *numbers], lineterminator="\n")
        table.writeheader()
        for record in records:
            values = record.pop("numbers") | record
            table.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in values.items()})
