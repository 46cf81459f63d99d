"""What an entry of the table of primitives says, and the helpers that entries share."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...jax_inside import ClosedJaxpr, inner_jaxprs, parameters

if TYPE_CHECKING:
    from .reader import Reader

__all__ = [
    "ANY",
    "DEFAULT",
    "NOTHING",
    "Entry",
    "Nodes",
    "Takes",
    "always_inside",
    "each",
    "entries",
    "gathered",
    "largest",
    "moving",
    "never_inside",
    "nodes",
    "one_of",
    "small_inside",
    "takes",
]

#: An array of nodes.
Nodes: TypeAlias = NDArray[Any]

#: read(reader, equation, *arrays of nodes) -> the arrays of the results; None: the equation stays a call of JAX.
Read: TypeAlias = "Callable[..., list[Nodes] | None]"

#: The parameters that one version of JAX gives a primitive: name -> whether a value of it is one that is read.
Takes: TypeAlias = Mapping[str, Callable[[Any], bool]]


# ---- parameters ------------------------------------------------------------------------------------------------------


def takes(**known: Callable[[Any], bool]) -> Takes:
    """The names of all parameters, each with the values of it that are read."""
    return known


def ANY(value: Any) -> bool:
    """Of a parameter that is read, or that changes no numbers."""
    return True


def DEFAULT(value: Any) -> bool:
    """Of a parameter that is read only where it is left out."""
    return value is None


def one_of(*values: Any) -> Callable[[Any], bool]:
    """Of a parameter that is read for these values."""
    return lambda value: value in values


NOTHING = takes()


# ---- inside of one small function ------------------------------------------------------------------------------------

#: Beyond this many entries XLA shares the work of an operation between threads, or compiles it in ways of its own.
_LARGEST_ARRAY = 4096


def largest(eqn: Any) -> int:
    """The number of entries of the largest array that an equation reads or makes."""
    return max((v.aval.size for v in (*eqn.invars, *eqn.outvars)), default=0)


def never_inside(eqn: Any) -> bool:
    """It calls a library."""
    return False


def small_inside(eqn: Any) -> bool:
    """Of arrays up to some thousands of entries."""
    return largest(eqn) <= _LARGEST_ARRAY


def always_inside(eqn: Any) -> bool:
    """It moves numbers, or holds others."""
    return True


# ---- the entry -------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Entry:
    """What is known of a primitive of JAX. Compared and hashed by identity.

    Attributes:
        name: of the primitive.
        takes: its parameters, one set for each form that they have in versions of JAX.
        example: a function in whose jaxpr the primitive stands, and arrays to call it with.
        read: how an equation becomes scalars; None: it stays a call of JAX.
        any_type: whether it is read in complex numbers and in other precisions than the program's too.
        inside: whether an equation compiles as part of one small function on the CPU.
        moves: whether it only moves numbers, or holds other equations: it counts as no operation.
        work: operations on scalars that an equation takes, by name; by default one for each entry of the results.
        runs: the jaxprs that an equation runs; a linear solve holds others for its derivatives.
        repeats: how often the equations in them run.
    """

    name: str
    takes: tuple[Takes, ...] = (NOTHING,)
    example: tuple[Any, ...] = ()
    read: Read | None = None
    any_type: bool = False
    inside: Callable[[Any], bool] = never_inside
    moves: bool = False
    work: Callable[[Any], Mapping[str, int]] | None = None
    runs: Callable[[Any], list[ClosedJaxpr]] = inner_jaxprs
    repeats: Callable[[Any], int] = lambda eqn: 1

    def __repr__(self) -> str:
        return self.name

    def understands(self, eqn: Any) -> bool:
        """Whether the values of an equation's parameters are ones that are read.

        Raises:
            Unread: it has other parameters than are known.
        """
        for form in self.takes:
            if form.keys() == eqn.params.keys():
                return all(reads(eqn.params[name]) for name, reads in form.items() if reads is not ANY)
        parameters(eqn, *self.takes)
        return False

    def scalars(self, reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
        """The results of an equation as nodes; None: it stays a call of JAX.

        Raises:
            Unread: a parameter has a form that is not known.
        """
        return None if self.read is None else self.read(reader, eqn, *arrays)

    def sample(self) -> tuple[Any, ...]:
        """The example."""
        return self.example

    def operations(self, eqn: Any) -> Mapping[str, int]:
        """Operations on scalars that an equation takes, those of equations in it left out."""
        if self.work is not None:
            return self.work(eqn)
        return {} if self.moves else {self.name: sum(v.aval.size for v in eqn.outvars)}


def moving(**known: Any) -> Entry:
    """The entry of what only moves numbers, or holds other equations, whatever their type and the size of arrays."""
    return Entry(**{"any_type": True, "inside": always_inside, "moves": True, **known})


def entries(*listed: Entry) -> dict[str, Entry]:
    """By the name of the primitive."""
    return {entry.name: entry for entry in listed}


# ---- arrays of nodes -------------------------------------------------------------------------------------------------


def nodes(flat: Iterable[int], shape: Iterable[int]) -> Nodes:
    """An array of nodes."""
    return np.array(list(flat), np.int64).reshape(tuple(shape))


def each(function: Callable[..., int], *arrays: Nodes) -> Nodes:
    """A function of nodes on arrays, entry by entry."""
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    flat: list[list[Any]] = [
        (a if a.shape == shape else np.broadcast_to(a, shape)).reshape(-1).tolist() for a in arrays
    ]
    return nodes(map(function, *flat), shape)


def gathered(a: Nodes, axes: Collection[int]) -> tuple[list[list[int]], tuple[int, ...]]:
    """The entries over the axes, one list for each of the rest, and the shape of the rest."""
    kept = [i for i in range(a.ndim) if i not in axes]
    shape = tuple(a.shape[i] for i in kept)
    count = math.prod(a.shape[i] for i in axes)
    return a.transpose([*kept, *axes]).reshape(math.prod(shape), count).tolist(), shape
