"""Operations that move, select and insert entries, on arrays of nodes by NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from .entry import ALWAYS, SMALL, Entry, default, moving, up_to
from .interface import Graph, Nodes, Reader, flat, nodes
from .operations import OPERATIONS, on

#: Vectors up to this length are sorted by exchanges of neighbours.
_LONGEST_SORTED = 16


def _moving(name: str, takes: str, function: Callable[..., Any], inside: Any = SMALL, **more: Any) -> Entry:
    """An entry by a function of the parameters and of arrays, of numbers or of nodes; it returns one or a list."""

    def read(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
        moved = function(eqn.params, *arrays)
        return [np.asarray(row) for row in moved] if eqn.primitive.multiple_results else [moved]

    return moving(name, read, takes, inside=inside, numpy=function, **more)


def _broadcast(p: Any, a: Nodes) -> Nodes:
    shape = p["shape"]
    sizes = [1] * len(shape)
    for place, size in zip(p["broadcast_dimensions"], a.shape, strict=True):
        sizes[place] = size
    return np.broadcast_to(a.reshape(sizes), shape)


def _slice(p: Any, a: Nodes) -> Nodes:
    return a[tuple(map(slice, p["start_indices"], p["limit_indices"], p["strides"] or [1] * a.ndim))]


def _iota(reader: Reader, eqn: Any) -> list[Nodes]:
    shape, axis = eqn.params["shape"], eqn.params["dimension"]
    numbers = np.arange(shape[axis]).astype(eqn.params["dtype"])
    spread = [-1 if i == axis else 1 for i in range(len(shape))]
    return [np.broadcast_to(reader.graph.array(numbers).reshape(spread), shape)]


def _pad(reader: Reader, eqn: Any, a: Nodes, value: Nodes) -> list[Nodes]:
    padded = np.full(eqn.outvars[0].aval.shape, int(value))
    targets, sources = [], []
    for (low, _, between), size, length in zip(eqn.params["padding_config"], a.shape, padded.shape, strict=True):
        places = low + np.arange(size) * (between + 1)
        inside = (places >= 0) & (places < length)
        targets.append(places[inside])
        sources.append(np.arange(size)[inside])
    padded[np.ix_(*targets)] = a[np.ix_(*sources)]
    return [padded]


def _sort(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    """Short vectors sorted by the first one, stably, by exchanges of neighbours."""
    g, n = reader.graph, arrays[0].size
    if arrays[0].ndim != 1 or n > _LONGEST_SORTED:
        return None
    if jnp.issubdtype(eqn.invars[0].aval.dtype, jnp.inexact):
        return None  # NaN has a place of its own among real numbers
    rows = [a.tolist() for a in arrays]
    for end in range(n - 1, 0, -1):
        for k in range(end):
            swap = on(g, "lt", rows[0][k + 1], rows[0][k])
            for row in rows:
                row[k], row[k + 1] = g.select(swap, row[k + 1], row[k]), g.select(swap, row[k], row[k + 1])
    return [nodes(row, (n,)) for row in rows]


MOVEMENT = [
    _moving(
        "reshape",
        "new_sizes dimensions sharding",
        lambda p, a: a.reshape(p["new_sizes"]),
        ALWAYS,
        when=default("dimensions"),
    ),
    _moving("squeeze", "dimensions", lambda p, a: a.squeeze(tuple(p["dimensions"])), ALWAYS),
    _moving("transpose", "permutation", lambda p, a: a.transpose(p["permutation"])),
    _moving("broadcast_in_dim", "shape broadcast_dimensions sharding", _broadcast, ALWAYS),
    _moving("concatenate", "dimension", lambda p, *arrays: np.concatenate(arrays, p["dimension"])),
    _moving("stack", "axis", lambda p, *arrays: np.stack(arrays, p["axis"])),
    _moving("unstack", "axis", lambda p, a: list(np.moveaxis(a, p["axis"], 0))),
    _moving("slice", "start_indices limit_indices strides", _slice, ALWAYS),
    _moving("rev", "dimensions", lambda p, a: np.flip(a, p["dimensions"])),
    _moving("split", "sizes axis", lambda p, a: np.split(a, np.cumsum(p["sizes"])[:-1], p["axis"])),
    _moving("tile", "reps", lambda p, a: np.tile(a, p["reps"])),
    moving("iota", _iota, "dtype shape dimension sharding", inside=SMALL),
    moving("pad", _pad, "padding_config", inside=SMALL),
    Entry(
        "sort",
        _sort,
        "dimension is_stable num_keys",
        when=lambda p: (p["num_keys"], p["dimension"]) == (1, 0),
        any_type=True,
    ),
]


# ---- windows ---------------------------------------------------------------------------------------------------------


def _window(start: Any, shape: Any, sizes: Any) -> tuple[slice, ...]:
    """The slices of a window, shifted so that it lies inside."""
    inside = [min(max(int(s), 0), n - m) for s, n, m in zip(start, shape, sizes, strict=True)]
    return tuple(slice(s, s + m) for s, m in zip(inside, sizes, strict=True))


def _lookup(g: Graph, table: list[int], place: int) -> int:
    """table[place]; places beyond an end give the entry at that end."""
    value = table[-1]
    for k in range(len(table) - 2, -1, -1):
        here = on(g, "le", place, g.constant(k, g.dtypes[place]))
        value = g.select(here, table[k], value)
    return value


def _window_at(g: Graph, a: Nodes, places: Sequence[int], sizes: Sequence[int]) -> Nodes | None:
    """A window of an array; of one entry along a short axis where its place is known at run time only."""
    start = [g.numbers[place] for place in places]
    unknown = [axis for axis, place in enumerate(start) if place is None]
    if any(sizes[axis] != 1 for axis in unknown) or math.prod(a.shape[axis] for axis in unknown) > g.limits.table:
        return None
    extent = [a.shape[axis] if axis in unknown else size for axis, size in enumerate(sizes)]
    window = a[_window([place or 0 for place in start], a.shape, extent)]
    for axis in unknown:
        columns = np.moveaxis(window, axis, -1)
        picked = [_lookup(g, column, places[axis]) for column in columns.reshape(-1, a.shape[axis]).tolist()]
        window = np.expand_dims(nodes(picked, columns.shape[:-1]), axis)
    return window


def _dynamic_slice(reader: Reader, eqn: Any, a: Nodes, *indices: Nodes) -> list[Nodes] | None:
    window = _window_at(reader.graph, a, flat(*indices), eqn.params["slice_sizes"])
    return None if window is None else [window]


def _dynamic_update_slice(reader: Reader, eqn: Any, a: Nodes, update: Nodes, *indices: Nodes) -> list[Nodes] | None:
    """A window set at a place that is known, moved inside."""
    known = [reader.graph.numbers[int(i)] for i in indices]
    if any(place is None for place in known):
        return None
    updated = a.copy()
    updated[_window(known, a.shape, update.shape)] = update
    return [updated]


# ---- gather and scatter ----------------------------------------------------------------------------------------------

_FILL, _CLIP = lax.GatherScatterMode.FILL_OR_DROP, lax.GatherScatterMode.CLIP
_MODES = (_CLIP, _FILL, lax.GatherScatterMode.PROMISE_IN_BOUNDS)


def _known(*names: str) -> Callable[[Any], bool]:
    """Whether the dimension numbers are these, and those of batches; and the mode is known."""

    def when(p: Any) -> bool:
        *fields, last = p["dimension_numbers"]._fields
        known = fields == [*names, "operand_batching_dims"] and last.endswith("_indices_batching_dims")
        return known and p["mode"] in _MODES

    return when


_SCATTER_NUMBERS = _known("update_window_dims", "inserted_window_dims", "scatter_dims_to_operand_dims")


def _scattered(p: Any) -> bool:
    return _SCATTER_NUMBERS(p) and not p["dimension_numbers"].operand_batching_dims


def _gather(reader: Reader, eqn: Any, a: Nodes, indices: Nodes) -> list[Nodes] | None:
    """As XLA's gather: a window of the operand for every vector of start indices."""
    g, p, shape = reader.graph, eqn.params, eqn.outvars[0].aval.shape
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    paired_axes = list(zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True))
    batch_axes = [i for i in range(len(shape)) if i not in numbers.offset_dims]
    dropped = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    window_shape = [size for i, size in enumerate(sizes) if i not in dropped]
    gathered = np.empty(shape, np.int64)
    for batch in np.ndindex(*(shape[i] for i in batch_axes)):
        start = list(_at(a.ndim, numbers.start_index_map, indices[batch].tolist(), g.constant(0, g.dtype_of(indices))))
        for axis, index_axis in paired_axes:
            start[axis] = g.constant(batch[index_axis], g.dtype_of(indices))
        if p["mode"] == _FILL and not _inside(g, start, a.shape, sizes):
            return None
        window = _window_at(g, a, start, sizes)
        if window is None:
            return None
        gathered[_at(len(shape), batch_axes, batch)] = window.reshape(window_shape)
    return [gathered]


def _inside(g: Graph, start: Sequence[int], shape: Any, sizes: Any) -> bool:
    """Whether a window is known to lie inside."""
    places = [g.numbers[place] for place in start]
    return all(s is not None and 0 <= s <= n - m for s, n, m in zip(places, shape, sizes, strict=True))


def _at(rank: int, axes: Any, places: Any, default: Any = slice(None)) -> tuple[Any, ...]:
    """An index with these places along these axes, and `default` along all others."""
    by_axis = dict(zip(axes, places, strict=True))
    return tuple(by_axis.get(axis, default) for axis in range(rank))


def _moved(start: Any, window: tuple[slice, ...]) -> bool:
    """Whether a window was shifted."""
    return any(int(s) != part.start for s, part in zip(start, window, strict=True))


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
        extent = _at(a.ndim, operand_axes, [updates.shape[i] for i in window_axes], 1)
        updated = a.copy()
        for batch in np.ndindex(*(updates.shape[i] for i in batch_axes)):
            start = _at(a.ndim, numbers.scatter_dims_to_operand_dims, where[batch], 0)
            window = _window(start, a.shape, extent)
            if _moved(start, window) and eqn.params["mode"] != _CLIP:
                continue  # XLA leaves out what does not fit
            new = updates[_at(updates.ndim, batch_axes, batch)].reshape(extent)
            if combine is not None:
                pairs = zip(flat(updated[window]), flat(new), strict=True)
                new = nodes([OPERATIONS[combine].on(g)(old, one) for old, one in pairs], extent)
            updated[window] = new
        return [updated]

    return read


def _one_place(entries: float) -> Callable[[Any], bool]:
    """Set at a single place, which XLA makes a slice; it has no code for others inside of a function."""
    small = up_to(entries)
    return lambda eqn: math.prod(eqn.invars[1].aval.shape[:-1]) <= 1 and small(eqn)


_SCATTER = "dimension_numbers mode update_jaxpr update_consts indices_are_sorted unique_indices"

INDEXING = [
    moving("dynamic_slice", _dynamic_slice, "slice_sizes"),
    moving("dynamic_update_slice", _dynamic_update_slice),
    moving(
        "gather",
        _gather,
        "dimension_numbers slice_sizes mode fill_value indices_are_sorted unique_indices",
        when=_known("offset_dims", "collapsed_slice_dims", "start_index_map"),
    ),
    moving(
        "scatter",
        _scatter(None),
        _SCATTER,
        when=lambda p: p["update_jaxpr"] is None and _scattered(p),  # else it applies another function
        inside=_one_place(math.inf),
    ),
    moving("scatter-add", _scatter("add"), _SCATTER, when=_scattered, inside=_one_place(4096)),
    Entry("scatter-mul", _scatter("mul"), _SCATTER, when=_scattered, any_type=True),
]
