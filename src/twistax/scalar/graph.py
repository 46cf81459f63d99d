"""A graph of scalars, in which equal nodes are merged, and operations with zeros and ones are removed.

A node is a number, the index of its entry in a list; an array is a NumPy array of such numbers. Operands precede
results, so the list is in an order in which nodes can be computed.
"""

from __future__ import annotations

import dataclasses
import functools
import threading
from collections.abc import Callable, Container, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from ..jax_inside import ClosedJaxpr
from .primitives.entry import Operation
from .primitives.interface import Limits, Nodes, Repeat, flat, nodes
from .primitives.operations import OPERATIONS
from .primitives.powers import factors_in_range
from .walk import walk

_ADD, _SUB, _MUL, _DIV, _NEG, _POW, _SELECT, _NOT = (
    OPERATIONS[name] for name in ("add", "sub", "mul", "div", "neg", "pow", "select", "not")
)

#: First entries of nodes that are no operations: a number, an input, a result of a call.
_CONSTANT, _INPUT, _RESULT = "constant", "input", "result"


class TooLarge(ModelError):
    """A program that is too large for scalars."""

    @classmethod
    def for_more_than(cls, largest: int) -> TooLarge:
        """The error for a program of more than so many scalars."""
        return cls(
            f"the function takes more than {largest} scalars, too many to unroll.\n"
            "  fix: compile with backend=tx.JAX(), and differentiate it with jax.jacfwd"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class OpaqueCall:
    """A function that the graph treats as opaque, with its arguments.

    Attributes:
        jaxpr: the function, arrays to arrays.
        key: equal for equal functions.
        arguments: arrays of nodes.
        results: the arrays of nodes that it gives.
        inline: whether emitters may write the function out: it is a call only for its own derivative.
    """

    jaxpr: ClosedJaxpr
    key: Any
    arguments: tuple[Nodes, ...]
    results: tuple[Nodes, ...]
    inline: bool

    @functools.cached_property
    def sources(self) -> list[int]:
        """The nodes of all arguments."""
        return flat(*self.arguments)

    @functools.cached_property
    def first(self) -> list[int]:
        """The node of the first entry of its results, in a list."""
        return flat(*self.results)[:1]


LIMITS = Limits()


class ScalarGraph:
    """A graph of scalars that is being built.

    Args:
        dtype: the floating-point type of the program.
        checked: keep what depends on all numbers being finite: 0 x, 0 / x and x - x stay as they are, and so does every
            division. By default they are zero, also where x is infinite or NaN.
        largest: refuse to grow beyond this many nodes.
        limits: up to which size parts are unrolled that a library does as well.
        signed_zeros: -x - y and 0 - x keep the sign of a zero, for what depends on it. That of x - y is always kept,
            those of sums with zeros and of products with zeros never.
    """

    def __init__(
        self,
        dtype: Any,
        checked: bool = False,
        largest: int = 200_000,
        limits: Limits = LIMITS,
        signed_zeros: bool = False,
    ) -> None:
        self.dtype: np.dtype[Any] = np.dtype(dtype)
        self.checked = checked
        self.largest = largest
        self.limits = limits
        self.signed_zeros = signed_zeros
        #: Whether derivatives are being added, in which the sign of a zero has no effect.
        self.differentiating = False
        #: The lock of threads that add derivatives.
        self.lock = threading.RLock()
        self.nodes: list[tuple[Any, ...]] = []
        self.dtypes: list[np.dtype[Any]] = []
        #: The number where a node is one, else None.
        self.numbers: list[Any] = []
        self.calls, self.repeats = list[OpaqueCall](), list[Repeat]()
        #: Operations in calls that emitters may write out; they count as nodes.
        self.inside = 0
        #: The operation of a node; None for numbers, inputs and results of calls. And the nodes that it reads.
        self._operations: list[Operation | None] = []
        self._arguments: list[tuple[int, ...]] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self._called: dict[Any, OpaqueCall] = {}
        #: Whether an operation is a power: products with one may take other factors.
        self._has_powers = False
        self.zero: int = self.constant(0.0)
        self.one: int = self.constant(1.0)

    # ---- making nodes --------------------------------------------------------------------------------------------

    def constant(self, value: Any, dtype: np.dtype[Any] | None = None) -> int:
        """The node of a number, of the program's type if none is given."""
        dtype = self.dtype if dtype is None else dtype
        value = dtype.type(value).item() if dtype == self.dtype else np.asarray(value, dtype).item()
        if dtype == self.dtype:
            value += 0.0  # one zero
        return self._intern((_CONSTANT, dtype, value), dtype, value)

    def input(self, argument: int, place: int, dtype: np.dtype[Any]) -> int:
        """The node of one entry of an argument."""
        return self._intern((_INPUT, argument, place, dtype), dtype)

    def array(self, values: Any) -> Nodes:
        """The nodes of an array of numbers."""
        values = np.asarray(values)
        dtype = values.dtype
        return nodes([self.constant(value, dtype) for value in values.reshape(-1)], values.shape)

    def call(self, jaxpr: ClosedJaxpr, key: Any, arguments: Iterable[Nodes], inline: bool) -> OpaqueCall:
        """A call of a function, once for each set of arguments."""
        arguments = tuple(arguments)
        called = (key, *(a.tobytes() for a in arguments), *(a.shape for a in arguments))
        if called not in self._called:
            number, results = len(self.calls), []
            for k, aval in enumerate(v.aval for v in jaxpr.jaxpr.outvars):
                dtype = np.dtype(aval.dtype)
                entries = [self._intern((_RESULT, number, k, place), dtype) for place in range(aval.size)]
                results.append(nodes(entries, aval.shape))
            self._called[called] = OpaqueCall(jaxpr, key, arguments, tuple(results), inline)
            self.calls.append(self._called[called])
        return self._called[called]

    def node(self, operation: Operation, *arguments: int) -> int:
        """The node of an operation, folded where all arguments are numbers."""
        dtype = operation.result or self.dtypes[arguments[-1]]
        # An operation on numbers is rare: they come last where there are any.
        if self.numbers[arguments[-1]] is not None and None not in (numbers := [self.numbers[a] for a in arguments]):
            # The same few numbers are combined many times.
            known = self._known.get((operation, *arguments))
            if known is None:
                # As the emitter would: in the types of the arguments.
                with np.errstate(all="ignore"):
                    typed = [self.dtypes[a].type(n) for a, n in zip(arguments, numbers, strict=True)]
                    known = self.constant(operation.number(*typed), dtype)
                self._known[operation, *arguments] = known
            return known
        if operation.parity and self.nodes[arguments[0]][0] is _NEG and dtype.kind != "u":
            inner = self.node(operation, self.nodes[arguments[0]][1])
            return inner if operation.parity > 0 else self.neg(inner)
        return self.copied(operation, arguments, dtype)

    def copied(self, operation: Operation, arguments: Sequence[int], dtype: np.dtype[Any]) -> int:
        """The node of an operation in which there is nothing to simplify, such as one of another graph."""
        if operation.symmetric and arguments[0] > arguments[1]:
            arguments = arguments[::-1]
        self._has_powers = self._has_powers or operation.is_power
        return self._intern((operation, *arguments), dtype)

    # ---- arithmetic ----------------------------------------------------------------------------------------------

    def add(self, a: int, b: int) -> int:
        if a == self.zero:
            return b
        if b == self.zero:
            return a
        first, second = self.nodes[a], self.nodes[b]
        if second[0] is _NEG:
            return self.sub(a, second[1])
        if first[0] is _NEG:
            return self.sub(b, first[1])
        return self.node(_ADD, a, b)

    def sub(self, a: int, b: int) -> int:
        if b == self.zero:
            return a
        unsigned = self.differentiating or not self.signed_zeros
        if a == self.zero and unsigned:
            return self.neg(b)
        if a == b and not self.checked and self.dtypes[a] == self.dtype and self.numbers[a] is None:
            return self.zero
        first, second = self.nodes[a], self.nodes[b]
        if second[0] is _NEG:
            return self.add(a, second[1])
        if first[0] is _NEG and unsigned:
            return self.neg(self.add(first[1], b))
        if self.differentiating and self.numbers[b] is None and (_SUB, b, a) in self._known:
            return self.neg(self._known[_SUB, b, a])
        return self.node(_SUB, a, b)

    def neg(self, a: int) -> int:
        entry = self.nodes[a]
        if entry[0] is _NEG:
            return int(entry[1])
        return self.node(_NEG, a)

    def mul(self, a: int, b: int) -> int:
        if self.numbers[a] is not None:
            a, b = b, a
        factor = self.numbers[b]
        if factor is not None and self.numbers[a] is None and self.dtypes[b] == self.dtype:
            if factor == 0.0 and not self.checked:
                return self.zero
            if factor == 1.0:
                return a
            if factor < 0.0:
                # One sign for a number and its opposite, so that both products are one node.
                return self.neg(self.mul(a, self.constant(-factor)))
        for x, y in ((a, b), (b, a)) if self._has_powers else ():
            if self.numbers[x] is None and (parts := factors_in_range(self, x, y)) is not None:
                return self.mul(*parts)
        return self._signed(self.mul, _MUL, a, b)

    def div(self, a: int, b: int) -> int:
        if self.dtypes[a] != self.dtype:
            return self.node(_DIV, a, b)
        divisor = self.numbers[b]
        if divisor == 1.0:
            return a
        if a == self.zero and divisor is None and not self.checked:
            return self.zero
        if divisor and np.isfinite(divisor) and self.numbers[a] is None and not self.checked:
            inverse = float(1.0 / divisor)
            # Exact for powers of two, else to one rounding; not where the inverse leaves the range of numbers.
            if np.isfinite(self.dtype.type(inverse)) and abs(inverse) > np.finfo(self.dtype).tiny:
                return self.mul(a, self.constant(inverse))
        if a == self.one and self.nodes[b][0] is _POW and self.numbers[self.nodes[b][2]] is not None:
            return self.node(_POW, self.nodes[b][1], self.neg(self.nodes[b][2]))
        return self._signed(self.div, _DIV, a, b)

    def over(self, a: int, factor: int) -> int:
        """factor a; a / b where the factor is 1 / b.

        Its derivative stays in range where that of 1 / b does not. Emitters share 1 / b.
        """
        divisor = self.reciprocal_of(factor)
        return self.mul(factor, a) if divisor is None else self.div(a, divisor)

    def _signed(self, make: Callable[[int, int], int], operation: Operation, a: int, b: int) -> int:
        """A product or a quotient, with its sign moved to the front."""
        first, second = self.nodes[a], self.nodes[b]
        if first[0] is _NEG:
            return self.neg(make(first[1], b))
        return self.neg(make(a, second[1])) if second[0] is _NEG else self.node(operation, a, b)

    def select(self, c: int, a: int, b: int) -> int:
        """a where c, else b."""
        if a == b:
            return a
        choice = self.numbers[c]
        if choice is not None:
            return a if choice else b
        if self.nodes[c][0] is _NOT:
            return self.select(self.nodes[c][1], b, a)
        return self.node(_SELECT, c, a, b)

    def scaled(self, factor: int, cotangent: int) -> int:
        """factor cotangent; zero where an untaken branch makes the cotangent zero, whatever the factor is."""
        entry = self.nodes[cotangent]
        if entry[0] is _NEG:
            return self.neg(self.scaled(factor, entry[1]))
        if entry[0] is _SELECT and self.zero in entry[2:]:
            c, a, b = entry[1:]
            return self.select(
                c,
                self.zero if a == self.zero else self.scaled(factor, a),
                self.zero if b == self.zero else self.scaled(factor, b),
            )
        return self.mul(factor, cotangent)

    def may_be_cut(self, cotangent: int) -> bool:
        """Whether an untaken branch makes a cotangent zero."""
        entry = self.nodes[cotangent]
        return entry[0] is _SELECT and self.zero in entry[2:]

    def joined(self, a: int, b: int) -> int:
        """a + b of two cotangents, under one select if the same branch makes both zero."""
        first, second = self.nodes[a], self.nodes[b]
        if first[0] is _SELECT and second[0] is _SELECT and first[1] == second[1]:
            for k in (2, 3):
                if first[k] == second[k] == self.zero:
                    rest = self.joined(first[5 - k], second[5 - k])
                    return self.select(first[1], *((self.zero, rest) if k == 2 else (rest, self.zero)))
        return self.add(a, b)

    # ---- reading nodes -------------------------------------------------------------------------------------------

    def arguments(self, node: int) -> tuple[int, ...]:
        """The nodes that an operation reads; none for numbers, inputs and results of calls."""
        return self._arguments[node]

    def sources(self, node: int) -> Sequence[int]:
        """The nodes that a node is computed from; those of a call for its first result, and this for the others."""
        call = self.call_of(node)
        return self._arguments[node] if call is None else call.sources if call.first == [node] else call.first

    def simplifies_as(self, other: ScalarGraph) -> bool:
        """Whether operations of this graph stay as they are in another one, on the same arguments.

        Products with powers may take other factors there.
        """
        same = (self.checked, self.signed_zeros) == (other.checked, other.signed_zeros)
        return same and not self._has_powers

    def call_of(self, node: int) -> OpaqueCall | None:
        """The call whose result a node is."""
        entry = self.nodes[node]
        return self.calls[entry[1]] if entry[0] is _RESULT else None

    def known(self, operation: Operation, *arguments: int) -> int | None:
        """The node of an operation on nodes if the graph has it, else None."""
        return self._known.get((operation, *arguments))

    def input_of(self, node: int) -> tuple[int, int] | None:
        """The argument and the place in it that a node is."""
        entry = self.nodes[node]
        return (entry[1], entry[2]) if entry[0] is _INPUT else None

    def reciprocal_of(self, node: int) -> int | None:
        """b of a node 1 / b; x^n of a node x^-n if the graph has it; else None."""
        entry = self.nodes[node]
        if entry[0] is _POW and (n := self.numbers[entry[2]]) is not None and n < 0.0:
            return self.known(_POW, entry[1], self.constant(-n))
        return int(entry[2]) if entry[0] is _DIV and entry[1] == self.one else None

    def operation(self, node: int) -> Operation | None:
        return self._operations[node]

    def values(self, array: Nodes) -> NDArray[Any] | None:
        """The numbers of an array of nodes; None unless all are numbers."""
        numbers = [self.numbers[i] for i in flat(array)]
        if any(n is None for n in numbers):
            return None
        return np.array(numbers, self.dtype_of(array)).reshape(array.shape)

    def dtype_of(self, array: Nodes) -> np.dtype[Any]:
        """The type of an array of nodes, that of the program where it is empty."""
        return self.dtypes[int(array.reshape(-1)[0])] if array.size else self.dtype

    def live(self, outputs: Iterable[int], known: Container[int] = ()) -> list[int]:
        """All nodes that the outputs need and that are not known, in an order in which they can be computed."""
        live, waiting = set[int](), [*map(int, outputs)]
        while waiting:
            node = waiting.pop()
            if node not in live and node not in known:
                live.add(node)
                waiting.extend(self.sources(node))
        return sorted(live)

    def one_by_one(self, outputs: Sequence[int]) -> list[int]:
        """The live nodes output by output, each output with the nodes that only it and later ones need: few values are
        live at a time.

        Of several arguments the one that takes most numbers at a time comes first (R. Sethi and J. Ullman 1970).
        """
        most: dict[int, int] = {}
        for node in self.live(outputs):
            counts = sorted((most[a] for a in self.sources(node)), reverse=True)
            most[node] = max((number + k for k, number in enumerate(counts)), default=1)
        return list(walk(outputs, lambda node: sorted(self.sources(node), key=lambda a: -most[a]), int))

    def _intern(self, key: tuple[Any, ...], dtype: np.dtype[Any], number: Any = None) -> int:
        node = self._known.get(key)
        if node is None:
            node = len(self.nodes)
            if node + self.inside >= self.largest:
                raise TooLarge.for_more_than(self.largest)
            self._known[key] = node
            self.nodes.append(key)
            self.dtypes.append(dtype)
            self.numbers.append(number)
            operation = key[0] if isinstance(key[0], Operation) else None
            self._operations.append(operation)
            self._arguments.append(key[1:] if operation else ())
        return node
