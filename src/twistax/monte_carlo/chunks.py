"""Where the chunks of a sweep are kept: in memory, or in files that a sweep takes up again."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

#: Of each result of a chunk, members on the leading axis; the last one are the numbers of the `Result`.
Columns: TypeAlias = "list[NDArray[Any]]"

_SETUP = "sweep.json"
#: Results differ by rounding where another number of devices computed them.
_AGREE = 1e-6


class InMemory:
    """Chunks that go with the sweep."""

    def __init__(self) -> None:
        self._kept: dict[int, Columns] = {}

    def have(self, k: int) -> bool:
        return k in self._kept

    def keep(self, k: int, columns: Columns) -> None:
        self._kept[k] = columns

    def read(self, k: int) -> Columns:
        return self._kept[k]


class OnDisk:
    """A file for each chunk, which is there as a whole or not at all.

    Args:
        folder: made if missing.
        setup: what says whether chunks that are there are of this sweep.
        chunks: how many there are.
        shapes: those of the columns of one of them, by number.
        compute: gives one of them, by number.
    Raises:
        InputError: a folder that cannot be used, or has another sweep.
    """

    def __init__(
        self,
        folder: Path,
        setup: dict[str, Any],
        chunks: int,
        shapes: Callable[[int], list[tuple[int, ...]]],
        compute: Callable[[int], Columns],
    ) -> None:
        self._folder, self._shapes, self._there = folder, shapes, set[int]()
        path = folder / _SETUP
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                _whole(path, lambda file: file.write(json.dumps(setup, indent=2).encode()))
            found = json.loads(path.read_text())
            if not isinstance(found, dict):
                raise ValueError(f"{_SETUP} is damaged")
        except (OSError, ValueError) as error:
            raise InputError(f"sweep cannot use the directory {folder}: {error}") from error
        different = [name for name in setup if found.get(name) != setup[name]]
        if different:
            told = ", ".join(f"{name} {found.get(name)} there, {setup[name]} here" for name in different)
            raise InputError(f"{folder} holds another sweep: {told}.\n  fix: give another directory, or remove it")
        self._compare(chunks, compute)

    def _compare(self, chunks: int, compute: Callable[[int], Columns]) -> None:
        """One chunk that is there is computed again: the function may be another one."""
        first = next((k for k in range(chunks) if self.have(k)), None)
        if first is None:
            return
        for own, new in zip(self.read(first), compute(first), strict=True):
            own, new = own.astype(float), new.astype(float)
            scale = np.max(np.abs(np.where(np.isfinite(new), new, 0.0)), axis=0)
            if not np.isclose(own, new, rtol=_AGREE, atol=_AGREE * scale, equal_nan=True).all():
                raise InputError(
                    f"{self._folder} holds results of another function: chunk {first} computed again differs.\n"
                    "  fix: give another directory, or remove that one"
                )

    def have(self, k: int) -> bool:
        if k not in self._there and self._path(k).exists():
            try:
                shapes = [column.shape for column in self.read(k)]
            except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
                shapes = []
            if shapes == self._shapes(k):
                self._there.add(k)
            else:
                self._path(k).unlink(missing_ok=True)  # it is computed again
        return k in self._there

    def keep(self, k: int, columns: Columns) -> None:
        _whole(self._path(k), lambda file: np.savez(file, *columns))
        self._there.add(k)

    def read(self, k: int) -> Columns:
        with np.load(self._path(k), allow_pickle=False) as found:
            return [found[f"arr_{i}"] for i in range(len(found.files))]

    def _path(self, k: int) -> Path:
        return self._folder / f"{k:06}.npz"


def _whole(path: Path, write: Callable[[Any], Any]) -> None:
    """A file that is complete as soon as it has its name."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    with beside.open("wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(beside, path)


Chunks: TypeAlias = InMemory | OnDisk
