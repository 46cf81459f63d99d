"""The scalars of a program as instructions, each computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..scalar.in_llvm import NAMES
from ..scalar.operation import Operation
from ..scalar.program import ScalarProgram
from ..scalar.table import OPERATIONS
from .code import Code, NotNative
from .trigonometry import sines_and_cosines

__all__ = ["Scalars", "form_of"]

#: Computed several at a time, by `sines_and_cosines`.
_TURNING = (OPERATIONS["sin"], OPERATIONS["cos"])


def form_of(operation: Operation, dtype: np.dtype[Any]) -> Callable[..., str]:
    """How an operation on arguments of a type is written.

    Raises:
        NotNative: it is not.
    """
    form = operation.llvm.of(dtype)
    if form is None:
        raise NotNative(f"{operation.name} of {NAMES[dtype]} has no native form")
    return form


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

    def compute(self, nodes: Sequence[int]) -> list[str]:
        """The values of nodes; sines and cosines that do not wait for one another together."""
        live = self._form.graph.live(list(nodes))
        for angles in self._angles(live):
            self._in_order(self._form.graph.live(angles))
            found = sines_and_cosines(self._code, NAMES[self._form.graph.dtype], [self._values[i] for i in angles])
            self._code.turned.update(zip((self._values[i] for i in angles), found, strict=True))
        self._in_order(live)
        return [self._values[i] for i in nodes]

    def _in_order(self, nodes: Sequence[int]) -> None:
        g, values = self._form.graph, self._values
        for i in nodes:
            if i in values:
                continue
            place, operation, arguments = g.input_of(i), g.operation(i), g.arguments(i)
            if place is not None:
                values[i] = self._read(*place)
            elif operation is None:
                values[i] = self._code.constant(NAMES[g.dtypes[i]], g.numbers[i])
            else:
                own = g.dtypes[arguments[-1]]
                values[i] = form_of(operation, own)(self._code, NAMES[own], *(values[a] for a in arguments))

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
            if g.operation(i) in _TURNING and self._values.get(arguments[0]) not in self._code.turned:
                angles = found.setdefault(depth[i], [])
                if arguments[0] not in angles:
                    angles.append(arguments[0])
                depth[i] += 1
        return [found[k] for k in sorted(found)]
