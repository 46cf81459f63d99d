"""Entries taken from places, and put at places: windows, gathers, scatters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from jax import lax

from ..entry import ANY, DEFAULT, Entry, Nodes, entries, largest, moving, never_inside, nodes, one_of, takes
from .arithmetic import ARITHMETIC
from .logic import LOGIC

if TYPE_CHECKING:
    from ..graph import Graph
    from ..reader import Reader

__all__ = ["INDEXING"]

_CLIP, _FILL = lax.GatherScatterMode.CLIP, lax.GatherScatterMode.FILL_OR_DROP
_MODES = one_of(_CLIP, _FILL, lax.GatherScatterMode.PROMISE_IN_BOUNDS)
_V, _M, _PLACES = np.arange(5.0), np.arange(12.0).reshape(3, 4), np.array([2, 0])


def _lookup(g: Graph, table: list[int], place: int) -> int:
    """table[place], the ends beyond the ends."""
    found = table[-1]
    for k in range(len(table) - 2, -1, -1):
        here = g.node(LOGIC["le"], place, g.constant(k, g.dtypes[place]))
        found = g.select(here, table[k], found)
    return found


# ---- windows ---------------------------------------------------------------------------------------------------------


def _dynamic_slice(reader: Reader, eqn: Any, a: Nodes, *indices: Nodes) -> list[Nodes] | None:
    """A window; where its place along an axis is known only at run time, of one entry along a short axis."""
    g, found, sizes = reader.graph, a, eqn.params["slice_sizes"]
    places = [g.numbers[int(i)] for i in indices]
    unknown = [axis for axis, place in enumerate(places) if place is None]
    if any(sizes[axis] != 1 for axis in unknown) or math.prod(a.shape[axis] for axis in unknown) > g.limits.table:
        return None
    for axis, place in enumerate(places):
        if place is not None:
            start = min(max(int(place), 0), a.shape[axis] - sizes[axis])
            found = found.take(range(start, start + sizes[axis]), axis)
    for axis in unknown:
        columns = np.moveaxis(found, axis, -1)
        picked = [_lookup(g, each, int(indices[axis])) for each in columns.reshape(-1, a.shape[axis]).tolist()]
        found = np.expand_dims(nodes(picked, columns.shape[:-1]), axis)
    return [found]


def _dynamic_update_slice(reader: Reader, eqn: Any, a: Nodes, update: Nodes, *indices: Nodes) -> list[Nodes] | None:
    """A window set at a place that is known, moved inside."""
    known = [reader.graph.numbers[int(i)] for i in indices]
    if any(place is None for place in known):
        return None
    found = a.copy()
    starts = [int(np.clip(s, 0, n - m)) for s, n, m in zip(known, a.shape, update.shape, strict=True)]
    found[tuple(slice(s, s + m) for s, m in zip(starts, update.shape, strict=True))] = update
    return [found]


# ---- gather ----------------------------------------------------------------------------------------------------------


def _gather_numbers(numbers: Any) -> bool:
    fields = ("offset_dims", "collapsed_slice_dims", "start_index_map", "operand_batching_dims")
    return numbers._fields == (*fields, "start_indices_batching_dims") and not numbers.operand_batching_dims


def _gather(reader: Reader, eqn: Any, a: Nodes, indices: Nodes) -> list[Nodes] | None:
    """As XLA's gather: a window of the operand for every vector of start indices."""
    p, where = eqn.params, reader.graph.values(indices)
    numbers, sizes, filled = p["dimension_numbers"], p["slice_sizes"], p["mode"] == _FILL
    if where is None:
        return None if filled else _taken(reader.graph, eqn, a, indices)
    shape = eqn.outvars[0].aval.shape
    batch_axes = [i for i in range(len(shape)) if i not in numbers.offset_dims]
    window_axes = [i for i in range(a.ndim) if i not in numbers.collapsed_slice_dims]
    found = np.empty(shape, np.int64)
    for batch in np.ndindex(*(shape[i] for i in batch_axes)):
        start = _start(a.ndim, numbers.start_index_map, where[batch])
        inside = _inside(start, a.shape, sizes)
        if filled and start != inside:
            return None
        window = a[tuple(slice(s, s + m) for s, m in zip(inside, sizes, strict=True))]
        found[_at(len(shape), batch_axes, batch)] = window.reshape([sizes[i] for i in window_axes])
    return [found]


def _taken(g: Graph, eqn: Any, a: Nodes, indices: Nodes) -> list[Nodes] | None:
    """Whole slices along one short axis, at places known only at run time."""
    numbers, sizes = eqn.params["dimension_numbers"], eqn.params["slice_sizes"]
    if len(numbers.start_index_map) != 1 or not set(numbers.collapsed_slice_dims) <= set(numbers.start_index_map):
        return None
    (axis,) = numbers.start_index_map
    rest = [n for i, n in enumerate(a.shape) if i != axis]
    if a.shape[axis] > g.limits.table or sizes[axis] != 1 or [m for i, m in enumerate(sizes) if i != axis] != rest:
        return None
    columns = np.moveaxis(a, axis, -1).reshape(-1, a.shape[axis]).tolist()
    flat = [_lookup(g, column, place) for place in indices.reshape(-1).tolist() for column in columns]
    shape = eqn.outvars[0].aval.shape
    batch = [i for i in range(len(shape)) if i not in numbers.offset_dims]
    order = [*batch, *numbers.offset_dims]
    return [nodes(flat, (shape[i] for i in order)).transpose(np.argsort(order))]


def _start(rank: int, axes: Any, values: Any) -> list[int]:
    """Where a window begins."""
    start = [0] * rank
    for axis, value in zip(axes, values, strict=True):
        start[axis] = int(value)
    return start


def _inside(start: list[int], shape: Any, window: Any) -> list[int]:
    """The same, moved inside."""
    return [min(max(s, 0), n - m) for s, n, m in zip(start, shape, window, strict=True)]


def _at(rank: int, axes: list[int], places: tuple[int, ...]) -> tuple[Any, ...]:
    """An index: these places along these axes, all of the others."""
    index: list[Any] = [slice(None)] * rank
    for axis, place in zip(axes, places, strict=True):
        index[axis] = place
    return tuple(index)


# ---- scatter ---------------------------------------------------------------------------------------------------------


def _scatter_numbers(numbers: Any) -> bool:
    fields = ("update_window_dims", "inserted_window_dims", "scatter_dims_to_operand_dims", "operand_batching_dims")
    return numbers._fields == (*fields, "scatter_indices_batching_dims") and not numbers.operand_batching_dims


def _scatter(combine: str | None) -> Any:
    """As XLA's scatter with indices that are known: entries are set, or combined one after the other."""

    def read(reader: Reader, eqn: Any, a: Nodes, indices: Nodes, updates: Nodes) -> list[Nodes] | None:
        g, numbers = reader.graph, eqn.params["dimension_numbers"]
        where = g.values(indices)
        if where is None:
            return None
        window_axes = numbers.update_window_dims
        batch_axes = [i for i in range(updates.ndim) if i not in window_axes]
        operand_axes = [i for i in range(a.ndim) if i not in numbers.inserted_window_dims]
        extent = [1] * a.ndim
        for axis, place in zip(operand_axes, window_axes, strict=True):
            extent[axis] = updates.shape[place]
        found = a.copy()
        for batch in np.ndindex(*(updates.shape[i] for i in batch_axes)):
            start = _start(a.ndim, numbers.scatter_dims_to_operand_dims, where[batch])
            inside = _inside(start, a.shape, extent)
            if start != inside and eqn.params["mode"] != _CLIP:
                continue  # XLA leaves out what does not fit
            new = updates[_at(updates.ndim, batch_axes, batch)].reshape(extent)
            target = tuple(slice(s, s + m) for s, m in zip(inside, extent, strict=True))
            if combine is not None:
                pairs = zip(found[target].reshape(-1).tolist(), new.reshape(-1).tolist(), strict=True)
                new = nodes([ARITHMETIC[combine].on(g)(old, one) for old, one in pairs], extent)
            found[target] = new
        return [found]

    return read


def _one_place(eqn: Any) -> bool:
    """Set at a single place, which XLA makes a slice; it has no code for others inside of a function."""
    return math.prod(eqn.invars[1].aval.shape[:-1]) <= 1


def _one_small_place(eqn: Any) -> bool:
    return _one_place(eqn) and largest(eqn) <= 4096


def _scattering(name: str, combine: str | None, example: Any, inside: Any, function: Any = ANY) -> Entry:
    """`function`: of entries as they are and new ones; that of plain setting is another function where there is one."""
    known = takes(
        dimension_numbers=_scatter_numbers,
        mode=_MODES,
        update_jaxpr=function,
        update_consts=ANY,
        indices_are_sorted=ANY,
        unique_indices=ANY,
    )
    return Entry(
        name=name,
        takes=(known,),
        read=_scatter(combine),
        any_type=True,
        inside=inside,
        moves=combine != "mul",
        example=(example, _V),
    )


_GATHER = takes(
    dimension_numbers=_gather_numbers,
    slice_sizes=ANY,
    mode=_MODES,
    fill_value=ANY,
    indices_are_sorted=ANY,
    unique_indices=ANY,
)

INDEXING: dict[str, Entry] = entries(
    moving(
        name="dynamic_slice",
        takes=(takes(slice_sizes=ANY),),
        read=_dynamic_slice,
        example=(lambda a: lax.dynamic_slice(a, (1, 2), (2, 2)), _M),
    ),
    moving(
        name="dynamic_update_slice",
        read=_dynamic_update_slice,
        example=(lambda a: lax.dynamic_update_slice(a, a[:1, :2], (1, 2)), _M),
    ),
    moving(
        name="gather",
        takes=(_GATHER,),
        read=_gather,
        example=(lambda a: a[:, _PLACES], _M),
    ),
    _scattering("scatter", None, lambda a: a.at[_PLACES].set(9.0), _one_place, DEFAULT),
    _scattering("scatter-add", "add", lambda a: a.at[_PLACES].add(9.0), _one_small_place),
    _scattering("scatter-mul", "mul", lambda a: a.at[_PLACES].multiply(9.0), never_inside),
)
