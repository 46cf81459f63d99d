"""Loops over arrays: the innermost axis in vectors, as many entries at a time as go into one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..code import NAMES, Code, Module
from .memory import Space, View, dense

#: Loops of so few turns are written out.
_UNROLLED = 2

#: What is done with vectors: given the code of so many lanes and the values that were read, those to be written.
Body = Callable[[Code, Sequence[Callable[[], str]]], Sequence[str]]


class ArrayCode:
    """The instructions of a function of arrays.

    Attributes:
        code: of one lane.
        lanes: entries in a vector.
        space: where arrays lie meanwhile.
        kernels: of programs that are called; they must live as long as the code.
    """

    def __init__(self, module: Module) -> None:
        self.module = module
        self.code = Code(module, 1)
        self.lanes = max(2, module.processor.lanes(np.dtype(np.float64)))
        self.space = Space()
        self.kernels: list[Any] = []

    def new(self, shape: Sequence[int], dtype: Any, like: NDArray[Any] | None = None) -> View:
        """An array that is yet to be written; see `dense`."""
        return self.space.view(dense(shape, dtype, like))

    def stored(self, view: View) -> View:
        """A view in memory, also of what is known."""
        if not view.known:
            return view
        numbers = np.ascontiguousarray(view.array)
        return View(self.module.numbers(numbers), numbers.__array_interface__["data"][0], numbers, numbers)

    def copied(self, view: View, to: View | None = None, like: NDArray[Any] | None = None) -> View:
        """The same numbers in another place, or in a new and dense one."""
        target = self.new(view.shape, view.dtype, like) if to is None else to
        self.each([view], [target], lambda code, read: [read[0]()])
        return target

    def _readable(self, view: View) -> View:
        """In memory, or one known number."""
        number = view.number
        return self.stored(view) if number is None else view.seen(np.broadcast_to(number, view.shape))

    # ---- loops ---------------------------------------------------------------------------------------------------

    def counted(
        self, count: int, body: Callable[[str, list[str]], list[str]], carried: Sequence[tuple[str, str]] = ()
    ) -> list[str]:
        """What is done for 0, 1, ..., count - 1, with values that go round: types, and values the first time."""
        values = [first for _, first in carried]
        if count <= _UNROLLED:
            for k in range(count):
                values = body(str(k), values)
            return values
        code = self.code
        index, names = code.name(), [code.name() for _ in carried]
        end = code.loop([(index, "i64", "0"), *((n, kind, v) for n, (kind, v) in zip(names, carried, strict=True))])
        values = body(index, names)
        following = code.emit(f"add nuw nsw i64 {index}, 1")
        end([following, *values], code.emit(f"icmp ult i64 {following}, {count}"))
        return values

    def along(self, view: View, axis: int, index: str, step: int = 1) -> View:
        """The view at step * index along an axis, which goes."""
        array, stride = view.array, step * view.array.strides[axis]
        rest = array[(slice(None),) * axis + (0,)]
        # NumPy gives a scalar of one entry of a vector.
        return self.at(view.seen(np.asarray(rest) if rest.ndim else array.reshape(-1)[:1].reshape(())), index, stride)

    def at(self, view: View, index: str, stride: int) -> View:
        """The same view so many bytes on, times an index."""
        if view.known or not stride or index == "0":
            return view
        if index.isdigit():
            return view.moved(None, int(index) * stride)
        bytes = self.code.emit(f"mul nsw i64 {index}, {stride}")
        return view.moved(self.code.emit(f"getelementptr i8, ptr {view.base}, i64 {bytes}"))

    def nested(self, shape: Sequence[int], views: Sequence[View], body: Callable[[list[View]], None]) -> None:
        """What is done for all places of the first axes, of this shape, of views."""
        if not shape:
            body(list(views))
            return

        def inner(index: str, _: list[str]) -> list[str]:
            self.nested(shape[1:], [self.along(own, 0, index) for own in views], body)
            return []

        self.counted(shape[0], inner)

    def pieces(self, count: int, body: Callable[[Code, str, int], None]) -> None:
        """What is done for `count` entries side by side: body(code, index, first), at entry index * lanes + first."""
        full, rest = divmod(count, self.lanes)

        def inner(index: str, _: list[str]) -> list[str]:
            body(self.code.of(self.lanes), index, 0)
            return []

        self.counted(full, inner)
        if rest:
            body(self.code.of(rest), "0", full * self.lanes)

    def each(self, sources: Sequence[View], targets: Sequence[View], body: Body) -> None:
        """What is done entry by entry: views of one shape, those that are read and those that are written."""
        shape = targets[0].shape
        if 0 in shape:
            return
        sources = [self._readable(own) for own in sources]
        views = merged([*sources, *targets], targets[0].array)
        *outer, inner = views[0].shape or (1,)
        if not views[0].shape:
            views = [own.seen(own.array.reshape(1)) for own in views]

        def line(own: list[View]) -> None:
            def piece(code: Code, index: str, first: int) -> None:
                here = [self.at(v, index, self.lanes * v.array.strides[-1]) for v in own]
                read = [_reader(self, code, v, first) for v in here[: len(sources)]]
                values = body(code, read)
                for target, value in zip(here[len(sources) :], values, strict=True):
                    self.write(code, target, first, value)

            self.pieces(inner, piece)

        self.nested(outer, views, line)

    # ---- vectors -------------------------------------------------------------------------------------------------

    def read(self, code: Code, view: View, first: int = 0) -> str:
        """As many entries of a view of one axis as there are lanes."""
        kind, stride = NAMES[view.dtype], view.array.strides[0]
        if view.known:
            return code.constant(kind, view.number)
        if code.lanes > 1 and stride == 0:
            return code.spread(kind, self.read(code.of(1), view.seen(view.array[:1])))
        if code.lanes > 1 and stride != view.dtype.itemsize:
            found, one = "poison", code.of(1)
            for lane in range(code.lanes):
                found = code.put(kind, found, lane, self.read(one, view, first + lane))
            return found
        memory = "i8" if kind == "i1" else kind
        place = self._pointer(view, first * stride)
        value = code.emit(f"load {code.vector(memory)}, ptr {place}, align {view.dtype.itemsize}")
        return code.emit(f"icmp ne {code.vector(memory)} {value}, zeroinitializer") if kind == "i1" else value

    def write(self, code: Code, view: View, first: int, value: str) -> None:
        """As many entries as there are lanes."""
        kind, stride = NAMES[view.dtype], view.array.strides[0]
        if code.lanes > 1 and stride != view.dtype.itemsize:
            for lane in range(code.lanes):
                self.write(code.of(1), view, first + lane, code.entry(kind, value, lane))
            return
        memory = "i8" if kind == "i1" else kind
        if kind == "i1":
            value = code.convert("zext", "i1", "i8", value)
        place = self._pointer(view, first * stride)
        code.lines.append(f"store {code.vector(memory)} {value}, ptr {place}, align {view.dtype.itemsize}")

    def scalar(self, view: View) -> str:
        """The entry of a view of one."""
        return self.read(self.code, view.seen(view.array.reshape(1)))

    def pointer(self, view: View) -> str:
        """Where the first entry lies."""
        return self._pointer(view, 0)

    def _pointer(self, view: View, more: int) -> str:
        bytes = view.offset + more
        return self.code.emit(f"getelementptr i8, ptr {view.base}, i64 {bytes}") if bytes else str(view.base)


def _reader(own: ArrayCode, code: Code, view: View, first: int) -> Callable[[], str]:
    return lambda: own.read(code, view, first)


def merged(views: Sequence[View], main: NDArray[Any] | None = None) -> list[View]:
    """The same views with as few axes as there can be, in the order of one's memory, if it is given."""
    arrays = [own.array for own in views]
    if main is not None:
        order = sorted(range(main.ndim), key=lambda d: -abs(main.strides[d]))
        arrays = [a.transpose(order) for a in arrays]
    keep = [d for d, size in enumerate(arrays[0].shape) if size != 1]
    arrays = [a[tuple(slice(None) if d in keep else 0 for d in range(a.ndim))] if keep else a for a in arrays]
    if not keep:
        return [own.seen(a.reshape(())) for own, a in zip(views, arrays, strict=True)]
    d = arrays[0].ndim - 2
    while d >= 0:
        if all(a.strides[d] == a.strides[d + 1] * a.shape[d + 1] for a in arrays):
            shape = (*arrays[0].shape[:d], -1, *arrays[0].shape[d + 2 :])
            arrays = [a.reshape(shape) for a in arrays]
        d -= 1
    return [own.seen(a) for own, a in zip(views, arrays, strict=True)]


def reshaped(own: ArrayCode, view: View, shape: Sequence[int]) -> View:
    """A view of another shape; a copy where there is none of that memory."""
    found = view.array.reshape(tuple(shape))
    if view.known or not found.size or np.may_share_memory(found, view.array):
        return view.seen(found)
    return reshaped(own, own.copied(view), shape)
