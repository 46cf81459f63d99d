"""Operations entry by entry: those on arrays of one shape that follow one another are one loop."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...scalar.arithmetic import ELEMENTWISE
from ...scalar.entry import Entry
from ...scalar.graph import Graph
from ...scalar.program import Reader, ScalarProgram
from ...scalar.table import OPERATIONS
from ..code import Code, NotNative
from ..tile import Scalars, by_numpy, native_form
from .memory import View, known
from .sweep import ArrayCode

#: The primitives.
NAMES = {*OPERATIONS, *(entry.name for entry in ELEMENTWISE)} - {"copy", "optimization_barrier"}

#: Operations after which a loop ends: there are few registers.
_MOST = 60


@dataclasses.dataclass(eq=False)
class Pending:
    """An array that is computed when it is needed, in one loop with others."""

    group: Group
    node: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    view: View | None = None


class Group:
    """Operations on arrays of one shape, as a program of one entry."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.shape = shape
        self.graph = Graph(dtype, checked=True)
        self._reader = Reader(self.graph, whole=False)
        self.inputs: list[View] = []
        self._numbers: dict[Any, int] = {}
        self._pending: list[weakref.ref[Pending]] = []
        self.operations = 0
        self.done = False

    def add(self, entry: Entry, eqn: Any, arguments: Sequence[View | Pending]) -> list[Pending]:
        """The results of an equation, to be computed with the others."""
        nodes = [np.asarray(self._node(own)) for own in arguments]
        found = entry.scalars(self._reader, eqn, *nodes)
        if found is None or self.graph.calls:
            raise NotNative(f"{eqn.primitive.name} has no native form")
        self.operations += 1
        results = []
        for node, variable in zip(found, eqn.outvars, strict=True):
            results.append(Pending(self, int(node), self.shape, np.dtype(variable.aval.dtype)))
            self._pending.append(weakref.ref(results[-1]))
        return results

    def _node(self, own: View | Pending) -> int:
        if isinstance(own, Pending):
            return own.node
        if own.number is not None:
            return self.graph.constant(own.number, own.dtype)
        array = own.array
        key = (own.base, own.offset if not own.known else id(array), array.strides, array.shape, own.dtype)
        if key not in self._numbers:
            self._numbers[key] = len(self.inputs)
            self.inputs.append(own)
        return self.graph.input(self._numbers[key], 0, own.dtype)

    def compute(self, own: ArrayCode) -> None:
        """Add the loop; what somebody still needs is written."""
        self.done = True
        needed = [pending for ref in self._pending if (pending := ref()) is not None]
        if not needed:
            return
        program = self._program([pending.node for pending in needed])
        if all(view.known for view in self.inputs):
            for pending, view in zip(needed, self._numbered(program), strict=True):
                pending.view = view
            return
        form = native_form(program)
        distinct = list(dict.fromkeys(pending.node for pending in needed))
        whole = [v.array for v in self.inputs if v.array.size > 1 and all(v.array.strides)]
        like = whole[0] if whole and whole[0].shape == self.shape else None
        own_nodes = {pending.node: nodes for pending, nodes in zip(needed, form.outputs, strict=True)}
        targets = [own.new(self.shape, self.graph.dtypes[node], like) for node in distinct]

        def body(code: Code, read: Sequence[Any]) -> list[str]:
            scalars = Scalars(code, form, lambda argument, _: str(read[argument]()))
            return scalars.compute([int(own_nodes[node]) for node in distinct])

        sources = [View(v.base, v.origin, np.broadcast_to(v.array, self.shape), v.place) for v in self.inputs]
        own.each(sources, targets, body)
        views = dict(zip(distinct, targets, strict=True))
        for pending in needed:
            pending.view = views[pending.node]

    def _program(self, nodes: Sequence[int]) -> ScalarProgram:
        g = self.graph
        inputs = [np.asarray(g.input(k, 0, view.dtype)) for k, view in enumerate(self.inputs)]
        return ScalarProgram(g, tuple(inputs), tuple(map(np.asarray, nodes)), tuple(g.dtypes[i] for i in nodes))

    def _numbered(self, program: ScalarProgram) -> list[View]:
        """By NumPy, where all numbers are known."""
        count = int(np.prod(self.shape))
        rows = [np.broadcast_to(view.array, self.shape).reshape(count, 1) for view in self.inputs]
        if not rows:  # numbers alone: one entry is all of them
            found = by_numpy(program, [])
            return [known(np.broadcast_to(own.reshape(()), self.shape)) for own in found]
        return [known(own.reshape(self.shape)) for own in by_numpy(program, rows)]


class Groups:
    """The loops that are yet to be added; at most one for each shape and precision."""

    def __init__(self, own: ArrayCode) -> None:
        self._own = own
        self._open: dict[tuple[tuple[int, ...], np.dtype[Any]], Group] = {}

    def add(self, entry: Entry, eqn: Any, arguments: Sequence[View | Pending]) -> list[Pending]:
        key = tuple(eqn.outvars[0].aval.shape), _precision(eqn)
        group = self._open.get(key)
        if group is None or group.operations >= _MOST:
            self.compute_one(group)
            group = self._open[key] = Group(*key)
        return group.add(entry, eqn, [self._ready(own, group) for own in arguments])

    def view(self, value: View | Pending) -> View:
        """In memory, or known."""
        if isinstance(value, View):
            return value
        self.compute_one(value.group)
        if value.view is None:
            raise RuntimeError("an array is needed that was dropped")
        return value.view

    def compute(self) -> None:
        """All of them."""
        for group in list(self._open.values()):
            self.compute_one(group)

    def compute_one(self, group: Group | None) -> None:
        if group is not None and not group.done:
            key = group.shape, group.graph.dtype
            if self._open.get(key) is group:
                del self._open[key]
            group.compute(self._own)

    def _ready(self, own: View | Pending, group: Group) -> View | Pending:
        return own if isinstance(own, Pending) and own.group is group and not group.done else self.view(own)


def _precision(eqn: Any) -> np.dtype[Any]:
    """The floating-point type of a loop."""
    types = (np.dtype(v.aval.dtype) for v in (*eqn.invars, *eqn.outvars))
    return next((t for t in types if t.kind == "f"), np.dtype(np.float64))
