"""Calls in kernels: functions of matrices with loops, which members side by side call one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....graph import OpaqueCall, ScalarGraph
from ....primitives.interface import flat
from ..code import NAMES, Code, Module
from ..lanes import Array
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
    """The name of a function from the entries of the arguments to those of the results, in lanes."""
    callee = module.called.setdefault(call.key, f"loops.{len(module.called)}")
    name = f"{callee}.lanes"
    if callee not in module.functions:
        module.functions[callee] = call.key.text(module, callee)
    if name in module.functions:
        return name
    code = Code(module, lanes)
    arrays = [Array(a.shape, np.dtype(v.aval.dtype)) for a, v in _arrays(call)]
    memory = [code.emit(f"alloca [{array.size} x {array.stored}], align 64") for array in arrays]
    names = [f"%x{k}" for k in range(len(kinds))]
    places = [
        (array, f"{pointer}", k) for array, pointer in zip(arrays, memory, strict=True) for k in range(array.size)
    ]
    vectors = ["poison"] * len(results)
    for lane in range(lanes):
        for value, (array, pointer, k) in zip(names, places[: len(names)], strict=True):
            number = code.entry(array.kind, value, lane)
            number = code.emit(f"zext i1 {number} to i8") if array.kind == "i1" else number
            there = code.emit(f"getelementptr {array.stored}, ptr {pointer}, i64 {k}")
            code.lines.append(f"store {array.stored} {number}, ptr {there}, align {array.dtype.itemsize}")
        code.lines.append(f"call void @{callee}({', '.join(f'ptr {pointer}' for pointer in memory)})")
        for place, (array, pointer, k) in enumerate(places[len(names) :]):
            there = code.emit(f"getelementptr {array.stored}, ptr {pointer}, i64 {k}")
            number = code.emit(f"load {array.stored}, ptr {there}, align {array.dtype.itemsize}")
            number = code.emit(f"icmp ne i8 {number}, 0") if array.kind == "i1" else number
            vectors[place] = code.put(array.kind, vectors[place], lane, number)
    structure = "{ " + ", ".join(map(code.vector, results)) + " }"
    result = "poison"
    for k, (kind, vector) in enumerate(zip(results, vectors, strict=True)):
        result = code.emit(f"insertvalue {structure} {result}, {code.vector(kind)} {vector}, {k}")
    head = ", ".join(f"{code.vector(kind)} {x}" for kind, x in zip(kinds, names, strict=True))
    module.functions[name] = code.function(f"internal {structure} @{name}({head})", f"ret {structure} {result}")
    return name


def _arrays(call: OpaqueCall) -> list[tuple[Any, Any]]:
    """The arrays of nodes of a call, arguments first, and the variables of its function."""
    variables = [*call.jaxpr.jaxpr.invars, *call.jaxpr.jaxpr.outvars]
    return list(zip([*call.arguments, *call.results], variables, strict=True))


def results_by_numpy(call: OpaqueCall, values: dict[int, NDArray[Any]]) -> dict[int, NDArray[Any]]:
    """The values of the results of a call for rows of arguments."""
    rows = max(len(values[i]) for i in call.sources)
    arguments = []
    for array, v in _arrays(call)[: len(call.arguments)]:
        columns = [np.broadcast_to(values[i], (rows,)).astype(v.aval.dtype) for i in flat(array)]
        arguments.append(np.stack(columns, axis=1))
    results = call.key.plain(arguments)
    return {
        i: result[:, k] for array, result in zip(call.results, results, strict=True) for k, i in enumerate(flat(array))
    }
