"""Sums, products, extremes and truth along axes, in vectors along what stays or along what goes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scalar.table import OPERATIONS
from ..code import NAMES, Code
from .memory import View, known
from .sweep import ArrayCode, merged

if TYPE_CHECKING:
    from .reader import Reading

#: What takes a result further: of the values that were read, then the result so far.
Further = Callable[[Code, str, Sequence[str]], str]

#: What changes nothing, by operation and type.
_NEUTRAL: dict[str, Callable[[np.dtype[Any]], Any]] = {
    "add": lambda dtype: dtype.type(0),
    "mul": lambda dtype: dtype.type(1),
    "max": lambda dtype: -np.inf if dtype.kind == "f" else False if dtype.kind == "b" else np.iinfo(dtype).min,
    "min": lambda dtype: np.inf if dtype.kind == "f" else True if dtype.kind == "b" else np.iinfo(dtype).max,
    "and": lambda dtype: True if dtype.kind == "b" else dtype.type(-1),
    "or": lambda dtype: dtype.type(0),
}


def reduced(
    own: ArrayCode, sources: Sequence[View], to: View, axes: Sequence[int], name: str, further: Further
) -> None:
    """Writes the reduction of what is read along axes, by an operation on scalars.

    Args:
        sources: in memory, of one shape, of which no axis is empty.
        to: has the other axes, in their order.
    """
    keep = [d for d in range(sources[0].array.ndim) if d not in axes]
    result, *sides = merged([to, *(_at_first(v, axes, keep) for v in sources)], to.array)
    ends = merged([_at_first(v, keep, axes) for v in sources])
    views = [_with_axes_of(v, side, end) for v, side, end in zip(sources, sides, ends, strict=True)]
    reduction = _Reduction(own, name, further, to.dtype, ends[0].shape)
    if not ends[0].shape or any(v.shape and v.array.strides[-1] == to.dtype.itemsize for v in sides):
        if not result.shape:
            result, *views = (v.seen(v.array.reshape(1, *v.shape)) for v in (result, *views))
        own.nested(result.shape[:-1], [result, *views], lambda these: reduction.side_by_side(*these))
    else:
        own.nested(result.shape, [result, *views], lambda these: reduction.one(*these))


@dataclasses.dataclass(frozen=True)
class _Reduction:
    """Of so many entries along the axes that go, the last ones of views."""

    own: ArrayCode
    name: str
    further: Further
    dtype: np.dtype[Any]
    turns: tuple[int, ...]

    def side_by_side(self, result: View, *views: View) -> None:
        """As many results as there are lanes: views have one axis that stays, in front."""

        def piece(code: Code, index: str, first: int) -> None:
            to, *here = (self.own.at(v, index, self.own.lanes * v.array.strides[0]) for v in (result, *views))
            turned = [v.seen(np.moveaxis(v.array, 0, -1)) for v in here]
            self.own.write(code, to, first, self._total(code, turned, first, self.turns, self._neutral(code)))

        self.own.pieces(result.shape[0], piece)

    def one(self, result: View, *views: View) -> None:
        """One result: as many entries of it as there are lanes are taken further side by side."""
        own, kind = self.own, NAMES[self.dtype]
        full, left = divmod(self.turns[-1], own.lanes)
        found = list[str]()

        def along(code: Code, index: str, first: int, start: str) -> str:
            here = [own.at(v, index, own.lanes * v.array.strides[-1]) for v in views]
            return self._total(code, here, first, self.turns[:-1], start)

        if full:
            wide = own.code.of(own.lanes)
            begin = [(wide.vector(kind), self._neutral(wide))]
            (vector,) = own.counted(full, lambda index, sums: [along(wide, index, 0, sums[0])], begin)
            found.append(self._across(vector, own.lanes))
        if left:
            narrow = own.code.of(left)
            found.append(self._across(along(narrow, "0", full * own.lanes, self._neutral(narrow)), left))
        value = found[0] if len(found) == 1 else self._combined(own.code, *found)
        own.write(own.code, result.seen(result.array.reshape(1)), 0, value)

    def _total(self, code: Code, views: Sequence[View], first: int, shape: Sequence[int], start: str) -> str:
        """Over all but the last axis of views, of which vectors are read."""
        kind = NAMES[self.dtype]
        if not shape:
            return self.further(code, kind, [*(self.own.read(code, v, first) for v in views), start])

        def inner(index: str, values: list[str]) -> list[str]:
            here = [self.own.along(v, 0, index) for v in views]
            return [self._total(code, here, first, shape[1:], values[0])]

        return self.own.counted(shape[0], inner, [(code.vector(kind), start)])[0]

    def _across(self, vector: str, lanes: int) -> str:
        """Of the lanes of a vector: halves of it with each other as long as they are even."""
        kind = NAMES[self.dtype]
        while lanes > 1 and lanes % 2 == 0:
            wide, half = self.own.code.of(lanes), self.own.code.of(lanes // 2)
            parts = [wide.part(kind, vector, first, half.lanes) for first in (0, half.lanes)]
            vector, lanes = self._combined(half, *parts), half.lanes
        rest = self.own.code.of(lanes)
        found, *others = (rest.entry(kind, vector, lane) for lane in range(lanes))
        for entry in others:
            found = self._combined(self.own.code, found, entry)
        return found

    def _combined(self, code: Code, a: str, b: str) -> str:
        return combined(self.name, self.dtype, code, a, b)

    def _neutral(self, code: Code) -> str:
        return code.constant(NAMES[self.dtype], _NEUTRAL[self.name](self.dtype))


def combined(name: str, dtype: np.dtype[Any], code: Code, a: str, b: str) -> str:
    """An operation on two vectors."""
    return str(OPERATIONS[name].llvm.of(dtype)(code, NAMES[dtype], a, b))


def _at_first(view: View, axes: Sequence[int], rest: Sequence[int]) -> View:
    """The view of the rest of its axes, where it begins along these."""
    array = view.array.transpose([*axes, *rest])
    for _ in axes:
        array = array[:1].reshape(array.shape[1:]) if array.ndim == 1 else array[0]
    return view.seen(array)


def _with_axes_of(view: View, side: View, end: View) -> View:
    """A view with axes of two others of the same memory."""
    shape, strides = (*side.shape, *end.shape), (*side.array.strides, *end.array.strides)
    return view.seen(np.lib.stride_tricks.as_strided(view.array, shape, strides, writeable=False))


def any_of(own: ArrayCode, flags: View) -> View:
    """Whether a truth value holds anywhere."""
    if not flags.shape:
        return flags
    found = own.new((), bool)
    reduced(own, [own.stored(flags)], found, range(flags.array.ndim), "or", _further("or", found.dtype))
    return found


def _further(name: str, dtype: np.dtype[Any]) -> Further:
    return lambda code, kind, values: combined(name, dtype, code, *values)


def _reduction(name: str, numbers: Any) -> Callable[..., View]:
    def reduce(own: Reading, eqn: Any, a: View) -> View:
        axes, shape, neutral = tuple(eqn.params["axes"]), eqn.outvars[0].aval.shape, _NEUTRAL[name](a.dtype)
        if a.known:
            return known(np.asarray(numbers(a.array, axis=axes, initial=neutral), a.dtype))
        if 0 in a.shape:
            return known(np.full(shape, neutral, a.dtype))
        found = own.code.new(shape, a.dtype)
        reduced(own.code, [a], found, axes, name, _further(name, a.dtype))
        return found

    return reduce


#: By primitive.
REDUCTIONS: dict[str, Callable[..., View]] = {
    "reduce_sum": _reduction("add", np.sum),
    "reduce_prod": _reduction("mul", np.prod),
    "reduce_max": _reduction("max", np.max),
    "reduce_min": _reduction("min", np.min),
    "reduce_and": _reduction("and", np.bitwise_and.reduce),
    "reduce_or": _reduction("or", np.bitwise_or.reduce),
}
