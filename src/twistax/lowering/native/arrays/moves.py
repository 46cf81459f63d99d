"""What moves numbers: most of it is another view of the same memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..code import NAMES
from .memory import View, known
from .sweep import ArrayCode, reshaped

if TYPE_CHECKING:
    from .reader import Reading


def _reshape(own: Reading, eqn: Any, a: View) -> View:
    return reshaped(own.code, a, eqn.outvars[0].aval.shape)


def _broadcast(own: Reading, eqn: Any, a: View) -> View:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    sizes = [a.shape[axes.index(d)] if d in axes else 1 for d in range(len(shape))]
    return a.seen(np.broadcast_to(_with_axes(a.array, sizes), shape))


def _with_axes(array: Any, sizes: Sequence[int]) -> Any:
    """The array with axes of one entry put between its own; no copy."""
    found = array.reshape(tuple(sizes)) if 1 in array.shape or 0 in array.shape else None
    if found is not None and (found.size == 0 or np.may_share_memory(found, array)):
        return found
    index, left = list[Any](), list(array.shape)
    for size in sizes:
        index.append(slice(None) if left and left[0] == size else None)
        left = left[1:] if index[-1] is not None else left
    return array[(*index, ...)]


def _transpose(own: Reading, eqn: Any, a: View) -> View:
    return a.seen(a.array.transpose(eqn.params["permutation"]))


def _slice(own: Reading, eqn: Any, a: View) -> View:
    p = eqn.params
    steps = p["strides"] or (1,) * a.array.ndim
    return a.part(map(slice, p["start_indices"], p["limit_indices"], steps))


def _reverse(own: Reading, eqn: Any, a: View) -> View:
    return a.seen(np.flip(a.array, eqn.params["dimensions"]) if a.shape else a.array)


def _same(own: Reading, eqn: Any, a: View) -> View:
    return a


def _iota(own: Reading, eqn: Any) -> View:
    p = eqn.params
    axis = p["dimension"]
    numbers = np.arange(p["shape"][axis]).astype(np.dtype(p["dtype"]))
    return known(np.broadcast_to(np.expand_dims(numbers, [d for d in range(len(p["shape"])) if d != axis]), p["shape"]))


def _split(own: Reading, eqn: Any, a: View) -> list[View]:
    ends = np.cumsum(eqn.params["sizes"])[:-1].tolist()
    return [a.seen(part) for part in np.split(a.array, ends, eqn.params["axis"])]


def _unstack(own: Reading, eqn: Any, a: View) -> list[View]:
    return [_taken(a, k, eqn.params["axis"]) for k in range(a.shape[eqn.params["axis"]])]


def _taken(a: View, k: int, axis: int) -> View:
    index = (slice(None),) * axis
    return a.seen(a.array[(*index, slice(k, k + 1))].reshape([s for d, s in enumerate(a.shape) if d != axis]))


def _concatenate(own: Reading, eqn: Any, *parts: View) -> View:
    axis = eqn.params["dimension"]
    if all(part.known for part in parts):
        return known(np.concatenate([part.array for part in parts], axis))
    found = own.code.new(eqn.outvars[0].aval.shape, parts[0].dtype)
    start = 0
    for part in parts:
        end = start + part.shape[axis]
        own.code.copied(part, found.seen(found.array[(slice(None),) * axis + (slice(start, end),)]))
        start = end
    return found


def _stack(own: Reading, eqn: Any, *parts: View) -> View:
    axis = eqn.params["axis"]
    if all(part.known for part in parts):
        return known(np.stack([part.array for part in parts], axis))
    found = own.code.new(eqn.outvars[0].aval.shape, parts[0].dtype)
    for k, part in enumerate(parts):
        own.code.copied(part, _taken(found, k, axis))
    return found


def _pad(own: Reading, eqn: Any, a: View, value: View) -> View:
    config = eqn.params["padding_config"]
    shape = tuple(eqn.outvars[0].aval.shape)
    if any(low < 0 or high < 0 for low, high, _ in config):
        return own.by_entries(eqn, [a, value])[0]
    inner: tuple[Any, ...] = tuple(
        slice(low, size - high, step + 1) for (low, high, step), size in zip(config, shape, strict=True)
    )
    if a.known and value.known:
        numbers = np.full(shape, value.array, a.dtype)
        known(numbers).part(inner).array[...] = a.array
        return known(numbers)
    found = own.code.new(shape, a.dtype)
    own.code.copied(value.seen(np.broadcast_to(value.array, shape)), found)
    own.code.copied(a, found.part(inner))
    return found


def _dynamic_slice(own: Reading, eqn: Any, a: View, *indices: View) -> View:
    sizes = eqn.params["slice_sizes"]
    return _window(own.code, a, sizes, indices)


def _window(code: ArrayCode, a: View, sizes: Sequence[int], indices: Sequence[View]) -> View:
    """The part of these sizes that begins at indices, moved to lie inside, as JAX has it."""
    window, moved = list[slice](), list[tuple[int, str]]()
    for d, (size, index) in enumerate(zip(sizes, indices, strict=True)):
        most = a.shape[d] - size
        first = 0 if most == 0 else index.number
        if first is None:
            moved.append((d, _clamped(code, index, most)))
        window.append(slice(start := int(np.clip(first or 0, 0, most)), start + size))
    found = code.stored(a) if moved else a
    strides = found.array.strides
    found = found.part(window)
    for d, place in moved:
        found = code.at(found, place, strides[d])
    return found


def _clamped(code: ArrayCode, index: View, most: int) -> str:
    """An index between zero and the most it may be."""
    kind, own = NAMES[index.dtype], code.code
    value = code.scalar(index)
    if kind != "i64":
        value = own.convert("sext", kind, "i64", value)
    value = own.call("i64", "llvm.smax.i64", ("i64", value), ("i64", "0"))
    return own.call("i64", "llvm.smin.i64", ("i64", value), ("i64", str(most)))


def _dynamic_update(own: Reading, eqn: Any, a: View, update: View, *indices: View) -> View:
    if a.known and update.known and all(i.known for i in indices):
        numbers = a.array.copy()
        first = [int(np.clip(i.number, 0, n - m)) for i, n, m in zip(indices, a.shape, update.shape, strict=True)]
        numbers[tuple(slice(f, f + m) for f, m in zip(first, update.shape, strict=True))] = update.array
        return known(numbers)
    found = own.code.copied(a)
    own.code.copied(update, _window(own.code, found, update.shape, indices))
    return found


def _squeeze(own: Reading, eqn: Any, a: View) -> View:
    return a.seen(np.squeeze(a.array, tuple(eqn.params["dimensions"])))


def _expand(own: Reading, eqn: Any, a: View) -> View:
    return a.seen(np.expand_dims(a.array, tuple(eqn.params["dimensions"])))


#: By primitive.
MOVES: dict[str, Callable[..., Any]] = {
    "reshape": _reshape,
    "broadcast_in_dim": _broadcast,
    "transpose": _transpose,
    "slice": _slice,
    "rev": _reverse,
    "iota": _iota,
    "split": _split,
    "unstack": _unstack,
    "concatenate": _concatenate,
    "stack": _stack,
    "pad": _pad,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update,
    "squeeze": _squeeze,
    "expand_dims": _expand,
    "copy": _same,
    "optimization_barrier": lambda own, eqn, *arrays: list(arrays),
    "device_put": lambda own, eqn, *arrays: list(arrays),
}
