"""Rows on disk, so that an interrupted run goes on where it stopped."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from .origin import Origin

__all__ = ["Kept", "Store", "save_csv", "save_json"]


@runtime_checkable
class Kept(Protocol):
    """A row that can be kept: plain values by column, and what tells it from others."""

    @property
    def key(self) -> Hashable: ...
    def record(self) -> dict[str, Any]: ...


R = TypeVar("R", bound=Kept)


class Store(Generic[R]):
    """Rows of one origin in a file of JSON lines, each written as soon as it is measured.

    `of` makes a row of its record. Rows of another origin (other versions, machine or effort) and lines that were cut
    off are dropped when the file is opened; `dropped` counts them.
    """

    def __init__(self, path: Path, origin: Origin, of: Callable[[Mapping[str, Any]], R]) -> None:
        self._path, self._digest, self._of = path, origin.digest, of
        self._rows: dict[Hashable, R] = {}
        lines = path.read_text().splitlines() if path.exists() else []
        kept = [line for line in lines if self._read(line)]
        self.dropped = len(lines) - len(kept)
        if self.dropped:
            path.write_text("".join(f"{line}\n" for line in kept))

    def _read(self, line: str) -> bool:
        try:
            record = json.loads(line)
            row = self._of(record)
        except (ValueError, KeyError, TypeError):
            return False
        if record.get("origin") != self._digest:
            return False
        self._rows[row.key] = row
        return True

    def get(self, *key: Hashable) -> R | None:
        """The row of that key that is there, or None."""
        return self._rows.get(key)

    def add(self, rows: Iterable[R]) -> None:
        """Keep rows, on disk too."""
        with self._path.open("a") as file:
            for row in rows:
                self._rows[row.key] = row
                file.write(json.dumps({**row.record(), "origin": self._digest}) + "\n")

    def __iter__(self) -> Iterator[R]:
        return iter(self._rows.values())

    def __len__(self) -> int:
        return len(self._rows)


def save_csv(path: Path, columns: Sequence[str], rows: Iterable[Kept]) -> None:
    """One row a line under the names of the columns."""
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, columns, lineterminator="\n")
        table.writeheader()
        for row in rows:
            table.writerow({name: _short(value) for name, value in row.record().items()})


def save_json(path: Path, document: dict[str, Any]) -> None:
    """Strict JSON, for programs: an entry of a list on each line."""
    parts = [f"{json.dumps(name)}: {_json(value)}" for name, value in document.items()]
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n")


def _json(value: Any) -> str:
    if isinstance(value, list):
        return "[\n" + ",\n".join(json.dumps(entry, allow_nan=False) for entry in value) + "\n]"
    return json.dumps(value, allow_nan=False)


def _short(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else value
