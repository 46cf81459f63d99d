"""A scalar program as one function that computes as many bodies at once as a vector has lanes."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scalar.graph import Limits, TooLarge
from ..scalar.in_llvm import NAMES
from ..scalar.passes import emitted_form
from ..scalar.program import ScalarProgram
from .code import Code, Module, NotNative
from .rows import Array, Rows
from .scalars import Scalars, form_of

__all__ = ["NATIVE_LIMITS", "Shape", "Signature", "Straight", "Tile", "by_numpy", "native_form", "rows_of", "shapes_of"]

#: Kernels call no library: more is unrolled than for XLA.
NATIVE_LIMITS = Limits(pivoted=8, table=64, equations=100_000)

#: The shape of one row of an array, and its type.
Shape = tuple[tuple[int, ...], np.dtype[Any]]


@dataclasses.dataclass(frozen=True)
class Signature:
    """Which arguments and results a kernel reads and writes: those that are needed and not empty.

    Attributes:
        arguments, results: place among all of them -> rows of it.
    """

    arguments: dict[int, Array]
    results: dict[int, Array]

    @property
    def arrays(self) -> list[Array]:
        """Arguments first."""
        return [*self.arguments.values(), *self.results.values()]

    @property
    def names(self) -> list[str]:
        """What kernels call them."""
        return [*(f"a{k}" for k in self.arguments), *(f"r{k}" for k in self.results)]


class Tile(ABC):
    """A function `tile(last, arguments, results)`: rows 0 to `last` of arrays, at most as many as there are lanes.

    Attributes:
        lanes: rows computed side by side.
        arguments, results: all of them, of one row.
        signature: those that are read and written.
        chunk: rows that a thread takes at a time, a multiple of the lanes.
    """

    lanes: int
    arguments: list[Shape]
    results: list[Shape]
    signature: Signature
    chunk: int

    @abstractmethod
    def write(self, module: Module) -> None:
        """Adds the function, and what it calls."""

    @abstractmethod
    def plain(self, arguments: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        """All results by NumPy, for all arguments, (rows, entries) each."""

    def exercised(self, arguments: list[NDArray[Any]]) -> list[NDArray[Any]]:
        """Arguments drawn at random, changed where chance alone would leave much of the function untried."""
        return arguments

    def begin(self, module: Module) -> tuple[Code, dict[int, Rows], dict[int, Rows]]:
        """The code of the function, how it reads its arguments, and how it writes its results."""
        code = Code(module, self.lanes)
        places = [_place(code, lane) for lane in range(self.lanes)]
        reads = {k: Rows(code, array, f"%a{k}", places) for k, array in self.signature.arguments.items()}
        writes = {k: Rows(code, array, f"%r{k}", places) for k, array in self.signature.results.items()}
        return code, reads, writes

    def end(self, code: Code) -> None:
        """Adds the function to the module of its code."""
        heads = "".join(f", ptr noalias %{name}" for name in self.signature.names)
        code.module.functions["tile"] = code.function(f"internal void @tile(i64 %last{heads})")


class Straight(Tile):
    """A program, from its arguments to its results.

    Args:
        form: from `native_form`.
    """

    #: Operations on scalars that a thread takes at a time, some 5 us.
    _CHUNK = 250_000

    def __init__(self, form: ScalarProgram, lanes: int) -> None:
        g = form.graph
        self.form = form
        self.lanes = lanes
        self.arguments = shapes_of(form)
        self.results = [(nodes.shape, dtype) for nodes, dtype in zip(form.outputs, form.types, strict=True)]
        read = {place[0] for i in form.live if (place := g.input_of(i)) is not None}
        self.signature = Signature(rows_of(self.arguments, read), rows_of(self.results))
        self.chunk = max(1, self._CHUNK // (max(form.operations, 1) * lanes)) * lanes

    def write(self, module: Module) -> None:
        form = self.form
        code, reads, writes = self.begin(module)
        scalars = Scalars(code, form, lambda argument, entry: reads[argument].read(entry))
        scalars.compute(form.live)
        for k, rows in writes.items():
            rows.write(scalars.compute(form.outputs[k].reshape(-1).tolist()))
        self.end(code)

    def plain(self, arguments: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        return by_numpy(self.form, arguments)


def native_form(program: ScalarProgram) -> ScalarProgram:
    """The program as kernels are written from it.

    Raises:
        NotNative: it calls functions, or has numbers or operations, that have no native form, or grows too large.
    """
    try:
        form = emitted_form(program, NATIVE_LIMITS)
    except TooLarge as error:
        raise NotNative(str(error).splitlines()[0]) from error
    g = form.graph
    if form.calls:
        names = sorted({e.primitive.name for call in form.calls for e in call.jaxpr.jaxpr.eqns})
        raise NotNative(f"{', '.join(names)} has no native form")
    for i in form.live:
        if g.dtypes[i] not in NAMES:
            raise NotNative(f"{g.dtypes[i]} has no native form")
        operation = g.operation(i)
        if operation is not None:
            form_of(operation, g.dtypes[g.arguments(i)[-1]])
    if g.dtype not in (np.float32, np.float64):
        raise NotNative(f"{g.dtype} has no native form")
    return form


def shapes_of(form: ScalarProgram) -> list[Shape]:
    """The arguments of a program."""
    g = form.graph
    return [(a.shape, g.dtypes[int(a.reshape(-1)[0])] if a.size else g.dtype) for a in form.inputs]


def rows_of(shapes: Sequence[Shape], read: set[int] | None = None) -> dict[int, Array]:
    """Those that are not empty, and needed."""
    return {
        k: Array(int(np.prod(shape)), dtype)
        for k, (shape, dtype) in enumerate(shapes)
        if np.prod(shape) and (read is None or k in read)
    }


def by_numpy(program: ScalarProgram, arguments: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
    """The results for rows of arguments, (rows, entries) each, operation by operation: kernels are held against it."""
    g = program.graph
    count = len(arguments[0]) if arguments else 1
    values: dict[int, NDArray[Any]] = {}
    with np.errstate(all="ignore"):
        for i in program.live:
            place, operation = g.input_of(i), g.operation(i)
            if place is not None:
                values[i] = arguments[place[0]][:, place[1]]
            elif operation is None:
                values[i] = np.full(count, g.numbers[i], g.dtypes[i])
            else:
                values[i] = np.asarray(operation.number(*(values[a] for a in g.arguments(i)))).astype(g.dtypes[i])
    return [
        np.stack([values[i] for i in nodes.reshape(-1).tolist()], 1) if nodes.size else np.zeros((count, 0), dtype)
        for nodes, dtype in zip(program.outputs, program.types, strict=True)
    ]


def _place(code: Code, lane: int) -> str:
    """The row of a lane: its own, or the last one."""
    if lane == 0:
        return "0"
    code.module.declarations.add("declare i64 @llvm.umin.i64(i64, i64)")
    return code.emit(f"call i64 @llvm.umin.i64(i64 %last, i64 {lane})")
