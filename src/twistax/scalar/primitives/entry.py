"""Entries of the table of primitives, and operations on scalars."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ...jax_inside import ClosedJaxpr, inner_jaxprs, parameters
from .cotangents import Cotangent
from .interface import Graph, Nodes, Reader, each

#: read(reader, equation, *arrays of nodes) -> the arrays of the results; None: the equation stays a call of JAX.
Read: TypeAlias = "Callable[..., list[Nodes] | None]"

#: A derivative of an operation: a node, or two of which it is the product, w q. A tangent t then becomes w (q t): w q
#: itself may leave the range of numbers. None: it is zero everywhere.
Slope: TypeAlias = "int | tuple[int, int] | None"
#: Those of an operation with respect to its arguments.
Partials: TypeAlias = "Callable[[Graph, tuple[int, ...], int], Sequence[Slope]]"

#: Sets of tangents of the arguments of an operation; None stands for zero.
Tangents: TypeAlias = Sequence[Sequence[int | None]]

# ---- primitives ------------------------------------------------------------------------------------------------------


def up_to(entries: float) -> Callable[[Any], bool]:
    """A test whether all arrays that an equation reads and writes have at most this number of entries."""
    return lambda eqn: max((v.aval.size for v in (*eqn.invars, *eqn.outvars)), default=0) <= entries


#: Of primitives that call a library.
NEVER = up_to(-1)
#: XLA splits larger operations between threads, or compiles them in other ways.
SMALL = up_to(4096)
#: Of primitives that only move numbers, or contain other equations.
ALWAYS = up_to(math.inf)


def default(name: str) -> Callable[[Mapping[str, Any]], bool]:
    """A test whether a parameter has its default."""
    return lambda params: params.get(name) is None


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Entry:
    """The entry of a primitive of JAX. Compared and hashed by identity.

    Attributes:
        name: of the primitive.
        read: how an equation becomes scalars; None: it stays a call of JAX.
        takes: the names of all its parameters; "a | a b" where versions of JAX have different ones.
        when: whether the values of the parameters are ones that are read.
        any_type: whether it is read in complex numbers and in other precisions than the program's too.
        inside: whether an equation compiles as part of one small function on the CPU.
        moves: whether it only moves numbers, or holds other equations: it counts as no operation.
        work: operations on scalars that an equation takes, by name; by default one for each entry of the results.
        runs: the jaxprs that an equation runs; a linear solve holds others for its derivatives.
        repeats: how often the equations in them run.
        numpy: a function of the parameters and NumPy's arrays with XLA's results, to the last bit; None: there is none.
    """

    name: str
    read: Read | None = None
    takes: str = ""
    _: dataclasses.KW_ONLY
    when: Callable[[Mapping[str, Any]], bool] = lambda params: True
    any_type: bool = False
    inside: Callable[[Any], bool] = NEVER
    moves: bool = False
    work: Callable[[Any], Mapping[str, int]] | None = None
    runs: Callable[[Any], list[ClosedJaxpr]] = inner_jaxprs
    repeats: Callable[[Any], int] = lambda eqn: 1
    numpy: Callable[..., Any] | None = None

    def __repr__(self) -> str:
        return self.name

    def understands(self, eqn: Any) -> bool:
        """Whether the entry handles the values of an equation's parameters.

        Raises:
            Unread: it has other parameters than are known.
        """
        return self.when(parameters(eqn, *_names(self.takes)))

    def scalars(self, reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
        """The results of an equation as nodes; None if it stays a call.

        Raises:
            Unread: a parameter has a form that is not known.
        """
        return None if self.read is None else self.read(reader, eqn, *arrays)

    def operations(self, eqn: Any) -> Mapping[str, int]:
        """Operations on scalars that an equation takes, those of equations in it left out."""
        if self.work is not None:
            return self.work(eqn)
        return {} if self.moves else {self.name: sum(v.aval.size for v in eqn.outvars)}


def in_numpy(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of NumPy arrays only, for the field `numpy` of an entry."""
    return lambda params, *arrays: function(*arrays)


@functools.cache
def _names(takes: str) -> list[set[str]]:
    return [set(form.split()) for form in takes.split("|")]


#: The entry of a primitive that only moves numbers, or contains other equations, of any type and size.
moving = functools.partial(Entry, any_type=True, inside=ALWAYS, moves=True)

# ---- operations on scalars -------------------------------------------------------------------------------------------


class Forms(NamedTuple):
    """The code of an operation in another language, by the type of its last argument; None if there is none.

    In C: an expression in $a, $b, $c; $T and $R are the types of the arguments and the result, $U is an unsigned
    type to add integers in, $f the suffix of libm's names, $least and $most the ends of the result's type.
    In LLVM: a function of the `Code`, the name of the type and the values. In CasADi: of the module and expressions.
    """

    real: Any = None
    integer: Any = None
    boolean: Any = None
    unsigned: Any = None

    def of(self, dtype: np.dtype[Any]) -> Any:
        """The form on arguments of a type."""
        integers = {"i": self.integer, "u": self.unsigned or self.integer}
        return {"f": self.real, "b": self.boolean, **integers}.get(dtype.kind)


_NOWHERE = Forms()


def everywhere(form: Any) -> Forms:
    """The same code for all types."""
    return Forms(form, form, form)


def code(method: str, *first: Any) -> Any:
    """Code by a method of the LLVM writer `Code`."""
    return lambda code, kind, *values: getattr(code, method)(*first, kind, *values)


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Operation(Entry):
    """An operation on scalars; `name` is used in counts and pictures, and is that of JAX's primitive if there is one.

    Attributes:
        number: the operation on NumPy scalars or arrays.
        exact: whether that has XLA's results to the last bit.
        array: the operation on JAX arrays of one shape.
        arity: how many arguments it takes.
        partials: the derivatives, those at kinks as JAX has them; None where they are zero or not defined.
        result: the type of the result, None: that of the arguments.
        symmetric: whether arguments may be swapped.
        parity: -1 for odd functions, 1 for even ones, 0 for others.
        is_power: whether it is x^n; `factors_in_range` says how the graph multiplies by it.
        maker: graph -> what makes its node, with what is known left out, as sums do of zeros; None: as of all others.
        written: graph -> what makes the node that emitters write for it; None: they write the operation.
        llvm, c, casadi: how it is written in these languages.
    """

    number: Callable[..., Any]
    array: Callable[..., jax.Array]
    exact: bool = False
    arity: int = 1
    partials: Partials | None = None
    result: np.dtype[Any] | None = None
    symmetric: bool = False
    parity: int = 0
    is_power: bool = False
    maker: Callable[[Graph], Callable[..., int]] | None = None
    written: Callable[[Graph], Callable[..., int]] | None = None
    inside: Callable[[Any], bool] = SMALL
    llvm: Forms = _NOWHERE
    c: Forms = _NOWHERE
    casadi: Forms = _NOWHERE

    def __post_init__(self) -> None:
        if self.exact:
            object.__setattr__(self, "numpy", in_numpy(self.number))

    def scalars(self, reader: Reader, eqn: Any, *arrays: Nodes) -> list[Nodes] | None:
        return [each(self.on(reader.graph), *arrays)]

    def on(self, g: Graph) -> Callable[..., int]:
        """The function that makes its node from those of the arguments."""
        return functools.partial(g.node, self) if self.maker is None else self.maker(g)

    def tangents(self, g: Graph, arguments: tuple[int, ...], node: int, directions: Tangents) -> list[int | None]:
        """sum_i (partial_i) t_i for each set of tangents t."""
        if self.partials is None:
            return [None] * len(directions)
        partials, results = self.partials(g, arguments, node), []
        for tangents in directions:
            pairs = zip(partials, tangents, strict=True)
            terms = [_weighted(g, p, t) for p, t in pairs if p is not None and t is not None]
            results.append(functools.reduce(g.add, terms) if terms else None)
        return results

    def cotangents(
        self, g: Graph, arguments: tuple[int, ...], node: int, cotangent: Cotangent
    ) -> Sequence[Cotangent | None]:
        """What the cotangent of the result gives to each argument."""
        if self.partials is None:
            return [None] * len(arguments)
        return [None if p is None else cotangent.through(g, p) for p in self.partials(g, arguments, node)]


def _weighted(g: Graph, slope: int | tuple[int, int], tangent: int) -> int:
    """A derivative times a tangent."""
    weight, rate = slope if isinstance(slope, tuple) else (g.one, slope)
    return g.mul(weight, g.over(tangent, rate))


class Select(Operation):
    """a where c, else b. Derivatives are selected, too: nothing of the other branch is multiplied."""

    def tangents(self, g: Graph, arguments: tuple[int, ...], node: int, directions: Tangents) -> list[int | None]:
        zero = g.constant(0.0, g.dtypes[node])
        chosen = [[zero if t is None else t for t in tangents[1:]] for tangents in directions]
        return [None if pair == [zero, zero] else g.select(arguments[0], *pair) for pair in chosen]

    def cotangents(
        self, g: Graph, arguments: tuple[int, ...], node: int, cotangent: Cotangent
    ) -> Sequence[Cotangent | None]:
        c, zero, (weight, rate) = arguments[0], g.constant(0.0, g.dtypes[node]), cotangent
        return [None, Cotangent(g.select(c, weight, zero), rate), Cotangent(g.select(c, zero, weight), rate)]


class Convert(Operation):
    """The conversion to another type. Linear between floating-point types; otherwise it has no derivative."""

    def tangents(self, g: Graph, arguments: tuple[int, ...], node: int, directions: Tangents) -> list[int | None]:
        linear = self._linear(g, arguments, node)
        return [g.node(self, t) if linear and t is not None else None for (t,) in directions]

    def cotangents(
        self, g: Graph, arguments: tuple[int, ...], node: int, cotangent: Cotangent
    ) -> Sequence[Cotangent | None]:
        if not self._linear(g, arguments, node):
            return [None]
        return [Cotangent(g.node(convert(g.dtypes[arguments[0]]), cotangent.total(g)), g.one)]

    def _linear(self, g: Graph, arguments: tuple[int, ...], node: int) -> bool:
        return all(jnp.issubdtype(g.dtypes[i], jnp.inexact) for i in (node, arguments[0]))


@functools.cache
def convert(dtype: np.dtype[Any]) -> Operation:
    """The conversion to a type: to booleans, whether the number is not zero; to integers, the whole part, saturated,
    and zero for NaN.
    """
    cast, in_range = "($R)$a", "isnan($a) ? 0 : $a <= ($T)$least ? $least : $a >= ($T)$most ? $most : ($R)$a"
    c = {"b": everywhere("$a != 0"), "f": everywhere(cast)}.get(dtype.kind, Forms(in_range, cast, cast))
    casadi = {
        "b": Forms(lambda casadi, a: a != 0, lambda casadi, a: a != 0, lambda casadi, a: a),
        "f": everywhere(lambda casadi, a: a),
        "c": Forms(),
    }
    return Convert(
        name=f"to {dtype.name}",
        number=functools.partial(_converted, dtype),
        array=lambda x: lax.convert_element_type(x, dtype),
        result=dtype,
        llvm=everywhere(code("converted", dtype)),
        c=c,
        casadi=casadi.get(dtype.kind, Forms(whole, lambda casadi, a: a, lambda casadi, a: a)),
    )


def _converted(dtype: np.dtype[Any], x: Any) -> Any:
    if dtype.kind in "iu" and np.asarray(x).dtype.kind == "f":
        ends = np.iinfo(dtype)
        within = (x > ends.min) & (x < ends.max)
        return np.where(
            np.isnan(x), 0, np.where(within, np.where(within, x, 0).astype(dtype), np.where(x > 0, ends.max, ends.min))
        ).astype(dtype)
    return (x if np.issubdtype(dtype, np.complexfloating) else np.real(x)).astype(dtype)


def quotient(a: Any, b: Any) -> Any:
    """As XLA divides: integers towards zero, by zero to all bits set, the least one by -1 to itself."""
    if np.asarray(a).dtype.kind not in "iu":
        return np.divide(a, b)
    zero, one = b == 0, np.abs(b) == 1
    safe = np.where(zero | one, np.ones_like(b), b)
    result = np.floor_divide(a, safe)
    result = result + ((result * safe != a) & ((a < 0) != (safe < 0))).astype(result.dtype)
    return np.where(zero, ~np.zeros_like(a), np.where(b == 1, a, np.where(one, np.negative(a), result))).astype(
        result.dtype
    )


def remainder(a: Any, b: Any) -> Any:
    """The remainder as in XLA: with the sign of the dividend; by zero it is the dividend."""
    if np.asarray(a).dtype.kind not in "iu":
        return np.fmod(a, b)
    return np.where(b == 0, a, np.fmod(a, np.where(b == 0, np.ones_like(b), b)))


def whole(casadi: Any, a: Any) -> Any:
    """The whole part, towards zero."""
    return casadi.sign(a) * casadi.floor(casadi.fabs(a))
