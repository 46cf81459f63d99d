"""A scalar program: which nodes of a graph are its inputs and outputs."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from ...jax_inside import ClosedJaxpr
from .entry import Nodes
from .graph import LIMITS, Call, Graph, Limits
from .reader import Reader, trace

__all__ = ["ScalarProgram", "scalarize"]


@dataclasses.dataclass(frozen=True, eq=False)
class ScalarProgram:
    """A function of arrays as scalars. Compared and hashed by identity.

    Attributes:
        graph: the scalars.
        inputs: the arrays of nodes that are the arguments.
        outputs: the arrays of nodes that are the results.
        types: the types of the results.
    """

    graph: Graph
    inputs: tuple[Nodes, ...]
    outputs: tuple[Nodes, ...]
    types: tuple[np.dtype[Any], ...]

    @functools.cached_property
    def flat(self) -> list[int]:
        """The nodes of all results, one after the other."""
        return [int(i) for a in self.outputs for i in a.reshape(-1)]

    @functools.cached_property
    def live(self) -> list[int]:
        """The nodes that are needed, arguments first."""
        return self.graph.live(self.flat)

    @functools.cached_property
    def calls(self) -> list[Call]:
        """The calls that are needed."""
        return list({id(c): c for i in self.live if (c := self.graph.call_of(i)) is not None}.values())

    def counts(self) -> dict[str, int]:
        """Operations by name; a function with a derivative of its own counts as one."""
        operations = (self.graph.operation(i) for i in self.live)
        found = Counter(operation.name for operation in operations if operation is not None)
        if self.calls:
            found["call"] = len(self.calls)
        return dict(sorted(found.items()))

    @property
    def operations(self) -> int:
        """The number of all operations."""
        return sum(self.counts().values())

    def depending(self, arguments: Sequence[int]) -> set[int]:
        """The nodes that are needed and depend on some of the arguments, and the arguments' own."""
        found = {i for k in arguments for i in self.inputs[k].reshape(-1).tolist()}
        for i in self.live:
            if any(j in found for j in self.graph.sources(i)):
                found.add(i)
        return found

    def restricted(self, outputs: Sequence[Nodes]) -> ScalarProgram:
        """The same inputs with other outputs."""
        types = tuple(self.graph.dtypes[int(o.reshape(-1)[0])] if o.size else self.graph.dtype for o in outputs)
        return ScalarProgram(self.graph, self.inputs, tuple(outputs), types)


def scalarize(
    function: Callable[..., Any] | ClosedJaxpr,
    *shapes: Any,
    checked: bool = False,
    largest: int = 200_000,
    limits: Limits = LIMITS,
) -> ScalarProgram:
    """A function of arrays, results a list of arrays, as a scalar program.

    Args:
        function: traceable; or its jaxpr.
        shapes: of the arguments, with types; left out for a jaxpr.
        checked: keep 0 x, 0 / x and x - x, which differ from zero where x is not finite.
        largest: the most scalars there may be.
        limits: up to which size parts are unrolled.
    Raises:
        TooLarge: more scalars than are good for a compiler.
    """
    closed = function if isinstance(function, ClosedJaxpr) else trace(function, *shapes)
    avals = [v.aval for v in closed.jaxpr.invars]
    dtype = _precision([*avals, *(v.aval for v in closed.jaxpr.outvars)])
    graph = Graph(dtype, checked, largest, limits)
    inputs = tuple(
        np.array([graph.input(k, j, np.dtype(a.dtype)) for j in range(a.size)], np.int64).reshape(a.shape)
        for k, a in enumerate(avals)
    )
    outputs = Reader(graph).read(closed, inputs)
    return ScalarProgram(graph, inputs, tuple(outputs), tuple(np.dtype(v.aval.dtype) for v in closed.jaxpr.outvars))


def _precision(avals: Sequence[Any]) -> np.dtype[Any]:
    for aval in avals:
        if np.issubdtype(aval.dtype, np.floating):
            return np.dtype(aval.dtype)
    return np.dtype(jax.dtypes.canonicalize_dtype(float))
