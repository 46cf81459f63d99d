"""Operations that move entries: on arrays of nodes they are the same operations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..entry import ANY, DEFAULT, Entry, Nodes, always_inside, entries, moving, nodes, small_inside, takes
from .logic import LOGIC

if TYPE_CHECKING:
    from ..reader import Reader

__all__ = ["MOVEMENT"]

#: Vectors up to this length are sorted by exchanges of neighbours.
_LONGEST_SORTED = 16

_V, _M = np.arange(4.0), np.arange(12.0).reshape(3, 4)


def _reshape(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [a.reshape(eqn.outvars[0].aval.shape)]


def _transpose(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [a.transpose(eqn.params["permutation"])]


def _broadcast_in_dim(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    shape = eqn.params["shape"]
    own = [1] * len(shape)
    for place, size in zip(eqn.params["broadcast_dimensions"], a.shape, strict=True):
        own[place] = size
    return [np.broadcast_to(a.reshape(own), shape)]


def _concatenate(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return [np.concatenate(arrays, eqn.params["dimension"])]


def _stack(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes]:
    return [np.stack(arrays, eqn.params["axis"])]


def _unstack(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [np.asarray(row) for row in np.moveaxis(a, eqn.params["axis"], 0)]


def _slice(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    strides = eqn.params["strides"] or [1] * a.ndim
    ends = zip(eqn.params["start_indices"], eqn.params["limit_indices"], strides, strict=True)
    return [a[tuple(slice(*each) for each in ends)]]


def _rev(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [np.flip(a, eqn.params["dimensions"])]


def _split(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return list(np.split(a, np.cumsum(eqn.params["sizes"])[:-1], eqn.params["axis"]))


def _tile(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [np.tile(a, eqn.params["reps"])]


def _iota(reader: Reader, eqn: Any) -> list[Nodes]:
    shape, axis = eqn.params["shape"], eqn.params["dimension"]
    along = np.arange(shape[axis]).astype(eqn.params["dtype"])
    spread = [-1 if i == axis else 1 for i in range(len(shape))]
    return [np.broadcast_to(reader.graph.array(along).reshape(spread), shape)]


def _pad(reader: Reader, eqn: Any, a: Nodes, value: Nodes) -> list[Nodes]:
    found = np.full(eqn.outvars[0].aval.shape, int(value))
    targets, sources = [], []
    for (low, _, between), size, whole in zip(eqn.params["padding_config"], a.shape, found.shape, strict=True):
        places = low + np.arange(size) * (between + 1)
        inside = (places >= 0) & (places < whole)
        targets.append(places[inside])
        sources.append(np.arange(size)[inside])
    found[np.ix_(*targets)] = a[np.ix_(*sources)]
    return [found]


def _sort(reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
    """Short vectors in the order of the first one, by exchanges of neighbours: equals keep their order."""
    g, n = reader.graph, arrays[0].size
    if arrays[0].ndim != 1 or n > _LONGEST_SORTED:
        return None
    if jnp.issubdtype(eqn.invars[0].aval.dtype, jnp.inexact):
        return None  # NaN has a place of its own among real numbers
    rows = [a.tolist() for a in arrays]
    for end in range(n - 1, 0, -1):
        for k in range(end):
            swap = g.node(LOGIC["lt"], rows[0][k + 1], rows[0][k])
            for row in rows:
                row[k], row[k + 1] = g.select(swap, row[k + 1], row[k]), g.select(swap, row[k], row[k + 1])
    return [nodes(row, (n,)) for row in rows]


def _moving(name: str, read: Any, example: Any, known: Any = None, *, anywhere: bool = False) -> Entry:
    """An entry; `anywhere`: it is part of a small function whatever the size of its arrays."""
    inside = always_inside if anywhere else small_inside
    return moving(
        name=name, takes=(known if known is not None else takes(),), read=read, inside=inside, example=example
    )


MOVEMENT: dict[str, Entry] = entries(
    _moving(
        "reshape",
        _reshape,
        (lambda a: lax.reshape(a, (4, 3)), _M),
        takes(new_sizes=ANY, dimensions=DEFAULT, sharding=ANY),
        anywhere=True,
    ),
    _moving("squeeze", _reshape, (lambda a: a[1, 2:], _M), takes(dimensions=ANY), anywhere=True),
    _moving("transpose", _transpose, (lambda a: a.T, _M), takes(permutation=ANY)),
    _moving(
        "broadcast_in_dim",
        _broadcast_in_dim,
        (lambda a: a[:, None, :], _M),
        takes(shape=ANY, broadcast_dimensions=ANY, sharding=ANY),
        anywhere=True,
    ),
    _moving("concatenate", _concatenate, (lambda a: jnp.concatenate([a, a], 1), _M), takes(dimension=ANY)),
    _moving("stack", _stack, (lambda a: jnp.stack([a, -a], axis=1), _M), takes(axis=ANY)),
    _moving("unstack", _unstack, (lambda a: jnp.unstack(a, axis=1), _M), takes(axis=ANY)),
    _moving(
        "slice",
        _slice,
        (lambda a: a[1:, ::2], _M),
        takes(start_indices=ANY, limit_indices=ANY, strides=ANY),
        anywhere=True,
    ),
    _moving("rev", _rev, (lambda a: lax.rev(a, (0,)), _M), takes(dimensions=ANY)),
    _moving("split", _split, (lambda a: jnp.split(a, [1, 3], axis=1), _M), takes(sizes=ANY, axis=ANY)),
    _moving("tile", _tile, (lambda a: jnp.tile(a, (2, 3)), _M), takes(reps=ANY)),
    _moving(
        "iota",
        _iota,
        (lambda a: a + lax.broadcasted_iota(a.dtype, (3, 4), 1), _M),
        takes(dtype=ANY, shape=ANY, dimension=ANY, sharding=ANY),
    ),
    _moving("pad", _pad, (lambda a: lax.pad(a, 7.0, ((1, -1, 0), (0, 1, 2))), _M), takes(padding_config=ANY)),
    Entry(
        name="sort",
        takes=(takes(dimension=ANY, is_stable=ANY, num_keys=lambda count: count == 1),),
        read=_sort,
        any_type=True,
        example=(lambda i: jnp.sort(i), np.array([3, 1, 2])),
    ),
)
