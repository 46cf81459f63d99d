"""Arrays in the memory of a kernel: strided views, loops over them, loads and stores."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..code import NAMES, Code


@dataclasses.dataclass(frozen=True)
class View:
    """An array in memory; each entry consists of as many numbers as the kernel computes members at once.

    Attributes:
        pointer: to its first entry.
        strides: entries from one place along an axis to the next; zero where an axis repeats.
        common: whether an entry is one number, which all members share.
        root: the pointer to the whole buffer of which it is a part.
    """

    pointer: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    common: bool = False
    root: str = ""

    @property
    def kind(self) -> str:
        """LLVM's name of the type of a value."""
        return NAMES[self.dtype]

    @property
    def stored(self) -> str:
        """The same in memory."""
        return "i8" if self.kind == "i1" else self.kind

    def of(self, shape: Sequence[int], strides: Sequence[int]) -> View:
        return dataclasses.replace(self, shape=tuple(shape), strides=tuple(strides))


def steps(shape: Sequence[int]) -> tuple[int, ...]:
    """The strides of an array whose entries follow one another, the last axis fastest."""
    strides = [1] * len(shape)
    for axis in range(len(shape) - 2, -1, -1):
        strides[axis] = strides[axis + 1] * shape[axis + 1]
    return tuple(strides)


def collapsed(shape: Sequence[int], strides: Sequence[Sequence[int]]) -> tuple[tuple[int, ...], list[tuple[int, ...]]]:
    """Axes of several arrays of one shape, merged where they are contiguous in all of them; axes of length one are
    omitted.
    """
    axes: list[tuple[int, list[int]]] = []
    for axis, length in enumerate(shape):
        here = [s[axis] for s in strides]
        if length == 1:
            continue
        if axes and all(before == length * s for before, s in zip(axes[-1][1], here, strict=True)):
            axes[-1] = (axes[-1][0] * length, here)
        else:
            axes.append((length, here))
    return tuple(n for n, _ in axes), [tuple(here[k] for _, here in axes) for k in range(len(strides))]


class Loops:
    """The instructions of a kernel on arrays in memory.

    Args:
        code: with as many lanes as members are computed side by side.
        widest: entries of one array that are computed side by side, a power of two; one where members are.
    """

    def __init__(self, code: Code, widest: int) -> None:
        self.code, self.widest = code, widest
        #: Bytes of all buffers.
        self.size = 0
        #: The pointer to the buffers.
        self.scratch = "%buffers"

    # ---- numbers of entries --------------------------------------------------------------------------------------

    def plus(self, a: str, b: str) -> str:
        """a + b of places; numbers are added here."""
        if a.isdigit() and b.isdigit():
            return str(int(a) + int(b))
        return a if b == "0" else b if a == "0" else self.code.emit(f"add i64 {a}, {b}")

    def times(self, a: str, factor: int) -> str:
        """factor a of a place."""
        if a.isdigit():
            return str(int(a) * factor)
        return a if factor == 1 else "0" if factor == 0 else self.code.emit(f"mul i64 {a}, {factor}")

    def at(self, view: View, *places: str) -> str:
        """The entry at places along the first axes."""
        entry = "0"
        for place, stride in zip(places, view.strides, strict=False):
            entry = self.plus(entry, self.times(place, stride))
        return entry

    def within(self, view: View, *places: str) -> View:
        """Part of an array: at places along its first axes."""
        pointer = self._address(view, self.at(view, *places))
        rest = len(places)
        return dataclasses.replace(view, pointer=pointer, shape=view.shape[rest:], strides=view.strides[rest:])

    def width(self, length: int) -> int:
        """How many entries along an axis are computed side by side."""
        return min(self.widest, 1 << (length.bit_length() - 1)) if length else 1

    # ---- memory --------------------------------------------------------------------------------------------------

    def buffer(self, dtype: np.dtype[Any], shape: Sequence[int], strides: Sequence[int] | None = None) -> View:
        """A new array."""
        strides = steps(shape) if strides is None else strides
        entries = 1 + sum((n - 1) * s for n, s in zip(shape, strides, strict=True)) if all(shape) else 0
        pointer = self.code.emit(f"getelementptr i8, ptr {self.scratch}, i64 {self.size}")
        self.size += -(-entries * self.code.lanes * dtype.itemsize // 64) * 64
        return View(pointer, dtype, tuple(shape), tuple(strides), False, pointer)

    def table(self, array: np.ndarray[Any, Any]) -> View:
        """An array of numbers."""
        return View(self.code.module.numbers(array), array.dtype, array.shape, steps(array.shape), True)

    def load(self, view: View, entry: str, width: int = 1, stride: int = 1) -> str:
        """Entries of an array side by side, or the one that all repeat where the stride is zero."""
        code, place = self.code, self._address(view, entry)
        if width == 1 and view.common and code.lanes > 1:
            return self._truth(code, view, code.spread(view.stored, self._one(view, place)))
        if width == 1:
            value = code.emit(f"load {code.vector(view.stored)}, ptr {place}, align {view.dtype.itemsize}")
            return self._truth(code, view, value)
        wide = code.of(width)
        if stride == 0:
            return self._truth(wide, view, wide.spread(view.stored, self._one(view, place)))
        value = code.emit(f"load {wide.vector(view.stored)}, ptr {place}, align {view.dtype.itemsize}")
        return self._truth(wide, view, value)

    def store(self, view: View, entry: str, value: str, width: int = 1) -> None:
        """Write entries side by side."""
        code = self.code if width == 1 else self.code.of(width)
        if view.kind == "i1":
            value = code.convert("zext", "i1", "i8", value)
        place, kind = self._address(view, entry), code.vector(view.stored)
        self.code.lines.append(f"store {kind} {value}, ptr {place}, align {view.dtype.itemsize}")

    def member(self, view: View, entries: Sequence[str]) -> list[str]:
        """The address of an entry for each member, where members read different ones."""
        places = [self._address(view, entry) for entry in entries]
        if view.common:
            return places
        return [self.code.emit(f"getelementptr {view.stored}, ptr {p}, i64 {k}") for k, p in enumerate(places)]

    def gathered(self, view: View, entries: Sequence[str]) -> str:
        """A different entry for each member."""
        code, value = self.code, "poison"
        for lane, place in enumerate(self.member(view, entries)):
            value = code.put(view.stored, value, lane, self._one(view, place))
        return self._truth(code, view, value)

    def scattered(self, view: View, entries: Sequence[str], value: str) -> None:
        """Write a different entry for each member."""
        value = self.code.convert("zext", "i1", "i8", value) if view.kind == "i1" else value
        for place, one in zip(self.member(view, entries), self.lanes_of(view.stored, value), strict=True):
            self.code.lines.append(f"store {view.stored} {one}, ptr {place}, align {view.dtype.itemsize}")

    def lanes_of(self, kind: str, value: str) -> list[str]:
        """The number of each member."""
        return [self.code.entry(kind, value, lane) for lane in range(self.code.lanes)]

    def _one(self, view: View, place: str) -> str:
        return self.code.emit(f"load {view.stored}, ptr {place}, align {view.dtype.itemsize}")

    def _truth(self, code: Code, view: View, value: str) -> str:
        return code.instruction("icmp ne", "i8", value, "zeroinitializer") if view.kind == "i1" else value

    def _address(self, view: View, entry: str) -> str:
        if entry == "0":
            return view.pointer
        lanes = 1 if view.common else self.code.lanes
        return self.code.emit(f"getelementptr [{lanes} x {view.stored}], ptr {view.pointer}, i64 {entry}")

    # ---- loops ---------------------------------------------------------------------------------------------------

    def loop(
        self,
        first: str,
        stop: str,
        body: Callable[[str, list[str]], Sequence[str]],
        carried: Sequence[tuple[str, str]] = (),
    ) -> list[str]:
        """The values that are carried from first to stop - 1, after the last time.

        Args:
            body: from the number and the values to those of the next time.
            carried: the types of the values, and what they are at first.
        """
        values = [value for _, value in carried]
        if first.isdigit() and stop.isdigit() and int(stop) - int(first) <= 1:
            return values if int(stop) <= int(first) else list(body(first, values))
        code = self.code
        before, head, inside, done = (code.label() for _ in range(4))
        index, following, names = code.name(), code.name(), [code.name() for _ in carried]
        code.lines += [f"br label %{before}", f"{before}:", f"br label %{head}", f"{head}:"]
        phis = len(code.lines)
        more = code.name()
        code.lines += [f"{more} = icmp ult i64 {index}, {stop}", f"br i1 {more}, label %{inside}, label %{done}"]
        code.lines.append(f"{inside}:")
        new, latch = list(body(index, list(names))), code.label()
        code.lines += [f"br label %{latch}", f"{latch}:", f"{following} = add nuw nsw i64 {index}, 1"]
        code.lines += [f"br label %{head}", f"{done}:"]
        pairs = [(index, "i64", first, following)]
        pairs += [(name, kind, start, now) for name, (kind, start), now in zip(names, carried, new, strict=True)]
        code.lines[phis:phis] = [
            f"{name} = phi {kind} [ {start}, %{before} ], [ {now}, %{latch} ]" for name, kind, start, now in pairs
        ]
        return names

    def blocks(self, length: int, width: int, body: Callable[[str], Any]) -> None:
        """Call a body with the first places of blocks of an axis; the last block reaches back into the one before."""

        def block(index: str, _: list[str]) -> list[str]:
            start = self.times(index, width)
            if length % width and not start.isdigit():
                start = self.code.call("i64", "llvm.umin.i64", ("i64", start), ("i64", str(length - width)))
            elif start.isdigit():
                start = str(min(int(start), length - width))
            body(start)
            return []

        self.loop("0", str(-(-length // width)), block)

    def over(
        self, shape: Sequence[int], strides: Sequence[Sequence[int]], width: int, body: Callable[[list[str]], Any]
    ) -> None:
        """Call a body with the entries of several arrays at all places of a shape, `width` along the last axis."""

        def level(axis: int, entries: list[str]) -> None:
            def here(place: str) -> None:
                moved: dict[int, str] = {}
                inner = []
                for entry, stride in zip(entries, strides, strict=True):
                    step = moved.setdefault(stride[axis], self.times(place, stride[axis]))
                    inner.append(self.plus(entry, step))
                level(axis + 1, inner)

            if axis == len(shape):
                body(entries)
            else:
                self.blocks(shape[axis], width if axis == len(shape) - 1 else 1, here)

        level(0, ["0"] * len(strides))
