"""A scalar program as one function that works out as many bodies at once as a vector has lanes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..scalar.passes import emitted_form
from ..scalar.program import ScalarProgram
from .code import NAMES, Code, Module, NotNative
from .operations import TURNING, check, instructions
from .rows import Array, Rows
from .trigonometry import sines_and_cosines

__all__ = ["Signature", "native_form", "signature", "write_tile"]


@dataclasses.dataclass(frozen=True)
class Signature:
    """Which arguments and results of a program its kernel reads and writes: those that are needed and not empty.

    Attributes:
        arguments, results: place among those of the program -> rows of it.
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


def native_form(program: ScalarProgram) -> ScalarProgram:
    """The program as kernels are written from it.

    Raises:
        NotNative: it calls functions, or has numbers or operations, that have no native form.
    """
    form = emitted_form(program)
    g = form.graph
    if form.calls:
        names = sorted({e.primitive.name for call in form.calls for e in call.jaxpr.jaxpr.eqns})
        raise NotNative(f"{', '.join(names)} has no native form")
    for i in form.live:
        if g.dtypes[i] not in NAMES:
            raise NotNative(f"{g.dtypes[i]} has no native form")
        operation = g.operation(i)
        if operation is not None:
            check(operation, [NAMES[g.dtypes[a]] for a in g.arguments(i)])
    if g.dtype not in (np.float32, np.float64):
        raise NotNative(f"{g.dtype} has no native form")
    return form


def signature(form: ScalarProgram) -> Signature:
    """The arrays of a kernel."""
    g = form.graph
    read = {place[0] for i in form.live if (place := g.input_of(i)) is not None}
    return Signature(
        {k: Array(a.size, g.dtypes[int(a.reshape(-1)[0])]) for k, a in enumerate(form.inputs) if k in read},
        {k: Array(a.size, t) for k, (a, t) in enumerate(zip(form.outputs, form.types, strict=True)) if a.size},
    )


def write_tile(module: Module, form: ScalarProgram, arrays: Signature) -> None:
    """`tile(last, arguments, results)`: rows 0 to `last` of arrays at these pointers, at most as many as lanes."""
    g = form.graph
    code = Code(module, module.processor.lanes(g.dtype))
    places = [_place(code, lane) for lane in range(code.lanes)]
    readers = {k: Rows(code, array, f"%a{k}", places) for k, array in arrays.arguments.items()}
    values: dict[int, str] = {}
    turned: dict[int, tuple[str, ...]] = {}

    def work_out(nodes: Sequence[int]) -> None:
        for i in nodes:
            if i in values:
                continue
            place, operation, arguments = g.input_of(i), g.operation(i), g.arguments(i)
            if place is not None:
                values[i] = readers[place[0]].read(place[1])
            elif operation is None:
                values[i] = code.constant(NAMES[g.dtypes[i]], g.numbers[i])
            elif operation in TURNING:
                values[i] = turned[arguments[0]][TURNING.index(operation)]
            else:
                kinds = [NAMES[g.dtypes[a]] for a in arguments]
                values[i] = instructions(code, operation, kinds, [values[a] for a in arguments])

    for angles in _angles(form):
        work_out(g.live(angles))
        found = sines_and_cosines(code, NAMES[g.dtype], [values[i] for i in angles])
        turned.update(zip(angles, found, strict=True))
    work_out(form.live)
    for k, array in arrays.results.items():
        Rows(code, array, f"%r{k}", places).write([values[i] for i in form.outputs[k].reshape(-1).tolist()])
    heads = "".join(f", ptr noalias %{name}" for name in arrays.names)
    module.functions["tile"] = code.function(f"internal void @tile(i64 %last{heads})")


def _angles(form: ScalarProgram) -> list[list[int]]:
    """The angles of all sines and cosines: first those that depend on no other sine or cosine, and so on."""
    g = form.graph
    depth: dict[int, int] = {}
    found: dict[int, list[int]] = {}
    for i in form.live:
        arguments = g.arguments(i)
        depth[i] = max((depth[a] for a in arguments), default=0)
        if g.operation(i) in TURNING:
            angles = found.setdefault(depth[i], [])
            if arguments[0] not in angles:
                angles.append(arguments[0])
            depth[i] += 1
    return [found[k] for k in sorted(found)]


def _place(code: Code, lane: int) -> str:
    """The row of a lane: its own, or the last one."""
    if lane == 0:
        return "0"
    code.module.declarations.add("declare i64 @llvm.umin.i64(i64, i64)")
    return code.emit(f"call i64 @llvm.umin.i64(i64 %last, i64 {lane})")
