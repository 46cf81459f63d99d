"""Code for equations on large arrays, one function for each primitive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jax import lax

from .....jax_inside import closed, scan_parts
from ....parts.inlining import inlined
from ....primitives.table import OPERATIONS
from ..code import NotNative
from .entrywise import Lazy, Value, broadcast, viewed
from .memory import View, steps

_REDUCED: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "reduce_sum": ("add", lambda dtype: 0),
    "reduce_prod": ("mul", lambda dtype: 1),
    "reduce_max": ("max", lambda dtype: -np.inf if dtype.kind == "f" else np.iinfo(dtype).min),
    "reduce_min": ("min", lambda dtype: np.inf if dtype.kind == "f" else np.iinfo(dtype).max),
    "reduce_and": ("and", lambda dtype: True),
    "reduce_or": ("or", lambda dtype: False),
}


def _broadcast(writer: Any, eqn: Any, a: Value, *_: Value) -> list[Value]:
    return [broadcast(a, eqn.params["shape"], eqn.params["broadcast_dimensions"])]


def _reshape(writer: Any, eqn: Any, a: Value) -> list[Value]:
    shape = eqn.outvars[0].aval.shape
    if isinstance(a, Lazy) and not a.operands:
        return [viewed(a, lambda v: v, shape)]
    array = writer.stored(a)
    strides = _reshaped(array, shape)
    return [writer.contiguous(array).of(shape, steps(shape)) if strides is None else array.of(shape, strides)]


def _reshaped(a: View, shape: tuple[int, ...]) -> list[int] | None:
    """The strides with axes of length one added or left out; None where other axes change."""
    old = [(n, s) for n, s in zip(a.shape, a.strides, strict=True) if n != 1]
    if [n for n in shape if n != 1] != [n for n, _ in old]:
        return None
    rest = iter(old)
    return [0 if n == 1 else next(rest)[1] for n in shape]


def _transpose(writer: Any, eqn: Any, a: Value) -> list[Value]:
    order = eqn.params["permutation"]
    shape = tuple(a.shape[k] for k in order)
    return [viewed(a, lambda v: v.of(shape, [v.strides[k] for k in order]), shape)]


def _slice(writer: Any, eqn: Any, a: Value) -> list[Value]:
    p, shape = eqn.params, eqn.outvars[0].aval.shape
    return [_cut(writer, a, p["start_indices"], shape, p["strides"] or [1] * len(shape))]


def _cut(writer: Any, a: Value, starts: Any, shape: tuple[int, ...], every: Any) -> Value:
    def cut(v: View) -> View:
        first = sum(start * stride for start, stride in zip(starts, v.strides, strict=True))
        moved = writer.within(v.of((1,), (1,)), str(first))
        return moved.of(shape, [s * k for s, k in zip(v.strides, every, strict=True)])

    return viewed(a, cut, shape)


def _split(writer: Any, eqn: Any, a: Value) -> list[Value]:
    axis, starts, results = eqn.params["axis"], [0] * len(a.shape), []
    for v in eqn.outvars:
        results.append(_cut(writer, a, tuple(starts), v.aval.shape, [1] * len(starts)))
        starts[axis] += v.aval.shape[axis]
    return results


def _concatenate(writer: Any, eqn: Any, *arrays: Value) -> list[Value]:
    aval, axis, start = eqn.outvars[0].aval, eqn.params["dimension"], 0
    result = writer.buffer(np.dtype(aval.dtype), aval.shape)
    for a in arrays:
        starts = [start if k == axis else 0 for k in range(len(aval.shape))]
        writer.assign(_cut(writer, result, starts, a.shape, [1] * len(starts)), a)
        start += a.shape[axis]
    return [result]


def _stack(writer: Any, eqn: Any, *arrays: Value) -> list[Value]:
    aval, axis = eqn.outvars[0].aval, eqn.params["axis"]
    result = writer.buffer(np.dtype(aval.dtype), aval.shape)
    order = [axis, *(k for k in range(len(aval.shape)) if k != axis)]
    front = result.of([aval.shape[k] for k in order], [result.strides[k] for k in order])
    for k, a in enumerate(arrays):
        writer.assign(writer.within(front, str(k)), a)
    return [result]


def _pad(writer: Any, eqn: Any, a: Value, fill: Value) -> list[Value]:
    aval, edges = eqn.outvars[0].aval, eqn.params["padding_config"]
    if any(low < 0 or high < 0 for low, high, _ in edges):
        raise NotNative("negative padding has no native form")
    result = writer.buffer(np.dtype(aval.dtype), aval.shape)
    writer.assign(result, broadcast(fill, aval.shape, ()))
    writer.assign(_cut(writer, result, [low for low, _, _ in edges], a.shape, [inner + 1 for *_, inner in edges]), a)
    return [result]


def _reduce(writer: Any, eqn: Any, a: Value) -> list[Value]:
    pair, empty = _REDUCED[eqn.primitive.name]
    return [writer.reduced(a, tuple(map(int, eqn.params["axes"])), pair, empty(a.dtype))]


def _dot(writer: Any, eqn: Any, a: Value, b: Value) -> list[Value]:
    return [writer.product(eqn.params["dimension_numbers"], a, b)]


def _lu(writer: Any, eqn: Any, a: Value) -> list[Value]:
    if a.shape[-1] != a.shape[-2]:
        raise NotNative("LU of matrices that are not square has no native form")
    results: list[Value] = writer.lu(a, np.dtype(eqn.outvars[1].aval.dtype))
    return results


def _gather(writer: Any, eqn: Any, a: Value, indices: Value) -> list[Value]:
    """Slices at places along one axis."""
    numbers, p, shape = eqn.params["dimension_numbers"], eqn.params, eqn.outvars[0].aval.shape
    axes = tuple(map(int, numbers.start_index_map))
    keeps_slices = all(n == m or k in axes for k, (n, m) in enumerate(zip(p["slice_sizes"], a.shape, strict=True)))
    if len(axes) != 1 or tuple(map(int, numbers.collapsed_slice_dims)) != axes or numbers.operand_batching_dims:
        raise NotNative("a gather along several axes has no native form")
    fills = p["mode"] == lax.GatherScatterMode.FILL_OR_DROP
    if not keeps_slices or (fills and a.dtype.kind != "f"):
        raise NotNative("a gather of parts of slices has no native form")
    axis, outer = axes[0], [k for k in range(len(shape)) if k not in numbers.offset_dims]
    array, places = writer.stored(a), writer.stored(indices)
    result = writer.buffer(array.dtype, shape)
    kept = [k for k in range(len(array.shape)) if k != axis]
    inner = [result.strides[int(k)] for k in numbers.offset_dims]
    strides = [[result.strides[k] for k in outer], list(places.strides[:-1])]
    fill = np.nan if p["fill_value"] is None else p["fill_value"]
    rest, code = [inner, [array.strides[k] for k in kept]], writer.code

    def slices(entries: list[str]) -> None:
        last = array.shape[axis] - 1
        starts = _starts(writer, [(places, entries[1], last, array.strides[axis])])
        there = _is_place(writer, places, entries[1], last)

        def entry(inside: list[str]) -> None:
            value = writer.gathered(array, [writer.plus(start, inside[1]) for start in starts])
            if fills:
                value = code.select(array.kind, there, value, code.constant(array.kind, fill))
            writer.store(result, writer.plus(entries[0], inside[0]), value)

        writer.over([array.shape[k] for k in kept], rest, 1, entry)

    writer.over([shape[k] for k in outer], strides, 1, slices)
    return [result]


def _scatter(writer: Any, eqn: Any, a: Value, indices: Value, updates: Value) -> list[Value]:
    """Slices at places along one axis are set, or added to one after the other; others are left out."""
    numbers, p, adds = eqn.params["dimension_numbers"], eqn.params, eqn.primitive.name == "scatter-add"
    axes = tuple(map(int, numbers.scatter_dims_to_operand_dims))
    if len(axes) != 1 or tuple(map(int, numbers.inserted_window_dims)) != axes or numbers.operand_batching_dims:
        raise NotNative("a scatter along several axes has no native form")
    axis, last = axes[0], a.shape[axes[0]] - 1
    known = None if isinstance(indices, View) else indices.number
    within = known is not None and 0 <= int(known) <= last
    drops = p["mode"] == lax.GatherScatterMode.FILL_OR_DROP and not within
    result, places, new = _copied(writer, a), writer.stored(indices), writer.stored(updates)
    windows = [int(k) for k in numbers.update_window_dims]
    outer, kept = (
        [k for k in range(n) if k not in out] for n, out in ((len(new.shape), windows), (len(a.shape), [axis]))
    )
    if [new.shape[k] for k in windows] != [a.shape[k] for k in kept]:
        raise NotNative("a scatter of parts of slices has no native form")
    form = OPERATIONS["add"].llvm.of(a.dtype)

    def slices(entries: list[str]) -> None:
        starts = _starts(writer, [(places, entries[1], last, result.strides[axis])])
        kept_places = _is_place(writer, places, entries[1], last) if drops else ""

        def entry(inside: list[str]) -> None:
            there = [writer.plus(start, inside[1]) for start in starts]
            value = writer.load(new, writer.plus(entries[0], inside[0]))
            old = writer.gathered(result, there) if adds or drops else ""
            value = form(writer.code, result.kind, old, value) if adds else value
            value = writer.code.select(result.kind, kept_places, value, old) if drops else value
            writer.scattered(result, there, value)

        strides = [[new.strides[k] for k in windows], [result.strides[k] for k in kept]]
        writer.over([a.shape[k] for k in kept], strides, 1, entry)

    writer.over([new.shape[k] for k in outer], [[new.strides[k] for k in outer], places.strides[:-1]], 1, slices)
    return [result]


def _is_place(writer: Any, places: View, entry: str, last: int) -> str:
    """Whether an index is one of the places 0 to `last`, for each member."""
    index = writer.load(places, entry)
    flags: str = writer.code.instruction("icmp ule", places.kind, index, writer.code.constant(places.kind, last))
    return flags


def _starts(writer: Any, places: Sequence[tuple[View, str, int, int]]) -> list[str]:
    """The entry for each member at places that stand in memory: an array, the entry in it, the last place and the
    stride.
    """
    code, totals = writer.code, ["0"] * writer.code.lanes
    for view, entry, last, stride in places:
        index = writer.load(view, entry)
        index = index if view.kind == "i64" else code.convert("sext", view.kind, "i64", index)
        index = code.intrinsic("smax", "i64", index, code.constant("i64", 0))
        index = code.intrinsic("smin", "i64", index, code.constant("i64", last))
        moved = [writer.times(one, stride) for one in writer.lanes_of("i64", index)]
        totals = list(map(writer.plus, totals, moved))
    return totals


def _at_run_time(writer: Any, a: View, part: tuple[int, ...], indices: Sequence[Value]) -> list[str]:
    """The first entry of a part of an array, for each member."""
    places = zip(indices, a.shape, part, a.strides, strict=True)
    return _starts(writer, [(writer.stored(i), "0", n - m, stride) for i, n, m, stride in places if n > m])


def _dynamic_slice(writer: Any, eqn: Any, a: Value, *indices: Value) -> list[Value]:
    array, shape = writer.stored(a), eqn.outvars[0].aval.shape
    result, starts = writer.buffer(array.dtype, shape), _at_run_time(writer, array, shape, indices)

    def entry(entries: list[str]) -> None:
        there = [writer.plus(start, entries[1]) for start in starts]
        writer.store(result, entries[0], writer.gathered(array, there))

    writer.over(shape, [result.strides, array.strides], 1, entry)
    return [result]


def _dynamic_update_slice(writer: Any, eqn: Any, a: Value, update: Value, *indices: Value) -> list[Value]:
    result, new = _copied(writer, a), writer.stored(update)
    starts = _at_run_time(writer, result, new.shape, indices)

    def entry(entries: list[str]) -> None:
        there = [writer.plus(start, entries[1]) for start in starts]
        writer.scattered(result, there, writer.load(new, entries[0]))

    writer.over(new.shape, [new.strides, result.strides], 1, entry)
    return [result]


def _scan(writer: Any, eqn: Any, *values: Value) -> list[Value]:
    """All iterations; what is carried is copied after each of them."""
    fixed, carried = scan_parts(eqn)
    length, body = eqn.params["length"], inlined(closed(eqn.params["jaxpr"]))
    constants = [writer.stored(v) for v in values[:fixed]]
    state = [_copied(writer, v) for v in values[fixed : fixed + carried]]
    rows = [writer.stored(v) for v in values[fixed + carried :]]
    stacked = [writer.buffer(np.dtype(v.aval.dtype), v.aval.shape) for v in eqn.outvars[carried:]]

    def iteration(k: str, _: list[str]) -> list[str]:
        if eqn.params["reverse"]:
            k = writer.code.emit(f"sub i64 {length - 1}, {k}")
        results = writer.run(body, [*constants, *state, *(writer.within(row, k) for row in rows)])
        new = _apart(writer, state, results[:carried])
        for target, value in zip(stacked, results[carried:], strict=True):
            writer.assign(writer.within(target, k), value)
        for target, value in zip(state, new, strict=True):
            writer.assign(target, value)
        return []

    writer.loop("0", str(length), iteration)
    return [*state, *stacked]


def _apart(writer: Any, state: Sequence[View], results: Sequence[Value]) -> list[Value]:
    """Copies of new states that read what another state holds; those that only add to themselves stay as they are."""
    roots = {s.root for s in state}
    alone = [all(r == s or r.root not in roots for r in writer.reads(v)) for v, s in zip(results, state, strict=True)]
    return [v if one else _copied(writer, v) for v, one in zip(results, alone, strict=True)]


def _while(writer: Any, eqn: Any, *values: Value) -> list[Value]:
    """Iterations of one member, until its condition ends them."""
    p, code = eqn.params, writer.code
    if code.lanes > 1:
        raise NotNative("loops of unknown lengths have no native form for several batch members in one vector")
    asking, fixed = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
    condition, body = (inlined(closed(p[name])) for name in ("cond_jaxpr", "body_jaxpr"))
    constants, state = [writer.stored(v) for v in values[:fixed]], [_copied(writer, v) for v in values[fixed:]]
    head, inside, done = (code.label() for _ in range(3))
    code.lines += [f"br label %{head}", f"{head}:"]
    (flag,) = writer.run(condition, [*constants[:asking], *state])
    going = writer.load(writer.stored(flag), "0")
    code.lines += [f"br i1 {going}, label %{inside}, label %{done}", f"{inside}:"]
    results = writer.run(body, [*constants[asking:], *state])
    for target, value in zip(state, _apart(writer, state, results), strict=True):
        writer.assign(target, value)
    code.lines += [f"br label %{head}", f"{done}:"]
    return list(state)


def _cond(writer: Any, eqn: Any, index: Value, *values: Value) -> list[Value]:
    """The branch that one member takes; of members side by side all branches, of which each takes one."""
    code, branches = writer.code, [inlined(closed(branch)) for branch in eqn.params["branches"]]
    operands = [writer.stored(v) for v in values]
    results = [writer.buffer(np.dtype(v.aval.dtype), v.aval.shape) for v in eqn.outvars]
    places = writer.stored(index)
    kind, last = places.kind, len(branches) - 1
    # As JAX has it, an index beyond is the nearest one.
    number = code.intrinsic("smax", kind, writer.load(places, "0"), code.constant(kind, 0))
    number = code.intrinsic("smin", kind, number, code.constant(kind, last))
    if code.lanes > 1:
        for k, branch in enumerate(branches):
            taken = code.instruction("icmp eq", kind, number, code.constant(kind, k))
            for target, value in zip(results, writer.run(branch, operands), strict=True):
                _assign_where(writer, taken, target, writer.stored(value))
        return list(results)
    labels, done = [code.label() for _ in branches], code.label()
    cases = " ".join(f"{kind} {k}, label %{label}" for k, label in enumerate(labels[:-1]))
    code.lines.append(f"switch {kind} {number}, label %{labels[-1]} [ {cases} ]")
    for branch, label in zip(branches, labels, strict=True):
        code.lines.append(f"{label}:")
        for target, value in zip(results, writer.run(branch, operands), strict=True):
            writer.assign(target, value)
        code.lines.append(f"br label %{done}")
    code.lines.append(f"{done}:")
    return list(results)


def _assign_where(writer: Any, flags: str, target: View, value: View) -> None:
    """Write an array for the members with a flag."""

    def entry(places: list[str]) -> None:
        old, new = writer.load(target, places[0]), writer.load(value, places[1])
        writer.store(target, places[0], writer.code.select(target.kind, flags, new, old))

    writer.over(target.shape, [target.strides, value.strides], 1, entry)


def _copied(writer: Any, value: Value) -> View:
    target: View = writer.buffer(value.dtype, value.shape)
    writer.assign(target, value)
    return target


def _iota(writer: Any, eqn: Any) -> list[Value]:
    aval, axis = eqn.outvars[0].aval, eqn.params["dimension"]
    numbers = writer.table(np.arange(aval.shape[axis], dtype=aval.dtype))
    return [broadcast(numbers, aval.shape, [axis])]


def _same(writer: Any, eqn: Any, *arrays: Value) -> list[Value]:
    return list(arrays)


#: By the names of primitives.
WRITERS: Mapping[str, Callable[..., list[Value]]] = {
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "squeeze": _reshape,
    "transpose": _transpose,
    "slice": _slice,
    "split": _split,
    "concatenate": _concatenate,
    "stack": _stack,
    "pad": _pad,
    **dict.fromkeys(_REDUCED, _reduce),
    "dot_general": _dot,
    "cholesky": lambda writer, eqn, a: [writer.cholesky(a)],
    "lu": _lu,
    "triangular_solve": lambda writer, eqn, a, b: [writer.triangular_solve(eqn.params, a, b)],
    "gather": _gather,
    **dict.fromkeys(("scatter", "scatter-add"), _scatter),
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "iota": _iota,
    "scan": _scan,
    "while": _while,
    "cond": _cond,
    **dict.fromkeys(("copy", "optimization_barrier", "stop_gradient"), _same),
}
