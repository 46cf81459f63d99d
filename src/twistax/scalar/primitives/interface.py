"""The interfaces between the table of primitives, graphs of scalars and readers of jaxprs; and arrays of nodes."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...jax_inside import ClosedJaxpr

#: An array of nodes.
Nodes: TypeAlias = NDArray[Any]


@dataclasses.dataclass(frozen=True)
class Limits:
    """The sizes up to which library calls and loops are unrolled, because larger ones take too long to compile.

    Attributes:
        pivoted: the size of a matrix with pivoted LU. The choice of pivots takes more than the elimination.
        table: the size of a table with an index known only at run time. The index is compared with each place.
        equations: the equations of a loop, all iterations together, or of branches.
        products: the multiplications of columns of a product of matrices; as many and more are a call.
        functions: whether functions of matrices without derivatives are calls.
    """

    pivoted: int = 4
    table: int = 16
    equations: int = 4000
    products: float = math.inf
    functions: bool = True


#: The key of a call that multiplies two matrices.
PRODUCT = "product of matrices"


class Graph(Protocol):
    """The interface of `ScalarGraph`, which documents the methods."""

    dtype: np.dtype[Any]
    limits: Limits
    zero: int
    one: int
    nodes: list[tuple[Any, ...]]
    dtypes: list[np.dtype[Any]]
    numbers: list[Any]
    calls: list[Any]
    repeats: list[Any]
    inside: int

    def constant(self, value: Any, dtype: np.dtype[Any] | None = None) -> int: ...
    def call(self, jaxpr: ClosedJaxpr, key: Any, arguments: Iterable[Nodes], inline: bool) -> Any: ...
    def array(self, values: Any) -> Nodes: ...
    def node(self, operation: Any, *arguments: int) -> int: ...
    def known(self, operation: Any, *arguments: int) -> int | None: ...
    def operation(self, node: int) -> Any: ...
    def arguments(self, node: int) -> tuple[int, ...]: ...
    def values(self, array: Nodes) -> NDArray[Any] | None: ...
    def dtype_of(self, array: Nodes) -> np.dtype[Any]: ...
    def reciprocal_of(self, node: int) -> int | None: ...

    def add(self, a: int, b: int) -> int: ...
    def sub(self, a: int, b: int) -> int: ...
    def neg(self, a: int) -> int: ...
    def mul(self, a: int, b: int) -> int: ...
    def div(self, a: int, b: int) -> int: ...
    def over(self, a: int, factor: int) -> int: ...
    def select(self, c: int, a: int, b: int) -> int: ...

    def scaled(self, factor: int, cotangent: int) -> int: ...
    def joined(self, a: int, b: int) -> int: ...
    def may_be_cut(self, cotangent: int) -> bool: ...


class Reader(Protocol):
    """The interface of `JaxprReader`, which documents the methods."""

    keeps_calls: bool

    @property
    def graph(self) -> Graph: ...
    def read(self, program: ClosedJaxpr, inputs: Sequence[Nodes]) -> list[Nodes]: ...
    def inlined(self, program: Any, inputs: Sequence[Nodes]) -> list[Nodes]: ...
    def repeated(self, eqn: Any, program: Any, arguments: Sequence[Nodes]) -> list[Nodes]: ...
    def known(self, arrays: Iterable[Nodes]) -> bool: ...
    def call(
        self, eqn: Any, arrays: Sequence[Nodes], body: ClosedJaxpr | None = None, key: Any = None
    ) -> list[Nodes]: ...


class InKernels(ABC):
    """A function without derivatives that stays a call, whose key it is, and whose kernel other kernels call."""

    @property
    @abstractmethod
    def kernel(self) -> Any:
        """The kernel, made once; None if there is none."""

    @abstractmethod
    def plain(self, arguments: Sequence[Any]) -> list[Any]:
        """All results for rows of arguments, by the kernel if it exists already. None is made for it."""


@dataclasses.dataclass(frozen=True)
class RepeatedMembers:
    """The key of a call that computes a program for each row of its arguments.

    Attributes:
        program: a scalar program.
    """

    program: Any


@dataclasses.dataclass(frozen=True, eq=False)
class Repeat:
    """A program that a graph contains several times, simplified in each place.

    Attributes:
        program: a `ScalarProgram`.
        arguments, results: arrays of nodes, with one row for each time; -1 for nodes that are not needed.
    """

    program: Any
    arguments: tuple[Nodes, ...]
    results: tuple[Nodes, ...]


def kernel_of(call: Any) -> InKernels | None:
    """What writes a call in kernels; None for other calls, and for none."""
    return call.key if call is not None and isinstance(call.key, InKernels) else None


def is_loop(call: Any) -> bool:
    """Whether a call is one that kernels write as a loop or a function, and others write out."""
    return call is not None and (call.key == PRODUCT or isinstance(call.key, RepeatedMembers))


def stays_call(call: Any, limits: Limits) -> bool:
    """Whether a call stays one where functions of scalars are unrolled."""
    if kernel_of(call) is not None:
        return limits.functions
    if is_loop(call):
        return limits.products < math.inf
    # A call that was too large to unroll may fit a graph with larger limits.
    return not call.inline and limits == Limits()


def by_columns(rows: Nodes) -> list[int]:
    """The nodes of an array with one row for each time, entry by entry."""
    return flat(rows.reshape(len(rows), -1).T)


# ---- arrays of nodes -------------------------------------------------------------------------------------------------


def nodes(flat: Iterable[int], shape: Iterable[int]) -> Nodes:
    """An array of nodes."""
    return np.array(list(flat), np.int64).reshape(tuple(shape))


def flat(*arrays: Nodes) -> list[int]:
    """The nodes of arrays, concatenated."""
    return [node for array in arrays for node in array.reshape(-1).tolist()]


def each(function: Callable[..., int], *arrays: Nodes) -> Nodes:
    """A function of nodes on arrays, entry by entry."""
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    return nodes(map(function, *(flat(a if a.shape == shape else np.broadcast_to(a, shape)) for a in arrays)), shape)


def gathered(a: Nodes, axes: Collection[int]) -> tuple[list[list[int]], tuple[int, ...]]:
    """The entries over the axes, one list for each index of the other axes, and the shape of these."""
    kept = [i for i in range(a.ndim) if i not in axes]
    shape = tuple(a.shape[i] for i in kept)
    count = math.prod(a.shape[i] for i in axes)
    return a.transpose([*kept, *axes]).reshape(math.prod(shape), count).tolist(), shape
