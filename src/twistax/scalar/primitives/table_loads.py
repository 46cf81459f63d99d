"""Loads from constant tables as operations on scalars, one for each table and offset."""

from __future__ import annotations

import dataclasses
import weakref
from typing import Any

import numpy as np

from .entry import ALWAYS, Entry, Operation, everywhere
from .interface import Nodes, Reader, each
from .table_load import Table, load


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Load(Operation):
    """table[a + offset]. Its derivative is zero.

    Attributes:
        table: the numbers.
        offset: where a counts from.
    """

    table: Table
    offset: int


_KNOWN: weakref.WeakValueDictionary[Any, Load] = weakref.WeakValueDictionary()


def load_of(table: Table, offset: int, dtype: np.dtype[Any]) -> Load:
    """The unique operation that loads from a table, at an offset, in a type."""
    key = (table, offset, dtype)
    operation = _KNOWN.get(key)
    if operation is None:
        numbers = table.numbers(dtype)
        operation = _KNOWN[key] = Load(
            name="table_load",
            number=lambda place: numbers[np.asarray(place) + offset],
            array=lambda place: load(table, place, dtype, offset),
            result=dtype,
            inside=ALWAYS,
            llvm=everywhere(lambda code, kind, place: code.table_load(table, offset, dtype, kind, place)),
            c=everywhere(f"{table.name}[$a + {offset}]" if offset else f"{table.name}[$a]"),
            casadi=everywhere(lambda casadi, place: _by_casadi(casadi, table, offset, place)),
            table=table,
            offset=offset,
        )
    return operation


def _by_casadi(casadi: Any, table: Table, offset: int, place: Any) -> Any:
    """CasADi's matrix expressions have loads; its scalar ones, SX, have none."""
    return casadi.MX(casadi.DM(table.values)).nz[place + offset]


def _read(reader: Reader, eqn: Any, place: Nodes) -> list[Nodes]:
    p = eqn.params
    return [each(load_of(p["table"], p["offset"], p["dtype"]).on(reader.graph), place)]


#: In the table of primitives.
TABLE_LOAD = Entry("table_load", _read, "table offset dtype", inside=ALWAYS)
