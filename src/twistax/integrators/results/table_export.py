"""A solution as a table: columns with names and units, written to a file or converted to a DataFrame."""

from __future__ import annotations

import csv
import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from ...checks import instance, listed, path_of, short
from ...errors import InputError, ModelError, ShapeError
from ...groups import ElementPart, euler, quaternion
from ...groups.columns import Column, Layout
from ..times import room_for


@dataclasses.dataclass(frozen=True)
class Rotations:
    """The columns of a rotation in a table.

    Attributes:
        names: the names of the columns.
        unit: their common unit.
        read: converts a rotation (3, 3) to these numbers; traceable.
    """

    names: tuple[str, ...]
    unit: str
    read: Callable[[Any], Any]


def _entries(R: Any) -> Any:
    return R.reshape(-1)


#: (w, x, y, z) with w >= 0.
QUATERNION = Rotations(("qw", "qx", "qy", "qz"), "", quaternion)
#: R = Rz(yaw) Ry(pitch) Rx(roll).
EULER = Rotations(("roll", "pitch", "yaw"), "rad", euler)
#: All nine entries, row by row.
MATRIX = Rotations(tuple(f"R{i}{j}" for i in "123" for j in "123"), "", _entries)


@dataclasses.dataclass(frozen=True)
class Columns(Layout):
    """The default layout: time, then all states, controls and outputs, as `name`, `name[i]` or `name[i][j]`.

    A rotation has the columns `name.qw` and so on; the columns of a pose begin with its position, `name.x`, `name.y`,
    `name.z`.

    Attributes:
        units: units by name of a state, control or output: a text for all entries (for a pose, of its position), or a
            list with a text for each entry.
        rotations: `tx.columns.QUATERNION`, `EULER` or `MATRIX`.

    Raises:
        ModelError: units that are not texts; rotations of another type.
    """

    units: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    rotations: Rotations = QUATERNION

    def __post_init__(self) -> None:
        instance("Columns: rotations", self.rotations, Rotations, "one as tx.columns.QUATERNION", ModelError)
        instance("Columns: units", self.units, Mapping, "a dict from names to texts", ModelError)
        for name, unit in self.units.items():
            texts = [unit] if isinstance(unit, str) else unit
            if not isinstance(texts, (list, tuple)) or not all(isinstance(text, str) for text in texts):
                raise ModelError(f"Columns: the unit of {name!r} must be a text or a list of texts, got {short(unit)}")

    def columns(self, solution: Any) -> list[Column]:
        """Raises InputError for a unit of an unknown name, ShapeError for a list of units of another length."""
        values = {**solution.xs, **solution.us, **solution.outputs}
        unknown = [name for name in self.units if name not in values]
        if unknown:
            raise InputError(f"units names {unknown[0]!r}; the columns are of: {listed(values, unknown[0])}")
        dynamics = solution.stepper.dynamics
        order = [
            *(leaf.name for leaf in (*dynamics.states, *dynamics.controls)),
            *dynamics.functions.families["outputs"],
        ]
        table = [Column("t", "s", np.asarray(solution.ts))]
        for name in order:
            if name in values:
                table += self._of(name, dynamics.group.factors.get(name), np.asarray(values[name]))
        return table

    def _of(self, name: str, group: Any, array: np.ndarray) -> list[Column]:
        if group is None or group.flat or (len(group.parts) == 1 and not group.rigid):
            return self._entries(name, name, array)
        return [column for part in group.parts for column in self._of_part(name, part, part.of(array))]

    def _of_part(self, name: str, part: ElementPart, array: np.ndarray) -> list[Column]:
        """The columns of a part of an element: a rotation, a position, or entries."""
        if part.unit == "rad" and array.shape[1:] == (3, 3):
            numbers = _read(self.rotations, array)
            return [
                Column(f"{name}.{label}", self.rotations.unit, v)
                for label, v in zip(self.rotations.names, numbers.T, strict=True)
            ]
        if part.sized and array.ndim == 2 and array.shape[1] <= 3:
            units = self._units(name, array.shape[1])
            return [Column(f"{name}.{axis}", units[k], array[:, k]) for k, axis in zip(range(array.shape[1]), "xyz")]
        return self._entries(f"{name}.{part.name}", name, array)

    def _entries(self, label: str, name: str, array: np.ndarray) -> list[Column]:
        shape = array.shape[1:]
        units = self._units(name, int(np.prod(shape)))
        labels = [label + "".join(f"[{i}]" for i in index) for index in np.ndindex(*shape)]
        entries = array.reshape(len(array), -1).T
        return [Column(*column) for column in zip(labels, units, entries, strict=True)]

    def _units(self, name: str, count: int) -> list[str]:
        unit = self.units.get(name, "")
        if isinstance(unit, str):
            return [unit] * count
        if len(unit) != count:
            raise ShapeError(f"units of {name!r} expects one text or a list of {count}, got {len(unit)}")
        return list(unit)


@functools.lru_cache
def _mapped(rotations: Rotations) -> Callable[[Any], Any]:
    return jax.jit(jax.vmap(rotations.read))


def _read(rotations: Rotations, R: np.ndarray) -> np.ndarray:
    """The numbers of rotations (n, 3, 3), (n, m)."""
    if not len(R):
        return np.zeros((0, len(rotations.names)), R.dtype)
    last = np.minimum(np.arange(room_for(len(R), 9)), len(R) - 1)
    return np.asarray(_mapped(rotations)(R[last]))[: len(R)]


def columns_of(solution: Any, layout: Any) -> list[Column]:
    """The columns of one solution.

    Raises:
        ModelError: an object that is not a layout, or a layout that does not return columns.
        ShapeError: a column of the wrong length.
    """
    layout = Columns() if layout is None else layout
    instance("layout", layout, Layout, "one like tx.columns.Columns(units=...)", ModelError)
    columns = layout.columns(solution)
    if not isinstance(columns, list) or not all(isinstance(column, Column) for column in columns):
        raise ModelError(
            f"{type(layout).__name__}.columns must return a list of tx.columns.Column, got {short(columns)}"
        )
    columns = [Column(column.name, column.unit, np.asarray(column.values)) for column in columns]
    for column in columns:
        if column.values.shape != np.shape(solution.ts):
            raise ShapeError(
                f"column {column.header!r} expects a number for each of {len(solution.ts)} saved times, "
                f"got shape {column.values.shape}"
            )
    return columns


def write_csv(columns: list[Column], path: Any) -> None:
    """Write a row of headers, then the numbers with all their digits. Raises InputError if the
    file cannot be written.
    """
    target = path_of("to_csv: path", path)
    try:
        with target.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([column.header for column in columns])
            writer.writerows(zip(*(column.values.tolist() for column in columns), strict=True))
    except OSError as error:
        raise InputError(f"to_csv cannot write {target}: {error.strerror}") from None


def frame_of(columns: list[Column]) -> Any:
    """The columns as a DataFrame.

    Raises:
        ModelError: pandas is not installed.
        InputError: two columns with the same header.
    """
    try:
        import pandas
    except ImportError:
        raise ModelError("to_dataframe needs pandas.\n  fix: pip install 'twistax[tables]', or to_csv(path)") from None
    table = {column.header: column.values for column in columns}
    if len(table) < len(columns):
        headers = [column.header for column in columns]
        twice = next(header for header in headers if headers.count(header) > 1)
        raise InputError(
            f"two columns have the header {twice!r}.\n  fix: change names or units, or use a tx.columns.Layout"
        )
    return pandas.DataFrame(table)
