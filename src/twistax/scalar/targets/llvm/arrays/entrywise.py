"""Entrywise operations and reductions in the memory of a kernel."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from ....graph import ScalarGraph
from ....primitives.interface import Nodes, nodes
from ....primitives.table import OPERATIONS
from ....program import ScalarProgram
from ....reader import JaxprReader
from ..code import NAMES
from ..kernel_body import NATIVE_LIMITS, Scalars, native_form
from .memory import Loops, View, collapsed, steps

#: Expressions of more operations are computed into memory, however often they are used.
_LONGEST = 60


@dataclasses.dataclass(frozen=True, eq=False)
class Lazy:
    """An array whose entries are computed where they are read.

    Attributes:
        make: from a reader and the nodes of one entry of the operands to that of the result.
        operands: arrays of the same shape.
        number: of an array of one number.
    """

    make: Callable[..., Nodes]
    operands: tuple[Value, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    number: Any = None

    @functools.cached_property
    def operations(self) -> int:
        return 1 + sum(operand.operations for operand in self.operands if isinstance(operand, Lazy))


Value: TypeAlias = "View | Lazy"


def number(value: Any, dtype: np.dtype[Any], shape: tuple[int, ...] = ()) -> Lazy:
    """An array of one number."""
    return Lazy(lambda reader: reader.graph.array(np.asarray(value, dtype)), (), shape, dtype, value)


def viewed(value: Value, view: Callable[[View], View], shape: tuple[int, ...]) -> Value:
    """A view of an array, or of all arrays that an expression reads."""
    if isinstance(value, View):
        return view(value)
    return dataclasses.replace(value, operands=tuple(viewed(o, view, shape) for o in value.operands), shape=shape)


def broadcast(value: Value, shape: tuple[int, ...], axes: Sequence[int]) -> Value:
    """An array broadcast along new axes; `axes` are the positions of its axes."""

    def view(old: View) -> View:
        strides = [0] * len(shape)
        for axis, length, stride in zip(axes, old.shape, old.strides, strict=True):
            strides[axis] = 0 if length != shape[axis] else stride
        return old.of(shape, strides)

    return viewed(value, view, shape)


class EntryWriter(Loops):
    """Loops over the entries of entrywise expressions."""

    checked, precision = False, np.dtype(float)

    def assign(self, target: View, value: Value) -> None:
        """Compute an array into memory."""
        leaves, program = self._program(value)
        shape, strides = collapsed(target.shape, [target.strides, *(leaf.strides for leaf in leaves)])
        if not all(target.shape):
            return
        width = self._width(shape, strides)
        if target.root and any(leaf.root == target.root for leaf in leaves):
            # The last block of an axis reaches back: entries that read themselves must not be computed twice.
            while width > 1 and shape[-1] % width:
                width //= 2

        def entry(entries: list[str]) -> None:
            result = self._computed(program, leaves, entries[1:], [s[-1] if s else 0 for s in strides[1:]], width)
            self.store(target, entries[0], result, width)

        self.over(shape, strides, width, entry)

    def stored(self, value: Value) -> View:
        """An array in memory."""
        if isinstance(value, View):
            return value
        target = self.buffer(value.dtype, value.shape)
        self.assign(target, value)
        return target

    def contiguous(self, value: Value) -> View:
        """An array in memory whose entries follow one another."""
        if isinstance(value, View) and value.strides == steps(value.shape):
            return value
        target = self.buffer(value.dtype, value.shape)
        self.assign(target, value)
        return target

    def reduced(self, value: Value, axes: Sequence[int], pair: str, empty: Any) -> View:
        """Entries along axes combined by an operation on two; `empty` is that of none."""
        kept = [axis for axis in range(len(value.shape)) if axis not in axes]
        leaves, program = self._program(value)
        target = self.buffer(value.dtype, [value.shape[axis] for axis in kept])
        spread = [0] * len(value.shape)
        for axis, stride in zip(kept, target.strides, strict=True):
            spread[axis] = stride
        every = [spread, *(leaf.strides for leaf in leaves)]
        outer = collapsed([value.shape[axis] for axis in kept], [[s[axis] for axis in kept] for s in every])
        inner = collapsed([value.shape[axis] for axis in axes], [[s[axis] for axis in axes] for s in every[1:]])
        if not all(target.shape):
            return target
        width = self._width(*outer)
        kind, form = NAMES[value.dtype], OPERATIONS[pair].llvm.of(value.dtype)
        code = self.code if width == 1 else self.code.of(width)
        last = [s[-1] if s else 0 for s in outer[1][1:]]

        def along(axis: int, entries: list[str], total: str) -> str:
            if axis == len(inner[0]):
                return str(form(code, kind, total, self._computed(program, leaves, entries, last, width)))

            def step(place: str, totals: list[str]) -> list[str]:
                moved = [self.plus(e, self.times(place, s[axis])) for e, s in zip(entries, inner[1], strict=True)]
                return [along(axis + 1, moved, totals[0])]

            return self.loop("0", str(inner[0][axis]), step, [(code.vector(kind), total)])[0]

        def entry(entries: list[str]) -> None:
            self.store(target, entries[0], along(0, entries[1:], code.constant(kind, empty)), width)

        self.over(*outer, width, entry)
        return target

    def _width(self, shape: Sequence[int], strides: Sequence[Sequence[int]]) -> int:
        """How many entries are computed side by side: those of the first array follow one another."""
        if not shape or strides[0][-1] != 1 or any(s[-1] not in (0, 1) for s in strides):
            return 1
        return self.width(shape[-1])

    def reads(self, value: Value) -> list[View]:
        """The arrays that an expression reads."""
        return [value] if isinstance(value, View) else [view for o in value.operands for view in self.reads(o)]

    def _program(self, value: Value) -> tuple[list[View], ScalarProgram]:
        """The arrays that an expression reads, and the program of one entry."""
        graph = ScalarGraph(self.precision, self.checked, limits=NATIVE_LIMITS)
        reader, known, leaves = JaxprReader(graph), dict[int, Nodes](), dict[View, Nodes]()

        def node(value: Value) -> Nodes:
            if isinstance(value, View):
                if value not in leaves:
                    leaves[value] = nodes([graph.input(len(leaves), 0, value.dtype)], ())
                return leaves[value]
            if id(value) not in known:
                known[id(value)] = value.make(reader, *map(node, value.operands))
            return known[id(value)]

        result = node(value)
        return list(leaves), native_form(ScalarProgram(graph, tuple(leaves.values()), (result,), (value.dtype,)))

    def _computed(
        self, program: ScalarProgram, leaves: Sequence[View], entries: Sequence[str], strides: Sequence[int], width: int
    ) -> str:
        """Entries of an expression, from the entries of what it reads."""

        def read(argument: int, _: int) -> str:
            return self.load(leaves[argument], entries[argument], width, strides[argument])

        code = self.code.of(width) if width > 1 else self.code.of(self.code.lanes)
        return Scalars(code, program, read).compute(program.flat)[0]
