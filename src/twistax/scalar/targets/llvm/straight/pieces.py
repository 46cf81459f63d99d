"""A straight-line program as several functions, in which few values are live at a time.

For a long function, LLVM spends most of its time on register allocation. Here the values to spill are chosen in
advance: LLVM then takes a third of the time, and its code runs faster.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

from ....graph import OpaqueCall
from ....primitives.interface import PRODUCT, by_columns, flat, is_loop, kernel_of
from ....program import ScalarProgram
from ..code import NAMES, Code
from ..machine_code import Processor

#: Operations in a piece. Of functions with more the memory that LLVM takes grows.
_LENGTH = 4000
_LENGTH_ON_DEVICE = 2000
#: The most bytes on the stack; more are allocated.
STACK = 32_768

#: Entries of a result that are written together, by its number and their first entry.
ResultBlock: TypeAlias = tuple[int, int]


class PieceStep(NamedTuple):
    """Nodes, and the blocks that are complete with them."""

    nodes: list[int]
    complete: list[ResultBlock]


class Scratch:
    """The nodes that are passed between pieces, and their positions in memory.

    Args:
        program: in the order in which it is computed.
        first: nodes of the first piece, with all that they need.
        blocks: of each result, entries that are written together: (number of the result, first entry) -> entries.

    Attributes:
        pieces: what is computed and written, in order.
        loops: those of these that are products of matrices, or write the arguments of functions, by number.
        slots: by node, its place in memory; places are reused.
    """

    def __init__(
        self,
        program: ScalarProgram,
        processor: Processor,
        first: Sequence[int],
        blocks: Mapping[ResultBlock, Sequence[int]],
    ) -> None:
        g = self.graph = program.graph
        length = _LENGTH_ON_DEVICE if processor.triple else _LENGTH
        begun = set(g.live(first))
        parts = [[i for i in program.live if i in begun]]
        self.loops: dict[int, OpaqueCall] = {}
        written_after: set[int] = set()
        place = dict.fromkeys(parts[0], 0)
        for i in program.live:
            call = g.call_of(i)
            if call is not None and is_loop(call) and call.first == [i]:
                self.loops[len(parts)] = call
                # A function is called after the piece that writes its arguments.
                results = len(parts) + (call.key != PRODUCT)
                written_after.add(results)
                place.update(dict.fromkeys(flat(*call.results), results))
                parts += [[] for _ in range(2 if call.key == PRODUCT else 3)]
            elif i not in begun and g.operation(i) is not None:
                if len(parts) == 1 or len(parts[-1]) == length:
                    parts.append([])
                parts[-1].append(i)
                place[i] = len(parts) - 1
        outputs = [flat(nodes) for nodes in program.outputs]
        self._blocks = {block: [outputs[block[0]][entry] for entry in entries] for block, entries in blocks.items()}
        at_once: list[ResultBlock] = []
        complete: dict[int, list[ResultBlock]] = {}
        after: dict[int, list[ResultBlock]] = {}
        last: dict[int, int] = {}
        for i, number in place.items():
            for a in g.sources(i):
                last[a] = max(last.get(a, 0), number)
        for block, nodes in self._blocks.items():
            number, latest = max((place.get(i, 0), i) for i in nodes)
            if number in written_after:
                after.setdefault(number, []).append(block)
            else:
                (complete.setdefault(latest, []) if number else at_once).append(block)
            for i in nodes:
                last[i] = max(last.get(i, 0), number)
        self.pieces = [[PieceStep(parts[0], at_once)]]
        for number, part in enumerate(parts[1:], 1):
            self.pieces.append([PieceStep([], after.get(number, [])), *_steps(part, complete)])
        self.slots: dict[int, int] = {}
        self._size = self._further = 0
        rows = self._new_rows(place)
        free: dict[int, list[int]] = {}
        ending: dict[int, list[tuple[int, int]]] = {}
        for number, part in enumerate(parts):
            for width, slot in ending.pop(number - 1, []):
                free.setdefault(width, []).append(slot)
            computed = (i for i in part if g.operation(i) is not None or kernel_of(g.call_of(i)) is not None)
            leaving = ((i,) for i in computed if i not in self.slots and last.get(i, 0) > number)
            for row in (*rows.get(number, []), *leaving):
                slots = free.setdefault(len(row), [])
                if not slots:
                    slots.append(self._size)
                    self._size += len(row)
                slot = slots.pop()
                self.slots.update(zip(row, range(slot, slot + len(row)), strict=True))
                ending.setdefault(max(last.get(i, number) for i in row), []).append((len(row), slot))

    def _new_rows(self, place: Mapping[int, int]) -> dict[int, list[tuple[int, ...]]]:
        """Rows of the matrices of products that stand in memory one after the other, by the piece that begins them."""
        g, rows = self.graph, dict[int, list[tuple[int, ...]]]()
        taken: set[int] = set()
        for call in self.loops.values():
            if call.key == PRODUCT:
                wanted = map(tuple, (*call.arguments[1].tolist(), *call.results[0].tolist()))
            else:
                wanted = map(tuple, map(by_columns, call.results))
            for row in wanted:
                is_computed = all(g.operation(i) is not None or g.call_of(i) is not None for i in row)
                if is_computed and len({*row}) == len(row) and taken.isdisjoint(row):
                    rows.setdefault(min(place[i] for i in row), []).append(row)
                    taken.update(row)
        return rows

    def row(self, nodes: Sequence[int]) -> int | None:
        """The place of the first node of a row of a matrix; None where the others do not follow it."""
        slots = [self.slots.get(i, -1) for i in nodes]
        return slots[0] if slots[0] >= 0 and slots == list(range(slots[0], slots[0] + len(slots))) else None

    def entries(self, block: ResultBlock) -> list[int]:
        """The nodes of a block."""
        return self._blocks[block]

    def further(self, number: int) -> int:
        """The place of a value of one piece alone, beyond those of values that pass from piece to piece."""
        self._further = max(self._further, number + 1)
        return self._size + number

    def bytes(self, lanes: int) -> int:
        return 8 * lanes * (self._size + self._further)

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


def _steps(nodes: Sequence[int], complete: Mapping[int, list[ResultBlock]]) -> list[PieceStep]:
    """The nodes of a piece, divided where blocks are complete."""
    steps = [PieceStep([], [])]
    for i in nodes:
        steps[-1].nodes.append(i)
        if i in complete:
            steps[-1].complete.extend(complete[i])
            steps.append(PieceStep([], []))
    return steps


class PieceValues(dict[int, str]):
    """The values of nodes in one piece.

    Values of earlier pieces are loaded where they are needed. Of more than there are registers, the one whose next use
    is farthest goes to memory, and is loaded for that use: no other choice needs fewer loads (L. Belady 1966).

    Args:
        steps: those of the piece.
        most: values that are held at a time; None: all are, in a piece that is computed in another order.
    """

    def __init__(self, code: Code, scratch: Scratch, steps: Sequence[PieceStep], most: int | None) -> None:
        super().__init__()
        self._code, self._scratch, self._graph, self._most = code, scratch, scratch.graph, most
        reads: list[Sequence[int]] = []
        for nodes, complete in steps:
            reads += map(self._graph.arguments, nodes)
            reads += map(scratch.entries, complete)
        #: By node, when it is read, the next time at the end.
        self._uses: dict[int, list[int]] = {}
        for time in range(len(reads) - 1, -1, -1):
            for i in set(reads[time]):
                self._uses.setdefault(i, []).append(time)
        #: Values that are held, and when they are read next.
        self._held: dict[int, int] = {}
        #: Places of values of this piece alone, and those that are free again.
        self._local: dict[int, int] = {}
        self._free: list[int] = []
        self._addresses: dict[int, str] = {}

    def __missing__(self, node: int) -> str:
        kind, address = self._at(node)
        value = self._code.emit(f"load {kind}, ptr {address}, align 8")
        super().__setitem__(node, value)
        self._hold(node)
        return value

    def __setitem__(self, node: int, value: str) -> None:
        super().__setitem__(node, value)
        if self._graph.operation(node) is not None or kernel_of(self._graph.call_of(node)) is not None:
            if node in self._scratch.slots:
                self._store(node)
            self.used(self._graph.arguments(node))
            self._hold(node)

    def used(self, nodes: Sequence[int]) -> None:
        """Nodes were read; the values that are not read again are forgotten."""
        if self._most is not None:
            for i in set(nodes):
                self._uses[i].pop()
                if self._held.pop(i, None) is not None:
                    self._hold(i)

    def _hold(self, node: int) -> None:
        if self._most is None:
            return
        if not self._uses.get(node):
            del self[node]
            if node in self._local:
                self._free.append(self._local.pop(node))
            return
        self._held[node] = self._uses[node][-1]
        if len(self._held) > self._most:
            farthest = max(self._held, key=self._held.__getitem__)
            del self._held[farthest]
            if farthest not in self._scratch.slots and farthest not in self._local:
                self._local[farthest] = self._free.pop() if self._free else self._scratch.further(len(self._local))
                self._store(farthest)
            del self[farthest]

    def _store(self, node: int) -> None:
        kind, address = self._at(node)
        self._code.lines.append(f"store {kind} {self[node]}, ptr {address}, align 8")

    def _at(self, node: int) -> tuple[str, str]:
        """The type of a node's vector, and its address."""
        slot = self._local[node] if node in self._local else self._scratch.slots[node]
        if slot not in self._addresses:
            offset = 8 * self._code.lanes * slot
            self._addresses[slot] = self._code.emit(f"getelementptr i8, ptr %scratch, i64 {offset}")
        return self._code.vector(NAMES[self._graph.dtypes[node]]), self._addresses[slot]
