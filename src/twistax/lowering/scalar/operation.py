"""An operation on scalars: all that is said of it, in one object."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from .entry import Entry, Nodes, each, small_inside

if TYPE_CHECKING:
    from .graph import Graph
    from .reader import Reader

__all__ = ["Extreme", "Forms", "Operation", "Select", "everywhere"]

#: Nodes of the derivatives of an operation with respect to its arguments; None where one is zero everywhere.
Partials: TypeAlias = "Callable[[Graph, tuple[int, ...], int], Sequence[int | None]]"


@dataclasses.dataclass(frozen=True)
class Forms:
    """How an operation is written in another language, by the type of its last argument; None: it is not.

    A form takes what the language needs to know, then the arguments: of C a `CType`; of LLVM the `Code` and the name of
    the type; of CasADi the module.
    """

    real: Callable[..., Any] | None = None
    integer: Callable[..., Any] | None = None
    boolean: Callable[..., Any] | None = None

    def of(self, dtype: np.dtype[Any]) -> Callable[..., Any] | None:
        """The form on arguments of a type."""
        return {"f": self.real, "i": self.integer, "u": self.integer, "b": self.boolean}.get(dtype.kind)


def everywhere(form: Callable[..., Any]) -> Forms:
    """The same form on all types."""
    return Forms(form, form, form)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Operation(Entry):
    """An operation on scalars. Compared and hashed by identity.

    Attributes:
        name: how counts and pictures call it; that of the JAX primitive where there is one.
        number: the operation on NumPy scalars or arrays.
        array: the operation on JAX arrays of one shape.
        arity: how many arguments it takes.
        partials: the derivatives, those at kinks as JAX has them; None where they are zero or not defined.
        result: the type of the result, None: that of the arguments.
        symmetric: whether arguments may be swapped.
        parity: -1 for odd functions, 1 for even ones, 0 for others.
        maker: graph -> what makes its node, with what is known left out, as sums do of zeros; None: as of all others.
        llvm, c, casadi: how it is written in these languages.
    """

    number: Callable[..., Any]
    array: Callable[..., jax.Array]
    arity: int = 1
    partials: Partials | None = None
    result: np.dtype[Any] | None = None
    symmetric: bool = False
    parity: int = 0
    maker: Callable[[Graph], Callable[..., int]] | None = None
    inside: Callable[[Any], bool] = small_inside
    llvm: Forms = Forms()
    c: Forms = Forms()
    casadi: Forms = Forms()

    def scalars(self, reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
        if self.read is not None:
            return self.read(reader, eqn, *arrays)
        return [each(self.on(reader.graph), *arrays)]

    def sample(self) -> tuple[Any, ...]:
        return self.example or (self.array, *[np.array([0.5, 0.25])] * self.arity)

    def on(self, g: Graph) -> Callable[..., int]:
        """What makes its node from those of the arguments."""
        return functools.partial(g.node, self) if self.maker is None else self.maker(g)

    def tangents(
        self, g: Graph, arguments: tuple[int, ...], node: int, along: Sequence[Sequence[int | None]]
    ) -> list[int | None]:
        """sum_i (partial_i) t_i for each set of tangents t; None stands for zero."""
        if self.partials is None:
            return [None] * len(along)
        partials, found = self.partials(g, arguments, node), []
        for tangents in along:
            total: int | None = None
            for partial, tangent in zip(partials, tangents, strict=True):
                if partial is not None and tangent is not None:
                    term = g.mul(partial, tangent)
                    total = term if total is None else g.add(total, term)
            found.append(total)
        return found

    def cotangents(self, g: Graph, arguments: tuple[int, ...], node: int, cotangent: int) -> Sequence[int | None]:
        """What the cotangent of the result gives to each argument."""
        if self.partials is None:
            return [None] * len(arguments)
        found = self.partials(g, arguments, node)
        return [None if partial is None else g.scaled(partial, cotangent) for partial in found]


class Select(Operation):
    """Select(c, a, b): a where c, else b. Derivatives are selected too: nothing of the other branch is multiplied."""

    def tangents(
        self, g: Graph, arguments: tuple[int, ...], node: int, along: Sequence[Sequence[int | None]]
    ) -> list[int | None]:
        zero = g.constant(0.0, g.dtypes[node])
        return [
            None
            if a is None and b is None
            else g.select(arguments[0], zero if a is None else a, zero if b is None else b)
            for _, a, b in along
        ]

    def cotangents(self, g: Graph, arguments: tuple[int, ...], node: int, cotangent: int) -> Sequence[int | None]:
        c, zero = arguments[0], g.constant(0.0, g.dtypes[node])
        return [None, g.select(c, cotangent, zero), g.select(c, zero, cotangent)]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Convert(Operation):
    """The conversion to another type. Linear between floating-point types, else of no derivative.

    Attributes:
        of: the conversion to a type; the derivative's transpose is one too.
    """

    of: Callable[[np.dtype[Any]], Operation]

    def tangents(
        self, g: Graph, arguments: tuple[int, ...], node: int, along: Sequence[Sequence[int | None]]
    ) -> list[int | None]:
        if not self._linear(g, arguments):
            return [None] * len(along)
        return [None if t is None else g.node(self, t) for (t,) in along]

    def cotangents(self, g: Graph, arguments: tuple[int, ...], node: int, cotangent: int) -> Sequence[int | None]:
        return [g.node(self.of(g.dtypes[arguments[0]]), cotangent) if self._linear(g, arguments) else None]

    def _linear(self, g: Graph, arguments: tuple[int, ...]) -> bool:
        return all(d is not None and jnp.issubdtype(d, jnp.inexact) for d in (self.result, g.dtypes[arguments[0]]))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Extreme(Operation):
    """The largest or the smallest of many.

    Attributes:
        pair: that of two; emitters write one after the other.
    """

    pair: Operation
