"""A long straight program as several functions: LLVM's time grows faster than the length of a function.

Values that later pieces need pass through memory, where most would be anyway: there are few registers.
"""

from __future__ import annotations

from collections.abc import Sequence

from ...primitives.interface import flat
from ...program import ScalarProgram
from .code import NAMES, Code

#: Operations in a piece. Half as many compile slightly faster, and run at least a tenth slower.
_LENGTH = 2000
#: Programs of fewer operations are not split: they run a tenth faster.
LONG = 20_000
#: The most bytes on the stack; more are allocated.
STACK = 32_768

#: A piece of a program: its nodes, and of each result the blocks, by their first entries, that are complete with it.
Piece = tuple[list[int], list[tuple[int, int]]]


class Scratch:
    """The nodes that pass from piece to piece, and their places in memory.

    Args:
        program: in the order in which it is computed.
        first: nodes of the first piece, with all that they need.
        blocks: of each result, entries that are written together: (number of the result, first entry) -> entries.
    """

    def __init__(self, program: ScalarProgram, first: Sequence[int], blocks: dict[tuple[int, int], list[int]]) -> None:
        g = self._graph = program.graph
        begun = set(g.live(first))
        parts = [[i for i in program.live if i in begun]]
        rest = [i for i in program.live if i not in begun and g.operation(i) is not None]
        parts += [rest[k : k + _LENGTH] for k in range(0, len(rest), _LENGTH)]
        place = {i: number for number, part in enumerate(parts) for i in part}
        outputs = [flat(nodes) for nodes in program.outputs]
        self.pieces: list[Piece] = [(part, []) for part in parts]
        last: dict[int, int] = {}
        for i, number in place.items():
            for a in g.arguments(i):
                last[a] = max(last.get(a, 0), number)
        for (result, start), entries in blocks.items():
            nodes = [outputs[result][entry] for entry in entries]
            number = max(place.get(i, 0) for i in nodes)
            self.pieces[number][1].append((result, start))
            for i in nodes:
                last[i] = max(last.get(i, 0), number)
        #: By node, its place in memory; places are reused.
        self.slots: dict[int, int] = {}
        self.size = 0
        free: list[int] = []
        ending: dict[int, list[int]] = {}
        for number, part in enumerate(parts):
            free += ending.pop(number - 1, [])
            for i in part:
                if g.operation(i) is not None and last.get(i, 0) > number:
                    if not free:
                        free.append(self.size)
                        self.size += 1
                    self.slots[i] = free.pop()
                    ending.setdefault(last[i], []).append(self.slots[i])

    def at(self, code: Code, node: int) -> tuple[str, str]:
        """The type of a node's vector, and its address."""
        place = code.emit(f"getelementptr i8, ptr %scratch, i64 {8 * code.lanes * self.slots[node]}")
        return code.vector(NAMES[self._graph.dtypes[node]]), place

    def bytes(self, lanes: int) -> int:
        return 8 * lanes * self.size

    def allocated(self, code: Code) -> str:
        """The memory of all places: on the stack where there is little. Stacks of threads may be small."""
        size = max(self.bytes(code.lanes), 1)
        return (
            code.call("ptr", "malloc", ("i64", str(size)))
            if size > STACK
            else code.emit(f"alloca [{size} x i8], align 64")
        )

    def freed(self, code: Code, memory: str) -> None:
        if self.bytes(code.lanes) > STACK:
            code.call("void", "free", ("ptr", memory))


class PieceValues(dict[int, str]):
    """The values of nodes in one piece; those of earlier pieces are loaded where they are first needed."""

    def __init__(self, code: Code, scratch: Scratch) -> None:
        super().__init__()
        self._code, self._scratch = code, scratch

    def __missing__(self, node: int) -> str:
        kind, place = self._scratch.at(self._code, node)
        self[node] = value = self._code.emit(f"load {kind}, ptr {place}, align 8")
        return value

    def keep(self, nodes: Sequence[int]) -> None:
        """Store the values that later pieces need."""
        for i in nodes:
            if i in self._scratch.slots:
                kind, place = self._scratch.at(self._code, i)
                self._code.lines.append(f"store {kind} {self[i]}, ptr {place}, align 8")
