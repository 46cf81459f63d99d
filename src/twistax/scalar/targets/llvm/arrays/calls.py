"""Calls in kernels: functions of matrices with loops, which members side by side call one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....graph import OpaqueCall, ScalarGraph
from ....primitives.interface import Nodes, flat, kernel_of
from ..code import NAMES, Code, Module
from ..machine_code import BuildError


def write_call(code: Code, graph: ScalarGraph, call: OpaqueCall, values: Sequence[str]) -> dict[int, str]:
    """Call a function for each lane.

    Args:
        values: of the nodes of all arguments.
    Returns:
        The values of the nodes of all results.
    """
    module, nodes = code.module, flat(*call.results)
    if module.processor.triple:
        raise BuildError("it calls a function with loops")
    kinds = [NAMES[graph.dtypes[i]] for i in call.sources]
    results = [NAMES[graph.dtypes[i]] for i in nodes]
    name = _of_lanes(module, code.lanes, call, kinds, results)
    operands = ", ".join(f"{code.vector(kind)} {value}" for kind, value in zip(kinds, values, strict=True))
    structure = "{ " + ", ".join(map(code.vector, results)) + " }"
    result = code.emit(f"call {structure} @{name}({operands})")
    return {i: code.emit(f"extractvalue {structure} {result}, {k}") for k, i in enumerate(nodes)}


def _of_lanes(module: Module, lanes: int, call: OpaqueCall, kinds: Sequence[str], results: Sequence[str]) -> str:
    """The name of a function from the entries of the arguments to those of the results, in lanes: it calls the kernel
    of the function with as many rows.
    """
    kernel = kernel_of(call)
    called = None if kernel is None else kernel.kernel
    if called is None:
        raise BuildError("it calls a function that has no kernel")
    symbol, address = called.symbol
    name = f"{symbol}.lanes"
    if name in module.functions:
        return name
    module.addresses[symbol] = address
    module.called.append(called.handle.code)
    module.declarations.add(f"declare void @{symbol}(ptr, i64, i64)")
    code, arrays = Code(module, lanes), called.body.arrays
    memory = {
        key: code.emit(f"alloca [{lanes * array.size} x {array.stored}], align 64") for key, array in arrays.items()
    }
    table = code.emit(f"alloca [{2 * len(arrays)} x i64], align 8")
    for k, (key, array) in enumerate(arrays.items()):
        address_of = code.emit(f"ptrtoint ptr {memory[key]} to i64")
        for place, value in ((k, address_of), (k + len(arrays), str(array.size))):
            there = code.emit(f"getelementptr i64, ptr {table}, i64 {place}")
            code.lines.append(f"store i64 {value}, ptr {there}, align 8")

    def at(key: str, lane: int, entry: int) -> str:
        array = arrays[key]
        return code.emit(f"getelementptr {array.stored}, ptr {memory[key]}, i64 {lane * array.size + entry}")

    names = [f"%x{k}" for k in range(len(kinds))]
    for key, _, values in _entries("a", call.arguments, names):
        for lane in range(lanes if key in arrays else 0):
            for entry, value in enumerate(values):
                number = code.entry(arrays[key].kind, value, lane)
                number = code.emit(f"zext i1 {number} to i8") if arrays[key].kind == "i1" else number
                stored, size = arrays[key].stored, arrays[key].dtype.itemsize
                code.lines.append(f"store {stored} {number}, ptr {at(key, lane, entry)}, align {size}")
    code.lines.append(f"call void @{symbol}(ptr {table}, i64 0, i64 {lanes})")
    structure, result = "{ " + ", ".join(map(code.vector, results)) + " }", "poison"
    place = 0
    for key, array, _ in _entries("r", call.results, results):
        for entry in range(array.size):
            vector = "poison"
            for lane in range(lanes):
                stored, size = arrays[key].stored, arrays[key].dtype.itemsize
                number = code.emit(f"load {stored}, ptr {at(key, lane, entry)}, align {size}")
                number = code.emit(f"icmp ne i8 {number}, 0") if arrays[key].kind == "i1" else number
                vector = code.put(arrays[key].kind, vector, lane, number)
            kind = code.vector(results[place])
            result = code.emit(f"insertvalue {structure} {result}, {kind} {vector}, {place}")
            place += 1
    head = ", ".join(f"{code.vector(kind)} {x}" for kind, x in zip(kinds, names, strict=True))
    module.functions[name] = code.function(f"internal {structure} @{name}({head})", f"ret {structure} {result}")
    return name


def _entries(letter: str, arrays: Sequence[Nodes], values: Sequence[str]) -> list[tuple[str, Nodes, Sequence[str]]]:
    """The arrays with their names in kernels, and the part of the values that are their entries."""
    parts, start = [], 0
    for k, array in enumerate(arrays):
        parts.append((f"{letter}{k}", array, values[start : start + array.size]))
        start += array.size
    return parts


def results_by_numpy(call: OpaqueCall, values: dict[int, NDArray[Any]]) -> dict[int, NDArray[Any]]:
    """The values of the results of a call for rows of arguments."""
    rows = max(len(values[i]) for i in call.sources)
    arguments = []
    for array, v in zip(call.arguments, call.jaxpr.jaxpr.invars, strict=True):
        columns = [np.broadcast_to(values[i], (rows,)).astype(v.aval.dtype) for i in flat(array)]
        arguments.append(np.stack(columns, axis=1))
    results = call.key.plain(arguments)
    return {
        i: result[:, k] for array, result in zip(call.results, results, strict=True) for k, i in enumerate(flat(array))
    }
