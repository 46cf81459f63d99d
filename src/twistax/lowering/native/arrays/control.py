"""Loops, branches and calls."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ....jax_inside import ClosedJaxpr, closed, scan_parts
from ..code import NAMES, NotNative
from .memory import View
from .reductions import any_of
from .sweep import reshaped

if TYPE_CHECKING:
    from .reader import Reading


def _linear_solve(eqn: Any, arrays: list[Any]) -> tuple[ClosedJaxpr, list[Any]]:
    """A linear solve by its own rule."""
    counts = eqn.params["const_lengths"]
    skip = counts.matvec + counts.vecmat
    return closed(eqn.params["jaxprs"].solve), [*arrays[skip : skip + counts.solve], *arrays[sum(counts) :]]


def _small_arrays(eqn: Any, arrays: list[Any]) -> tuple[ClosedJaxpr, list[Any]]:
    """A kernel that was traced by itself, of one body."""
    if eqn.params["bodies"].depth:
        raise NotNative("a kernel of many bodies inside of another has no native form")
    return eqn.params["program"].closed, arrays


def _inner(name: str) -> Callable[[Any, list[Any]], tuple[ClosedJaxpr, list[Any]]]:
    return lambda eqn, arrays: (closed(eqn.params[name]), arrays)


#: By primitive: the jaxpr that is read in its place, and what that is given.
CALLS: dict[str, Callable[[Any, list[Any]], tuple[ClosedJaxpr, list[Any]]]] = {
    "jit": _inner("jaxpr"),
    "remat2": _inner("jaxpr"),
    "custom_jvp_call": _inner("call_jaxpr"),
    "custom_vjp_call": _inner("call_jaxpr"),
    "custom_vmap_call": _inner("call"),
    "custom_linear_solve": _linear_solve,
    "small_arrays": _small_arrays,
}


def _scan(own: Reading, eqn: Any, *arrays: View) -> list[View]:
    p, code = eqn.params, own.code
    length, body = p["length"], p["jaxpr"]
    fixed, carried = scan_parts(eqn)
    constants, along = arrays[:fixed], [code.stored(a) if length > 1 else a for a in arrays[fixed + carried :]]
    state = [code.copied(a) for a in arrays[fixed : fixed + carried]]  # replaced in each turn
    rows = [code.new(v.aval.shape, v.aval.dtype) for v in eqn.outvars[carried:]]

    def step(index: str, _: list[str]) -> list[str]:
        if p["reverse"]:
            index = (
                str(length - 1 - int(index)) if index.isdigit() else code.code.emit(f"sub i64 {length - 1}, {index}")
            )
        found = own.read(body, [*constants, *state, *(code.along(a, 0, index) for a in along)])
        for value, row in zip(found[carried:], rows, strict=True):
            code.copied(value, code.along(row, 0, index))
        own.replaced(state, found[:carried])
        return []

    code.counted(length, step)
    return [*state, *rows]


def _while(own: Reading, eqn: Any, *arrays: View) -> list[View]:
    p, code = eqn.params, own.code.code
    before, inside = p["cond_nconsts"], p["body_nconsts"]
    state = [own.code.copied(a) for a in arrays[before + inside :]]  # replaced in each turn
    head, body, done = (code.label() for _ in range(3))
    code.lines += [f"br label %{head}", f"{head}:"]
    (goes,) = own.read(p["cond_jaxpr"], [*arrays[:before], *state])
    code.lines += [f"br i1 {own.code.scalar(any_of(own.code, goes))}, label %{body}, label %{done}", f"{body}:"]
    found = own.read(p["body_jaxpr"], [*arrays[before : before + inside], *state])
    if goes.shape:  # of a batch: whose loop has ended stays as it is
        found = [_chosen(own, goes, new, old) for new, old in zip(found, state, strict=True)]
    own.replaced(state, found)
    code.lines += [f"br label %{head}", f"{done}:"]
    return state


def _chosen(own: Reading, which: View, new: View, old: View) -> View:
    """The new entries where the first axes say so, else the old ones."""
    array = which.array.reshape(which.shape + (1,) * (new.array.ndim - which.array.ndim))
    each, to = which.seen(np.broadcast_to(array, new.shape)), own.code.new(new.shape, new.dtype)
    kind = NAMES[new.dtype]
    own.code.each([each, new, old], [to], lambda code, read: [code.select(kind, *(one() for one in read))])
    return to


def _cond(own: Reading, eqn: Any, index: View, *arrays: View) -> list[View]:
    branches, code = eqn.params["branches"], own.code.code
    if index.number is not None:
        return own.read(branches[int(np.clip(index.number, 0, len(branches) - 1))], arrays)
    kind, value = NAMES[index.dtype], own.code.scalar(index)
    results = [own.code.new(v.aval.shape, v.aval.dtype) for v in eqn.outvars]
    labels, done = [code.label() for _ in branches], code.label()
    # Below the first it is the first, beyond the last the last.
    below = code.emit(f"icmp slt {kind} {value}, 0") if kind != "i1" else "false"
    first = code.emit(f"select i1 {below}, {kind} 0, {kind} {value}") if kind != "i1" else value
    numbers = ["false", "true"] if kind == "i1" else [str(k) for k in range(len(branches))]
    cases = " ".join(f"{kind} {n}, label %{label}" for n, label in zip(numbers, labels[:-1], strict=False))
    code.lines.append(f"switch {kind} {first}, label %{labels[-1]} [ {cases} ]")
    for label, branch in zip(labels, branches, strict=True):
        code.lines.append(f"{label}:")
        for value_view, result in zip(own.read(branch, arrays), results, strict=True):
            own.code.copied(value_view, result)
        code.lines.append(f"br label %{done}")
    code.lines.append(f"{done}:")
    return results


def _program(own: Reading, eqn: Any, *arrays: View) -> list[View]:
    """A scalar program, of one body or of many, by its own kernel."""
    bodies, code = eqn.params["bodies"], own.code
    shape = bodies.shape(arrays)
    rows = math.prod(shape)
    results = [code.new((*shape, *own_shape), dtype) for own_shape, dtype in eqn.params["program"].results]
    if not rows:
        return results
    kernel = own.kernel(eqn.params["program"], rows == 1)
    tile, places, strides = kernel.tile, list[str](), list[int]()
    held = []  # copies stay until the call
    for k in tile.read:
        size = math.prod(arrays[k].shape[0 if k in bodies.shared else bodies.depth :])
        alone = k in bodies.shared or bodies.depth == 0
        view = code.stored(arrays[k])
        count = 1 if alone else rows
        flat = reshaped(code, view, (count, size))
        if (size > 1 and flat.array.strides[1] != flat.dtype.itemsize) or flat.array.strides[0] % flat.dtype.itemsize:
            flat = code.copied(flat)
        held.append(flat)
        places.append(code.pointer(flat))
        strides.append(0 if alone else flat.array.strides[0] // flat.dtype.itemsize)
    for k in tile.written:
        places.append(code.pointer(results[k]))
        strides.append(math.prod(tile.results[k].shape) if rows > 1 else 0)
    count = len(places)
    table = code.new((2 * count,), np.int64)
    base = code.pointer(table)
    for k, (place, stride) in enumerate(zip(places, strides, strict=True)):
        for at, text in ((k, f"ptr {place}"), (count + k, f"i64 {stride}")):
            there = code.code.emit(f"getelementptr i64, ptr {base}, i64 {at}")
            code.code.lines.append(f"store {text}, ptr {there}, align 8")
    symbol, address = kernel.symbol
    code.module.addresses[symbol] = address
    code.code.call("void", symbol, ("ptr", base), ("i64", "0"), ("i64", str(rows)))
    return results


#: By primitive: what begins and ends blocks of instructions, or calls.
CONTROL: dict[str, Callable[..., list[View]]] = {
    "scan": _scan,
    "while": _while,
    "cond": _cond,
    "native_program": _program,
    "scalar_program": _program,
}
