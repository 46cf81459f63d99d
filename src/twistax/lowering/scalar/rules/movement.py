"""Operations that move entries: on arrays of nodes they are the same operations."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from ..graph import Graph, Nodes
from ..operations import by_primitive
from .rule import Rule, nodes

__all__ = ["MOVEMENT"]

#: Vectors up to this length are sorted by exchanges of neighbours.
_LONGEST_SORTED = 16


def _reshape(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    return [a.reshape(eqn.outvars[0].aval.shape)]


def _transpose(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    return [a.transpose(eqn.params["permutation"])]


def _broadcast_in_dim(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    shape = eqn.params["shape"]
    own = [1] * len(shape)
    for place, size in zip(eqn.params["broadcast_dimensions"], a.shape, strict=True):
        own[place] = size
    return [np.broadcast_to(a.reshape(own), shape)]


def _concatenate(g: Graph, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return [np.concatenate(arrays, eqn.params["dimension"])]


def _stack(g: Graph, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return [np.stack(arrays, eqn.params.get("axis", 0))]


def _unstack(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    return [np.asarray(row) for row in np.moveaxis(a, eqn.params.get("axis", 0), 0)]


def _slice(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    strides = eqn.params["strides"] or [1] * a.ndim
    ends = zip(eqn.params["start_indices"], eqn.params["limit_indices"], strides, strict=True)
    return [a[tuple(slice(*each) for each in ends)]]


def _rev(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    return [np.flip(a, eqn.params["dimensions"])]


def _split(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    return list(np.split(a, np.cumsum(eqn.params["sizes"])[:-1], eqn.params["axis"]))


def _tile(g: Graph, eqn: Any, a: Nodes) -> list[Nodes]:
    return [np.tile(a, eqn.params["reps"])]


def _iota(g: Graph, eqn: Any) -> list[Nodes]:
    shape, axis = eqn.params["shape"], eqn.params["dimension"]
    along = np.arange(shape[axis]).astype(eqn.params["dtype"])
    spread = [-1 if i == axis else 1 for i in range(len(shape))]
    return [np.broadcast_to(g.array(along).reshape(spread), shape)]


def _pad(g: Graph, eqn: Any, a: Nodes, value: Nodes) -> list[Nodes]:
    found = np.full(eqn.outvars[0].aval.shape, int(value))
    targets, sources = [], []
    for (low, _, between), size, whole in zip(eqn.params["padding_config"], a.shape, found.shape, strict=True):
        places = low + np.arange(size) * (between + 1)
        inside = (places >= 0) & (places < whole)
        targets.append(places[inside])
        sources.append(np.arange(size)[inside])
    found[np.ix_(*targets)] = a[np.ix_(*sources)]
    return [found]


def _starts(g: Graph, indices: tuple[Nodes, ...], room: list[int]) -> list[int] | None:
    """Where a window begins, moved inside, where that is known."""
    known = [g.numbers[int(i)] for i in indices]
    if any(k is None for k in known):
        return None
    return [int(np.clip(k, 0, most)) for k, most in zip(known, room, strict=True)]


def _dynamic_slice(g: Graph, eqn: Any, a: Nodes, *indices: Nodes) -> list[Nodes] | None:
    """A window; where its place along an axis is known only at run time, of one entry along a short axis."""
    found, sizes = a, eqn.params["slice_sizes"]
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


def _dynamic_update_slice(g: Graph, eqn: Any, a: Nodes, update: Nodes, *indices: Nodes) -> list[Nodes] | None:
    starts = _starts(g, indices, [n - m for n, m in zip(a.shape, update.shape, strict=True)])
    if starts is None:
        return None
    found = a.copy()
    found[tuple(slice(s, s + m) for s, m in zip(starts, update.shape, strict=True))] = update
    return [found]


def _lookup(g: Graph, table: list[int], place: int) -> int:
    """table[place], the ends beyond the ends."""
    equal, dtype = by_primitive["le"], g.dtypes[place]
    found = table[-1]
    for k in range(len(table) - 2, -1, -1):
        found = g.select(g.node(equal, place, g.constant(k, dtype)), table[k], found)
    return found


def _gather(g: Graph, eqn: Any, a: Nodes, indices: Nodes) -> list[Nodes] | None:
    """As XLA's gather: a window of the operand for every vector of start indices."""
    numbers = eqn.params["dimension_numbers"]
    if numbers.operand_batching_dims:
        return None
    sizes, mode = eqn.params["slice_sizes"], str(eqn.params["mode"])
    where = g.values(indices)
    if where is None:
        return None if "FILL" in mode else _taken(g, eqn, a, indices)
    shape = eqn.outvars[0].aval.shape
    offset = numbers.offset_dims
    batch_axes = [i for i in range(len(shape)) if i not in offset]
    window_axes = [i for i in range(a.ndim) if i not in numbers.collapsed_slice_dims]
    room = [n - m for n, m in zip(a.shape, sizes, strict=True)]
    found = np.empty(shape, np.int64)
    for batch in np.ndindex(*(shape[i] for i in batch_axes)):
        start = [0] * a.ndim
        for axis, value in zip(numbers.start_index_map, where[batch], strict=True):
            start[axis] = int(value)
        if "FILL" in mode and any(not 0 <= s <= r for s, r in zip(start, room, strict=True)):
            return None
        start = [min(max(s, 0), r) for s, r in zip(start, room, strict=True)]
        window = a[tuple(slice(s, s + m) for s, m in zip(start, sizes, strict=True))]
        target: list[Any] = [slice(None)] * len(shape)
        for axis, value in zip(batch_axes, batch, strict=True):
            target[axis] = value
        found[tuple(target)] = window.reshape([sizes[i] for i in window_axes])
    return [found]


def _taken(g: Graph, eqn: Any, a: Nodes, indices: Nodes) -> list[Nodes] | None:
    """Whole slices along one short axis, at places known only at run time."""
    numbers, sizes = eqn.params["dimension_numbers"], eqn.params["slice_sizes"]
    if len(numbers.start_index_map) != 1 or tuple(numbers.collapsed_slice_dims) != tuple(numbers.start_index_map):
        return None
    (axis,) = numbers.start_index_map
    rest = [n for i, n in enumerate(a.shape) if i != axis]
    if a.shape[axis] > g.limits.table or [m for i, m in enumerate(sizes) if i != axis] != rest:
        return None
    columns = np.moveaxis(a, axis, -1).reshape(-1, a.shape[axis]).tolist()
    places = indices.reshape(-1).tolist()
    found = nodes([_lookup(g, column, place) for place in places for column in columns], (len(places), *rest))
    shape = eqn.outvars[0].aval.shape
    batch = [i for i in range(len(shape)) if i not in numbers.offset_dims]
    found = found.reshape(*(shape[i] for i in batch), *rest)
    return [found.transpose(np.argsort([*batch, *numbers.offset_dims]))]


def _sort(g: Graph, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    """Short vectors in the order of the first one, by exchanges of neighbours: equals keep their order."""
    n = arrays[0].size
    if arrays[0].ndim != 1 or n > _LONGEST_SORTED or eqn.params["num_keys"] != 1:
        return None
    if g.dtypes[int(arrays[0][0])] == g.dtype if n else False:
        return None  # not-a-number has a place of its own among real numbers
    rows, less = [a.tolist() for a in arrays], by_primitive["lt"]
    for end in range(n - 1, 0, -1):
        for k in range(end):
            swap = g.node(less, rows[0][k + 1], rows[0][k])
            for row in rows:
                row[k], row[k + 1] = g.select(swap, row[k + 1], row[k]), g.select(swap, row[k], row[k + 1])
    return [nodes(row, (n,)) for row in rows]


def _scatter(combine: str | None) -> Rule:
    """As XLA's scatter with indices that are known: entries are set, or combined one after the other."""

    def rule(g: Graph, eqn: Any, a: Nodes, indices: Nodes, updates: Nodes) -> list[Nodes] | None:
        numbers, where = eqn.params["dimension_numbers"], g.values(indices)
        if where is None or numbers.operand_batching_dims:
            return None
        window_axes = numbers.update_window_dims
        batch_axes = [i for i in range(updates.ndim) if i not in window_axes]
        operand_axes = [i for i in range(a.ndim) if i not in numbers.inserted_window_dims]
        extent = [1] * a.ndim
        for axis, place in zip(operand_axes, window_axes, strict=True):
            extent[axis] = updates.shape[place]
        found = a.copy()
        for batch in np.ndindex(*(updates.shape[i] for i in batch_axes)):
            start = [0] * a.ndim
            for axis, value in zip(numbers.scatter_dims_to_operand_dims, where[batch], strict=True):
                start[axis] = int(value)
            if any(not 0 <= s <= n - m for s, n, m in zip(start, a.shape, extent, strict=True)):
                if "CLIP" not in str(eqn.params["mode"]):
                    continue  # XLA leaves out what does not fit
                start = [min(max(s, 0), n - m) for s, n, m in zip(start, a.shape, extent, strict=True)]
            source: list[Any] = [slice(None)] * updates.ndim
            for axis, value in zip(batch_axes, batch, strict=True):
                source[axis] = value
            new = updates[tuple(source)].reshape(extent)
            target = tuple(slice(s, s + m) for s, m in zip(start, extent, strict=True))
            if combine is not None:
                pairs = itertools.zip_longest(found[target].reshape(-1).tolist(), new.reshape(-1).tolist())
                new = nodes([getattr(g, combine)(old, one) for old, one in pairs], extent)
            found[target] = new
        return [found]

    return rule


MOVEMENT: dict[str, Rule] = {
    **dict.fromkeys(("reshape", "squeeze", "expand_dims"), _reshape),
    "transpose": _transpose,
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": _concatenate,
    "stack": _stack,
    "unstack": _unstack,
    "slice": _slice,
    "rev": _rev,
    "split": _split,
    "tile": _tile,
    "iota": _iota,
    "pad": _pad,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _gather,
    "sort": _sort,
    "scatter": _scatter(None),
    "scatter-add": _scatter("add"),
    "scatter_add": _scatter("add"),
    "scatter-mul": _scatter("mul"),
}
