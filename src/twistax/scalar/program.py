"""A scalar program: a function of arrays as a graph of scalars."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from .graph import OpaqueCall, ScalarGraph
from .primitives.interface import Nodes, flat
from .primitives.table_load import Table
from .primitives.table_loads import Load

Value = TypeVar("Value")


@dataclasses.dataclass(frozen=True, eq=False)
class ScalarProgram:
    """A function of arrays as scalars. Compared and hashed by identity.

    Attributes:
        graph: the scalars.
        inputs: the arrays of nodes that are the arguments.
        outputs: the arrays of nodes that are the results.
        types: the types of the results.
    """

    graph: ScalarGraph
    inputs: tuple[Nodes, ...]
    outputs: tuple[Nodes, ...]
    types: tuple[np.dtype[Any], ...]

    @functools.cached_property
    def flat(self) -> list[int]:
        """The nodes of all results, one after the other."""
        return flat(*self.outputs)

    @functools.cached_property
    def live(self) -> list[int]:
        """The nodes that are needed, arguments first."""
        return self.graph.live(self.flat)

    @functools.cached_property
    def calls(self) -> list[OpaqueCall]:
        """The calls that are needed."""
        return list({id(c): c for i in self.live if (c := self.graph.call_of(i)) is not None}.values())

    def computed(
        self,
        entry: Callable[[int, int], Value],
        number: Callable[[Any, Any], Value],
        apply: Callable[..., Value],
    ) -> dict[int, Value]:
        """What each node that is needed is in another language, arguments first.

        Args:
            entry: of an argument, at a place.
            number: with its type.
            apply: an operation, by its node, on the values of its arguments.
        """
        g = self.graph
        values: dict[int, Value] = {}
        for i in self.live:
            place, operation = g.input_of(i), g.operation(i)
            if place is not None:
                values[i] = entry(*place)
            elif operation is None:
                values[i] = number(g.numbers[i], g.dtypes[i])
            else:
                values[i] = apply(operation, i, *(values[a] for a in g.arguments(i)))
        return values

    def counts(self) -> dict[str, int]:
        """Operations by name; a function with a derivative of its own counts as one."""
        operations = (self.graph.operation(i) for i in self.live)
        counts = Counter(operation.name for operation in operations if operation is not None)
        if self.calls:
            counts["call"] = len(self.calls)
        return dict(sorted(counts.items()))

    @property
    def operations(self) -> int:
        """The number of all operations."""
        return sum(self.counts().values())

    def depending(self, arguments: Sequence[int]) -> set[int]:
        """The nodes that are needed and depend on some of the arguments, and the arguments' own."""
        dependent = set(flat(*(self.inputs[k] for k in arguments)))
        for i in self.live:
            if any(j in dependent for j in self.graph.sources(i)):
                dependent.add(i)
        return dependent

    @property
    def tables(self) -> list[Table]:
        """The tables that are loaded from, each once."""
        operations = map(self.graph.operation, self.live)
        return list(dict.fromkeys(operation.table for operation in operations if isinstance(operation, Load)))

    def restricted(self, outputs: Sequence[Nodes]) -> ScalarProgram:
        """The same inputs with other outputs."""
        return ScalarProgram(self.graph, self.inputs, tuple(outputs), tuple(map(self.graph.dtype_of, outputs)))


def called_names(calls: Iterable[OpaqueCall]) -> str:
    """The operations of JAX that are called, for messages."""
    return ", ".join(sorted({eqn.primitive.name for call in calls for eqn in call.jaxpr.jaxpr.eqns}))
