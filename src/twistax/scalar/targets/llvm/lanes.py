"""Reading and writing of rows: lane k of a vector is the entry of row k."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from .code import NAMES, Code


@dataclasses.dataclass(frozen=True)
class Array:
    """An argument or a result: its shape in one row, and its type.

    One that is long has an axis in front of that shape, of a length that is known only at run time.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    long: bool = False

    @property
    def size(self) -> int:
        """Entries, of a long one at each place of that axis."""
        return math.prod(self.shape)

    def of_length(self, length: int) -> tuple[int, ...]:
        """The whole shape."""
        return (length, *self.shape) if self.long else self.shape

    @property
    def kind(self) -> str:
        """LLVM's name of the type of a value."""
        return NAMES[self.dtype]

    @property
    def stored(self) -> str:
        """The same in memory."""
        return "i8" if self.kind == "i1" else self.kind


#: The length of long arrays: the first argument of a function that has some.
COUNT = Array((), np.dtype(np.int32))


class Rows:
    """The rows of one array, one for each lane.

    Args:
        pointers: to the first entry of the row of each lane.
        entry_stride: entries of memory from one entry of a row to the next.
    """

    def __init__(self, code: Code, array: Array, pointers: Iterable[str], entry_stride: str = "1") -> None:
        self._code = code
        self._array = array
        # Blocks of entries move as vectors only if a row has a full block, or masks are free.
        self._blocks = array.kind in ("double", "float") and (array.size >= code.lanes or code.module.processor.masks)
        self.pointers = list(pointers)
        self._align, self._entry_stride = array.dtype.itemsize, entry_stride
        self._read: dict[int, str] = {}

    def window(self, starts: Sequence[str], array: Array) -> Rows:
        """Part of each row: an array from an entry on, for each lane, that is known only at run time."""
        pointers = [self._moved(p, start) for p, start in zip(self.pointers, starts, strict=True)]
        return Rows(self._code, array, pointers, self._entry_stride)

    def read(self, entry: int) -> str:
        """The value of an entry in all rows."""
        if entry not in self._read:
            if self._blocks:
                start, width = self._block(entry)
                for k, value in enumerate(self._transposed(self._loaded(start, width))[:width]):
                    self._read[start + k] = value
            else:
                self._read[entry] = self._gathered(entry)
        return self._read[entry]

    def clear(self) -> None:
        """Zeros in all entries of all rows, which stand one after the other."""
        size = str(self._array.size * self._align)
        for pointer in self.pointers:
            self._code.call("void", "llvm.memset.p0.i64", ("ptr", pointer), ("i8", "0"), ("i64", size), ("i1", "false"))

    def write(self, values: list[str]) -> None:
        """All entries of all rows."""
        for start, entries in self.blocks().items():
            self.write_block(start, [values[entry] for entry in entries])

    def blocks(self) -> dict[int, list[int]]:
        """The entries that are written together, by the first of them."""
        size = self._array.size
        if not self._blocks:
            return {entry: [entry] for entry in range(size)}
        widths = dict(self._block(first) for first in range(0, size, self._code.lanes))
        return {start: list(range(start, start + width)) for start, width in widths.items()}

    def write_block(self, start: int, values: list[str]) -> None:
        """The entries of a block of all rows."""
        if not self._blocks:
            self._scatter(start, values[0])
            return
        width = len(values)
        columns = values + ["zeroinitializer"] * (self._code.lanes - width)
        self._stored(start, width, self._transposed(columns))

    def _block(self, entry: int) -> tuple[int, int]:
        """The first entry of the block that an entry is in, and how many there are; the last block reaches back."""
        lanes, size = self._code.lanes, self._array.size
        if size < lanes:
            return 0, size
        return min(entry // lanes * lanes, size - lanes), lanes

    def _loaded(self, start: int, width: int) -> list[str]:
        code, kind, places = self._code, self._array.kind, self._at(start)
        vector_type = code.vector(kind)
        if width == code.lanes:
            return [code.emit(f"load {vector_type}, ptr {place}, align {self._align}") for place in places]
        rest = ("i32", str(self._align)), self._mask(width), (vector_type, "zeroinitializer")
        name = f"llvm.masked.load.{code.suffix(kind)}.p0"
        return [code.call(vector_type, name, ("ptr", place), *rest) for place in places]

    def _stored(self, start: int, width: int, rows: list[str]) -> None:
        code, kind = self._code, self._array.kind
        vector_type, rest = code.vector(kind), (("i32", str(self._align)), self._mask(width))
        for place, row in zip(self._at(start), rows, strict=True):
            if width == code.lanes:
                code.lines.append(f"store {vector_type} {row}, ptr {place}, align {self._align}")
            else:
                name = f"llvm.masked.store.{code.suffix(kind)}.p0"
                code.call("void", name, (vector_type, row), ("ptr", place), *rest)

    def _gathered(self, entry: int) -> str:
        code, array = self._code, self._array
        vector_type, value = code.vector(array.stored), "poison"
        for lane, place in enumerate(self._at(entry)):
            one = code.emit(f"load {array.stored}, ptr {place}, align {self._align}")
            value = code.put(array.stored, value, lane, one)
        return code.emit(f"icmp ne {vector_type} {value}, zeroinitializer") if array.kind == "i1" else value

    def _scatter(self, entry: int, value: str) -> None:
        code, array = self._code, self._array
        if array.kind == "i1":
            value = code.convert("zext", "i1", "i8", value)
        for lane, place in enumerate(self._at(entry)):
            one = code.entry(array.stored, value, lane)
            code.lines.append(f"store {array.stored} {one}, ptr {place}, align {self._align}")

    def _at(self, entry: int) -> list[str]:
        return [self._moved(p, str(entry)) for p in self.pointers]

    def _moved(self, pointer: str, entries: str) -> str:
        place = (
            entries
            if self._entry_stride == "1"
            else self._code.emit(f"mul nuw nsw i64 {entries}, {self._entry_stride}")
        )
        return self._code.emit(f"getelementptr {self._array.stored}, ptr {pointer}, i64 {place}")

    def _mask(self, width: int) -> tuple[str, str]:
        bits = ", ".join(f"i1 {'true' if k < width else 'false'}" for k in range(self._code.lanes))
        return self._code.vector("i1"), f"<{bits}>"

    def _transposed(self, rows: list[str]) -> list[str]:
        """Entry i of vector k becomes entry k of vector i: blocks of 1, 2, 4, ... change places in pairs."""
        code, vector_type = self._code, self._code.vector(self._array.kind)
        lanes, size, vectors = code.lanes, 1, list(rows)
        while size < lanes:
            paired = list(vectors)
            for k in (k for k in range(lanes) if not k & size):
                low = [j if not j & size else lanes + j - size for j in range(lanes)]
                high = [j + size if not j & size else lanes + j for j in range(lanes)]
                for mask, place in ((low, k), (high, k + size)):
                    order = ", ".join(f"i32 {j}" for j in mask)
                    pair = f"{vector_type} {vectors[k]}, {vector_type} {vectors[k + size]}"
                    paired[place] = code.emit(f"shufflevector {pair}, <{lanes} x i32> <{order}>")
            vectors, size = paired, 2 * size
        return vectors


class ColumnArray(Rows):
    """Rows in memory by columns: the entries of all lanes one after the other."""

    def __init__(self, code: Code, array: Array, pointers: Iterable[str]) -> None:
        super().__init__(code, array, pointers)
        self._blocks = False

    def clear(self) -> None:
        size = str(self._array.size * self._code.lanes * self._align)
        (pointer,) = self.pointers
        self._code.call("void", "llvm.memset.p0.i64", ("ptr", pointer), ("i8", "0"), ("i64", size), ("i1", "false"))

    def _gathered(self, entry: int) -> str:
        return self._code.emit(
            f"load {self._code.vector(self._array.kind)}, ptr {self._place(entry)}, align {self._align}"
        )

    def _scatter(self, entry: int, value: str) -> None:
        vector = self._code.vector(self._array.kind)
        self._code.lines.append(f"store {vector} {value}, ptr {self._place(entry)}, align {self._align}")

    def _place(self, entry: int) -> str:
        return self._moved(self.pointers[0], str(entry * self._code.lanes))
