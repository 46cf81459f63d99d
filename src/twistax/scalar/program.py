"""Scalar programs, functions of arrays as graphs of scalars; and the batch axes of arguments."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import batching
from .graph import OpaqueCall, ScalarGraph
from .primitives.interface import Nodes, RepeatedMembers, flat
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

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its real numbers."""
        return self.graph.dtype

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
        call: Callable[[OpaqueCall, dict[int, Value]], dict[int, Value]] | None = None,
    ) -> dict[int, Value]:
        """Each needed node in another language, arguments first.

        Args:
            entry: of the number of an argument and the place of an entry.
            number: of a constant and its type.
            apply: of an operation, its node, and the values of its arguments.
            call: of a call and all values before it, to the values of its results; left out for programs without calls.
        """
        g = self.graph
        values: dict[int, Value] = {}
        for i in self.live:
            if i in values:
                continue
            place, operation, called = g.input_of(i), g.operation(i), g.call_of(i)
            if place is not None:
                values[i] = entry(*place)
            elif called is not None and call is not None:
                values |= call(called, values)
            elif operation is None:
                values[i] = number(g.numbers[i], g.dtypes[i])
            else:
                values[i] = apply(operation, i, *(values[a] for a in g.arguments(i)))
        return values

    def counts(self) -> dict[str, int]:
        """Operations by name; a function with a derivative of its own counts as one."""
        operations = (self.graph.operation(i) for i in self.live)
        counts = Counter(operation.name for operation in operations if operation is not None)
        for call in self.calls:
            if isinstance(call.key, RepeatedMembers):
                inner = call.key.program.counts()
                counts.update({name: len(call.arguments[0]) * count for name, count in inner.items()})
            else:
                counts["call"] += 1
        return dict(sorted(counts.items()))

    @property
    def operations(self) -> int:
        """The number of all operations."""
        return sum(self.counts().values())

    def depending(self, arguments: Sequence[int]) -> set[int]:
        """The nodes of these arguments, and the needed nodes that depend on some of them."""
        dependent = set(flat(*(self.inputs[k] for k in arguments)))
        for i in self.live:
            if any(j in dependent for j in self.graph.sources(i)):
                dependent.add(i)
        return dependent

    @property
    def tables(self) -> list[Table]:
        """The tables that the program reads, each once."""
        operations = map(self.graph.operation, self.live)
        return list(dict.fromkeys(operation.table for operation in operations if isinstance(operation, Load)))

    def restricted(self, outputs: Sequence[Nodes]) -> ScalarProgram:
        """The same inputs with other outputs."""
        return ScalarProgram(self.graph, self.inputs, tuple(outputs), tuple(map(self.graph.dtype_of, outputs)))


def called_names(calls: Iterable[OpaqueCall]) -> str:
    """The operations of JAX that are called, for messages."""
    return ", ".join(sorted({eqn.primitive.name for call in calls for eqn in call.jaxpr.jaxpr.eqns}))


# ---- batches ---------------------------------------------------------------------------------------------------------

#: From the number of rows, and arguments (rows, *shape), or (1, *shape) where all rows share one, to results.
Rows: TypeAlias = Callable[..., list[jax.Array]]


@dataclasses.dataclass(frozen=True)
class Batch:
    """The batch axes of the arguments of an equation.

    Attributes:
        depth: the number of batch axes; they come first.
        shared: the arguments without batch axes, which all members of the batch share.
    """

    depth: int = 0
    shared: frozenset[int] = frozenset()

    def shape(self, arguments: Sequence[Any]) -> tuple[int, ...]:
        """The lengths of these axes."""
        return next((np.shape(a)[: self.depth] for k, a in enumerate(arguments) if k not in self.shared), ())

    def each(self, function: Callable[..., list[jax.Array]], arguments: Sequence[Any]) -> list[jax.Array]:
        """A function of one member, applied to all of them at once."""
        axes = [None if k in self.shared else 0 for k in range(len(arguments))]
        for _ in range(self.depth):
            function = jax.vmap(function, in_axes=axes)
        return function(*arguments)

    def rows(self, function: Rows, arguments: Sequence[Any]) -> list[jax.Array]:
        """A function of rows, with all batch axes as one."""
        shape = self.shape(arguments)
        rows = math.prod(shape)
        flat = [
            jnp.reshape(a, (1, *jnp.shape(a)) if k in self.shared else (rows, *jnp.shape(a)[self.depth :]))
            for k, a in enumerate(arguments)
        ]
        return [jnp.reshape(r, (*shape, *r.shape[1:])) for r in function(rows, *flat)]

    def batched(self, arguments: Sequence[Any], axes: Sequence[int | None]) -> tuple[Batch, list[Any]]:
        """The batch with one more axis in front, and the arguments with that axis moved there."""
        size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
        unbatched = {k for k, d in enumerate(axes) if d is None and (k in self.shared or self.depth == 0)}
        moved = [
            a if k in unbatched else batching.bdim_at_front(a, d, size)
            for k, (a, d) in enumerate(zip(arguments, axes, strict=True))
        ]
        result = Batch(self.depth + 1, frozenset(unbatched))
        # Those that only the axes from before share are no longer the same for all.
        shape = Batch(self.depth + 1, self.shared | unbatched).shape(moved)
        for k in self.shared - unbatched:
            entry = moved[k].shape[1:]
            moved[k] = jnp.broadcast_to(moved[k].reshape(size, *(1 for _ in shape[1:]), *entry), (*shape, *entry))
        return result, moved
