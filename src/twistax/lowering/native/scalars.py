"""The scalars of a program as instructions, each worked out once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..scalar.program import ScalarProgram
from .code import NAMES, Code
from .operations import TURNING, instructions
from .trigonometry import sines_and_cosines

__all__ = ["Scalars"]


class Scalars:
    """The values of a program's nodes in one function.

    Args:
        code: where instructions go.
        form: from `native_form`.
        read: the value of an entry of an argument.
    """

    def __init__(self, code: Code, form: ScalarProgram, read: Callable[[int, int], str]) -> None:
        self._code = code
        self._form = form
        self._read = read
        self._values: dict[int, str] = {}
        self._turned: dict[int, tuple[str, ...]] = {}

    def work_out(self, nodes: Sequence[int]) -> list[str]:
        """The values of nodes; sines and cosines that do not wait for one another together."""
        live = self._form.graph.live(list(nodes))
        for angles in self._angles(live):
            self._in_turn(self._form.graph.live(angles))
            found = sines_and_cosines(self._code, NAMES[self._form.graph.dtype], [self._values[i] for i in angles])
            self._turned.update(zip(angles, found, strict=True))
        self._in_turn(live)
        return [self._values[i] for i in nodes]

    def _in_turn(self, nodes: Sequence[int]) -> None:
        g, values = self._form.graph, self._values
        for i in nodes:
            if i in values:
                continue
            place, operation, arguments = g.input_of(i), g.operation(i), g.arguments(i)
            if place is not None:
                values[i] = self._read(*place)
            elif operation is None:
                values[i] = self._code.constant(NAMES[g.dtypes[i]], g.numbers[i])
            elif operation in TURNING:
                values[i] = self._turned[arguments[0]][TURNING.index(operation)]
            else:
                kinds = [NAMES[g.dtypes[a]] for a in arguments]
                values[i] = instructions(self._code, operation, kinds, [values[a] for a in arguments])

    def _angles(self, live: Sequence[int]) -> list[list[int]]:
        """The angles of sines and cosines to come: first those that depend on no other of them, and so on."""
        g = self._form.graph
        depth: dict[int, int] = {}
        found: dict[int, list[int]] = {}
        for i in live:
            if i in self._values:
                continue
            arguments = g.arguments(i)
            depth[i] = max((depth.get(a, 0) for a in arguments), default=0)
            if g.operation(i) in TURNING and arguments[0] not in self._turned:
                angles = found.setdefault(depth[i], [])
                if arguments[0] not in angles:
                    angles.append(arguments[0])
                depth[i] += 1
        return [found[k] for k in sorted(found)]
