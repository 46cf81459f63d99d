"""Straight-line programs as kernel bodies, and the functions of programs that they contain several times."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....graph import OpaqueCall
from ....primitives.interface import PRODUCT, by_columns, flat, is_loop, kernel_of
from ....program import ScalarProgram
from ..code import Code, Module
from ..kernel_body import TURNING, KernelBody, Rounded, Scalars, arguments_of, by_numpy, native_form, needed_by
from ..lanes import Array, ColumnArray, Rows
from .pieces import PieceValues, Scratch
from .products import write_product
from .repeats import argument_places

#: Entries of results above which LLVM's order of instructions takes seconds: its time grows with their square.
_MANY = 1000


class Straight(KernelBody):
    """A straight-line program, from its arguments to its results."""

    #: Before the names of its pieces.
    prefix = ""
    #: Operations on scalars that a thread takes at a time, some 5 us.
    _CHUNK = 250_000

    def __init__(self, program: ScalarProgram, lanes: int) -> None:
        results = [Array(nodes.shape, dtype) for nodes, dtype in zip(program.outputs, program.types, strict=True)]
        super().__init__(program, lanes, arguments_of(program), results, needed_by(program))
        self.chunk = max(1, self._CHUNK // (max(program.operations, 1) * lanes)) * lanes

    def body(self, code: Code, rows: Mapping[str, Rows]) -> None:
        loops = any(map(is_loop, self.program.calls))
        pieces = self.program.operations >= code.module.processor.longest or loops
        code.module.long = pieces or sum(array.size for array in self.results) > _MANY
        if pieces:
            self._in_pieces(code, rows)
            return
        scalars = Scalars(code, self.program, functools.partial(_entry, rows))
        scalars.compute(self.program.live)
        for k in self.written:
            rows[f"r{k}"].write(scalars.compute(flat(self.program.outputs[k])))

    def _in_pieces(self, code: Code, rows: Mapping[str, Rows]) -> None:
        """Write the program as several functions, called in turn."""
        program, module, g = self.program, code.module, self.program.graph
        blocks = {(k, start): piece for k in self.written for start, piece in rows[f"r{k}"].blocks().items()}
        if not module.by_columns:
            written = {block: entries for block, entries in blocks.items() if not self._zeros(block, entries)}
            for k in sorted({k for k, _ in blocks.keys() - written.keys()}):
                rows[f"r{k}"].clear()
            blocks = written
        first = [i for i in program.live if g.operation(i) in TURNING or kernel_of(g.call_of(i)) is not None]
        scratch = Scratch(program, module.processor, first, blocks)
        after = dict[int, tuple[OpaqueCall, list[int]]]()
        for number, steps in enumerate(scratch.pieces):
            piece = Code(module, self.lanes)
            inner = self._moved(piece)
            scalars = Scalars(piece, program, functools.partial(_entry, inner))
            straight = number and number not in scratch.loops
            values = scalars.values = PieceValues(piece, scratch, steps, module.processor.held if straight else None)
            call = scratch.loops.get(number)
            if call is not None and call.key == PRODUCT:
                write_product(piece, scratch, call, scalars.value)
            elif call is not None:
                after[number] = call, argument_places(piece, scratch, call, scalars.value)
            for nodes, complete in steps:
                scalars.in_piece(nodes)
                for k, start in complete:
                    entries = scratch.entries((k, start))
                    inner[f"r{k}"].write_block(start, list(map(scalars.value, entries)))
                    values.used(entries)
            name = f"{self.prefix}piece.{number}"
            head = f"void @{name}(ptr noalias %scratch, i64 %last{self._heads('ptr noalias')})"
            linkage = "internal " if module.processor.triple else ""
            if piece.lines:
                module.pieces[name] = f"declare {head}", piece.function(linkage + head)
        memory = scratch.allocated(code)
        for number in range(len(scratch.pieces)):
            name = f"{self.prefix}piece.{number}"
            if name in module.pieces:
                code.lines.append(f"call void @{name}(ptr {memory}, i64 %last{self._heads('ptr')})")
            if number in after:
                self._call(code, scratch, memory, *after[number])
        scratch.freed(code, memory)

    def _call(self, code: Code, scratch: Scratch, memory: str, call: OpaqueCall, places: Sequence[int]) -> None:
        """Call the function of a repeated program, with its arguments and results in memory."""
        module, count = code.module, len(call.arguments[0])
        if call.key not in module.repeats:
            name = module.repeats[call.key] = f"repeat.{len(module.repeats)}"
            RepeatedBody(native_form(call.key.program), count, name).write(module)
        results = [scratch.slots[by_columns(array)[0]] for array in call.results]
        starts = [code.emit(f"getelementptr i8, ptr {memory}, i64 {8 * place}") for place in (*places, *results)]
        pointers = ", ".join(f"ptr {start}" for start in starts)
        code.lines.append(f"call void @{module.repeats[call.key]}(i64 {count - 1}, {pointers})")

    def _zeros(self, block: tuple[int, int], entries: Sequence[int]) -> bool:
        """Whether a block of a result is zeros."""
        nodes, numbers = self.program.outputs[block[0]].reshape(-1), self.program.graph.numbers
        return all(numbers[nodes[entry]] == 0 for entry in entries)

    def plain(self, arguments: Sequence[NDArray[Any]], rounded: Rounded = np.asarray) -> list[NDArray[Any]]:
        return by_numpy(self.program, arguments, rounded)


class RepeatedBody(Straight):
    """The function of a repeated program: all times side by side, with arrays (entries, n) in memory.

    Args:
        program: in native form.
        name: of the function.
    """

    def __init__(self, program: ScalarProgram, lanes: int, name: str) -> None:
        super().__init__(program, lanes)
        self.name, self.prefix = name, f"{name}."

    def write(self, module: Module) -> None:
        code = Code(module, self.lanes)
        long, calls = module.long, module.calls
        self.body(code, self._moved(code))
        module.long, module.calls = module.long or long, calls
        module.functions[self.name] = code.function(
            f"internal void @{self.name}(i64 %last{self._heads('ptr noalias')})"
        )

    @property
    def arrays(self) -> dict[str, Array]:
        arguments = {f"a{k}": array for k, array in enumerate(self.arguments)}
        return arguments | {f"r{k}": array for k, array in enumerate(self.results)}

    def _moved(self, code: Code) -> dict[str, Rows]:
        return {name: ColumnArray(code, array, [f"%{name}"]) for name, array in self.arrays.items()}

    def _heads(self, pointer: str) -> str:
        return "".join(f", {pointer} %{name}" for name in self.arrays)


def _entry(rows: Mapping[str, Rows], argument: int, entry: int) -> str:
    return rows[f"a{argument}"].read(entry)
