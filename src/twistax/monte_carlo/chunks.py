"""The chunks of a sweep, in memory or in files from which a sweep can resume."""

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


class Chunks:
    """Chunks by number: in memory, or in a folder with a file for each, which exists only when it is complete.

    Args:
        folder: the folder, created if missing; None for memory.
        setup: the data that identify the sweep to which existing files belong.
        count: the number of chunks.
        shapes: a function from the number of a chunk to the shapes of its columns.
        compute: a function that computes a chunk, from its number.
    Raises:
        InputError: a folder that cannot be used, or that contains another sweep.
    """

    def __init__(
        self,
        folder: Path | None,
        setup: dict[str, Any],
        count: int,
        shapes: Callable[[int], list[tuple[int, ...]]],
        compute: Callable[[int], Columns],
    ) -> None:
        self._folder, self._shapes = folder, shapes
        self._memory: dict[int, Columns] = {}
        self._complete: set[int] = set()
        if folder is not None:
            _check_setup(folder, setup)
            self._compare(folder, count, compute)

    def _compare(self, folder: Path, count: int, compute: Callable[[int], Columns]) -> None:
        """Compute one existing chunk again and compare it, because the function may have changed."""
        first = next((k for k in range(count) if k in self), None)
        if first is None:
            return
        for old, new in zip(self.read(first), compute(first), strict=True):
            old, new = old.astype(float), new.astype(float)
            scale = np.max(np.abs(np.where(np.isfinite(new), new, 0.0)), axis=0)
            if not np.isclose(old, new, rtol=_AGREE, atol=_AGREE * scale, equal_nan=True).all():
                raise InputError(
                    f"{folder} contains results of another function: chunk {first} has other values when "
                    "it is computed again.\n  fix: pass another directory, or remove that one"
                )

    def __contains__(self, k: int) -> bool:
        """Whether a chunk is there. A damaged file, or one of other shapes, is removed and computed again."""
        if k in self._complete or k in self._memory or self._folder is None or not self._path(k).exists():
            return k in self._complete or k in self._memory
        try:
            shapes = [column.shape for column in self.read(k)]
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
            shapes = []
        if shapes == self._shapes(k):
            self._complete.add(k)
        else:
            self._path(k).unlink(missing_ok=True)
        return k in self._complete

    def keep(self, k: int, columns: Columns) -> None:
        if self._folder is None:
            self._memory[k] = columns
        else:
            _write(self._path(k), lambda file: np.savez(file, *columns))
            self._complete.add(k)

    def read(self, k: int) -> Columns:
        if self._folder is None:
            return self._memory[k]
        with np.load(self._path(k), allow_pickle=False) as arrays:
            return [arrays[f"arr_{i}"] for i in range(len(arrays.files))]

    def _path(self, k: int) -> Path:
        assert self._folder is not None
        return self._folder / f"{k:06}.npz"


def _check_setup(folder: Path, setup: dict[str, Any]) -> None:
    """Write the setup into a new folder; raise InputError where it has another one, or cannot be used."""
    path = folder / _SETUP
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            _write(path, lambda file: file.write(json.dumps(setup, indent=2).encode()))
        there = json.loads(path.read_text())
        if not isinstance(there, dict):
            raise ValueError(f"{_SETUP} is damaged")
    except (OSError, ValueError) as error:
        raise InputError(f"sweep cannot use the directory {folder}: {error}") from error
    different = [name for name in setup if there.get(name) != setup[name]]
    if different:
        values = ", ".join(f"{name} {there.get(name)} there, {setup[name]} here" for name in different)
        raise InputError(
            f"{folder} contains another sweep: {values}.\n  fix: pass another directory, or remove that one"
        )


def _write(path: Path, write: Callable[[Any], Any]) -> None:
    """Write a file that is complete as soon as it has its name."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    with draft.open("wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(draft, path)
