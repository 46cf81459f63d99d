"""Rows on disk, so that an interrupted run goes on where it stopped."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from .origin import Origin
from .rows import Row

__all__ = ["Store"]


class Store:
    """Rows of one origin in a JSON file, written whenever some are added.

    Rows of another origin, and a file that is damaged, are dropped when it is opened; `dropped` counts rows.
    """

    def __init__(self, path: Path, origin: Origin) -> None:
        self._path, self.origin = path, origin
        rows, other = self._read()
        self._rows = {} if other else {row.key: row for row in rows}
        self.dropped = len(rows) if other else 0

    def _read(self) -> tuple[list[Row], bool]:
        """The rows there are, and whether their origin is another one."""
        try:
            document = json.loads(self._path.read_text())
            return [Row.of(record) for record in document["rows"]], document["digest"] != self.origin.digest
        except FileNotFoundError:
            return [], False
        except (ValueError, KeyError, TypeError):
            return [], True

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

    def save(self, bars: Sequence[Row] = ()) -> None:
        """Write strict JSON, a row a line, with rows about rows beside them."""
        head = dataclasses.asdict(self.origin) | {"digest": self.origin.digest}
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
