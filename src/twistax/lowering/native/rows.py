"""Reading and writing rows: lane k of a vector is the entry of row k."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..scalar.in_llvm import NAMES
from .code import Code

__all__ = ["Array", "Rows"]


@dataclasses.dataclass(frozen=True)
class Array:
    """An argument or a result: rows of so many numbers of a type."""

    size: int
    dtype: np.dtype[Any]

    @property
    def kind(self) -> str:
        """LLVM's name of the type of a value."""
        return NAMES[self.dtype]

    @property
    def stored(self) -> str:
        """The same in memory."""
        return "i8" if self.kind == "i1" else self.kind


class Rows:
    """The rows of one array from a pointer on: as many as there are lanes, or fewer, and the last one fills the rest.

    Args:
        code: where instructions go.
        array: what is read or written.
        base: the pointer.
        places: the number of the row of each lane.
    """

    def __init__(self, code: Code, array: Array, base: str, places: list[str]) -> None:
        self._code = code
        self._array = array
        # Parts of vectors are moved whole only where a row has as many numbers, or masks are free.
        self._blocks = array.kind in ("double", "float") and (array.size >= code.lanes or code.module.processor.masks)
        self._pointers = [
            code.emit(
                f"getelementptr {array.stored}, ptr {base}, i64 {code.emit(f'mul nuw nsw i64 {place}, {array.size}')}"
            )
            for place in places
        ]
        self._read: dict[int, str] = {}

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

    def write(self, values: list[str]) -> None:
        """All entries of all rows."""
        code, size = self._code, self._array.size
        if not self._blocks:
            for entry, value in enumerate(values):
                self._scatter(entry, value)
            return
        for first in range(0, size, code.lanes):
            start, width = self._block(first)
            columns = values[start : start + width] + ["zeroinitializer"] * (code.lanes - width)
            self._stored(start, width, self._transposed(columns))

    def _block(self, entry: int) -> tuple[int, int]:
        """The first entry of the block that an entry is in, and how many there are; the last block reaches back."""
        lanes, size = self._code.lanes, self._array.size
        if size < lanes:
            return 0, size
        return min(entry // lanes * lanes, size - lanes), lanes

    def _loaded(self, start: int, width: int) -> list[str]:
        code, kind = self._code, self._array.kind
        own = code.vector(kind)
        found = []
        for place in self._at(start):
            if width == code.lanes:
                found.append(code.emit(f"load {own}, ptr {place}, align {self._alignment}"))
                continue
            name, mask = f"llvm.masked.load.{self._suffix}.p0", self._mask(width)
            code.module.declarations.add(f"declare {own} @{name}(ptr, i32, {code.vector('i1')}, {own})")
            found.append(
                code.emit(f"call {own} @{name}(ptr {place}, i32 {self._alignment}, {mask}, {own} zeroinitializer)")
            )
        return found

    def _stored(self, start: int, width: int, rows: list[str]) -> None:
        code, own = self._code, self._code.vector(self._array.kind)
        for place, row in zip(self._at(start), rows, strict=True):
            if width == code.lanes:
                code.lines.append(f"store {own} {row}, ptr {place}, align {self._alignment}")
                continue
            name, mask = f"llvm.masked.store.{self._suffix}.p0", self._mask(width)
            code.module.declarations.add(f"declare void @{name}({own}, ptr, i32, {code.vector('i1')})")
            code.lines.append(f"call void @{name}({own} {row}, ptr {place}, i32 {self._alignment}, {mask})")

    def _gathered(self, entry: int) -> str:
        code, array = self._code, self._array
        own, value = code.vector(array.stored), "poison"
        for lane, place in enumerate(self._at(entry)):
            one = code.emit(f"load {array.stored}, ptr {place}, align {self._alignment}")
            value = code.emit(f"insertelement {own} {value}, {array.stored} {one}, i32 {lane}")
        return code.emit(f"icmp ne {own} {value}, zeroinitializer") if array.kind == "i1" else value

    def _scatter(self, entry: int, value: str) -> None:
        code, array = self._code, self._array
        if array.kind == "i1":
            value = code.convert("zext", "i1", "i8", value)
        for lane, place in enumerate(self._at(entry)):
            one = code.emit(f"extractelement {code.vector(array.stored)} {value}, i32 {lane}")
            code.lines.append(f"store {array.stored} {one}, ptr {place}, align {self._alignment}")

    def _at(self, entry: int) -> list[str]:
        stored = self._array.stored
        return [self._code.emit(f"getelementptr {stored}, ptr {p}, i64 {entry}") for p in self._pointers]

    @property
    def _alignment(self) -> int:
        return self._array.dtype.itemsize

    @property
    def _suffix(self) -> str:
        return f"v{self._code.lanes}{'f64' if self._array.kind == 'double' else 'f32'}"

    def _mask(self, width: int) -> str:
        bits = ", ".join(f"i1 {'true' if k < width else 'false'}" for k in range(self._code.lanes))
        return f"{self._code.vector('i1')} <{bits}>"

    def _transposed(self, rows: list[str]) -> list[str]:
        """Entry i of vector k becomes entry k of vector i: blocks of 1, 2, 4, ... change places in pairs."""
        code, own = self._code, self._code.vector(self._array.kind)
        lanes, size, found = code.lanes, 1, list(rows)
        while size < lanes:
            paired = list(found)
            for k in (k for k in range(lanes) if not k & size):
                low = [j if not j & size else lanes + j - size for j in range(lanes)]
                high = [j + size if not j & size else lanes + j for j in range(lanes)]
                for mask, place in ((low, k), (high, k + size)):
                    order = ", ".join(f"i32 {j}" for j in mask)
                    paired[place] = code.emit(
                        f"shufflevector {own} {found[k]}, {own} {found[k + size]}, <{lanes} x i32> <{order}>"
                    )
            found, size = paired, 2 * size
        return found
