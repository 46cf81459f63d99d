"""What is read entry by entry: places that are known, as of `a[[2, 0, 3]]`, and factors of a few rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scalar.entry import flat
from ...scalar.program import ScalarProgram
from ..code import NotNative
from ..tile import Scalars
from .memory import View, address, known
from .sweep import ArrayCode

#: The most operations that are written one by one.
_MOST = 4096


def of_entries(own: ArrayCode, form: ScalarProgram, sources: Sequence[View]) -> list[View]:
    """The results of a program of entries of arrays.

    Raises:
        NotNative: there are too many operations.
    """
    g = form.graph
    if form.operations > _MOST:
        raise NotNative(f"{form.operations} operations on entries have no native form")
    results = []
    scalars = Scalars(own.code.of(1), form, lambda argument, place: _entry(own, sources[argument], place))
    for nodes, dtype in zip(form.outputs, form.types, strict=True):
        numbers = g.values(nodes)
        if numbers is not None:
            results.append(known(np.asarray(numbers, dtype)))
            continue
        results.append(_taken(own, form, nodes, dtype, sources))
        computed = [k for k, i in enumerate(flat(nodes)) if g.operation(i) is not None]
        line = results[-1].array.reshape(-1)
        for k, value in zip(computed, scalars.compute([flat(nodes)[k] for k in computed]), strict=True):
            own.write(own.code.of(1), results[-1].seen(line[k : k + 1]), 0, value)
    return results


def _entry(own: ArrayCode, view: View, place: int) -> str:
    array = view.array
    at = np.unravel_index(place, array.shape)
    one = view.part(slice(int(i), int(i) + 1) for i in at)
    return own.read(own.code.of(1), one.seen(one.array.reshape(1)))


def _taken(
    own: ArrayCode, form: ScalarProgram, nodes: NDArray[Any], dtype: np.dtype[Any], sources: Sequence[View]
) -> View:
    """Those of the results that are entries of arrays, by tables of places, or numbers; others are not written."""
    g = form.graph
    which, entry = np.array([g.input_of(i) or (-1, 0) for i in flat(nodes)]).T
    if (which == which[0]).all() and which[0] >= 0:
        view = sources[which[0]]
        if np.array_equal(entry, np.arange(view.array.size)):  # all of them, in their order
            found = view.array.reshape(nodes.shape)
            if np.may_share_memory(found, view.array):
                return view.seen(found)
    to = own.new(nodes.shape, dtype)
    if any(g.numbers[i] is not None for i in flat(nodes)):
        numbers = np.array([0 if (n := g.numbers[i]) is None else n for i in flat(nodes)], dtype)
        own.copied(known(numbers.reshape(nodes.shape)), to)
    for k, view in enumerate(sources):
        here = np.flatnonzero(which == k)
        if here.size:
            _moved(own, view, _offsets(view.array)[entry[here]], to, here * dtype.itemsize)
    return to


def _offsets(array: NDArray[Any]) -> NDArray[Any]:
    """Bytes from the first entry to each."""
    steps = [np.arange(n) * stride for n, stride in zip(array.shape, array.strides, strict=True)]
    found = np.zeros((), int)
    for step in steps:
        found = found[..., None] + step
    return found.reshape(-1)


def _moved(own: ArrayCode, view: View, source: NDArray[Any], to: View, target: NDArray[Any]) -> None:
    """Copy entries at some bytes to entries at others: runs of as many as all runs have."""
    item, count = view.dtype.itemsize, len(source)
    breaks = np.flatnonzero((np.diff(source) != item) | (np.diff(target) != item)) + 1
    run = int(np.gcd.reduce([*breaks.tolist(), count]))
    code = own.code
    tables = [own.module.numbers(np.ascontiguousarray(table[::run], np.int64)) for table in (source, target)]
    line = np.empty(run, view.dtype)

    def one(index: str, _: list[str]) -> list[str]:
        places = []
        for table, place in zip(tables, (own.pointer(view), own.pointer(to)), strict=True):
            at = code.emit(f"getelementptr i64, ptr {table}, i64 {index}")
            bytes = code.emit(f"load i64, ptr {at}, align 8")
            places.append(code.emit(f"getelementptr i8, ptr {place}, i64 {bytes}"))
        own.copied(View(places[0], address(line), line), View(places[1], address(line), line))
        return []

    own.counted(count // run, one)
