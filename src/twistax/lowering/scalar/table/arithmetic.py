"""Arithmetic, and what has a kink or a jump: magnitudes, extremes, rounding."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax import lax

from .. import in_c, in_casadi, in_llvm
from ..entry import ANY, DEFAULT, Entry, Nodes, each, entries, small_inside, takes
from ..operation import Extreme, Forms, Operation, everywhere
from .logic import LOGIC

if TYPE_CHECKING:
    from ..graph import Graph
    from ..reader import Reader

__all__ = ["ARITHMETIC", "LARGEST", "PRODUCTS", "SMALLEST"]

_X = np.array([0.5, -1.5])


# ---- partial derivatives ---------------------------------------------------------------------------------------------


def _quotient(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    inverse = g.div(g.one, a[1])
    return [inverse, g.neg(g.mul(y, inverse))]


def _slope(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """Of |x|: 1 at zero."""
    return [g.select(g.node(LOGIC["ge"], a[0], g.zero), g.one, g.constant(-1.0))]


def _further(comparison: str) -> Any:
    """Of the larger or the smaller of two: halves where they are equal."""

    def partials(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
        tie = g.select(g.node(LOGIC["eq"], *a), g.constant(0.5), g.zero)
        first = g.select(g.node(LOGIC[comparison], *a), g.one, tie)
        return [first, g.sub(g.one, first)]

    return partials


def _evenly(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """Of an extreme of many: equal ones share it, as after JAX's reductions."""
    equal = [g.select(g.node(LOGIC["eq"], x, y), g.one, g.zero) for x in a]
    share = g.div(g.one, functools.reduce(g.add, equal))
    return [g.mul(each, share) for each in equal]


def _remainder(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """Of x - n y, n the whole part of x / y."""
    ratio = g.div(*a)
    whole = g.node(ARITHMETIC["floor"], g.node(ARITHMETIC["abs"], ratio))
    return [g.one, g.neg(g.mul(g.node(ARITHMETIC["sign"], ratio), whole))]


def _clamped(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """Zero at the limits themselves."""
    low, x, high = a
    inside = g.node(LOGIC["and"], g.node(LOGIC["gt"], x, low), g.node(LOGIC["lt"], x, high))
    conditions = (g.node(LOGIC["gt"], low, x), inside, g.node(LOGIC["lt"], high, x))
    return [g.select(condition, g.one, g.zero) for condition in conditions]


# ---- operations ------------------------------------------------------------------------------------------------------


def _python(function: Any) -> Forms:
    """CasADi's expressions have Python's operators."""
    return everywhere(lambda casadi, *a: function(*a))


ARITHMETIC: dict[str, Operation] = {
    operation.name: operation
    for operation in [
        # LLVM's "contract" lets a product and a sum be one instruction.
        Operation(
            name="add",
            number=np.add,
            array=lax.add,
            arity=2,
            partials=lambda g, a, y: [g.one, g.one],
            symmetric=True,
            maker=lambda g: g.add,
            llvm=Forms(in_llvm.instruction("fadd contract"), in_llvm.instruction("add")),
            c=Forms(in_c.infix("+"), in_c.wrapped("+")),
            casadi=_python(operator.add),
        ),
        Operation(
            name="sub",
            number=np.subtract,
            array=lax.sub,
            arity=2,
            partials=lambda g, a, y: [g.one, g.constant(-1.0)],
            maker=lambda g: g.sub,
            llvm=Forms(in_llvm.instruction("fsub contract"), in_llvm.instruction("sub")),
            c=Forms(in_c.infix("-"), in_c.wrapped("-")),
            casadi=_python(operator.sub),
        ),
        Operation(
            name="mul",
            takes=(takes(out_dtype=DEFAULT),),
            number=np.multiply,
            array=lax.mul,
            arity=2,
            partials=lambda g, a, y: [a[1], a[0]],
            symmetric=True,
            maker=lambda g: g.mul,
            llvm=Forms(in_llvm.instruction("fmul contract"), in_llvm.instruction("mul")),
            c=Forms(in_c.infix("*"), in_c.wrapped("*")),
            casadi=_python(operator.mul),
        ),
        Operation(
            name="div",
            number=np.divide,
            array=lax.div,
            arity=2,
            partials=_quotient,
            maker=lambda g: g.div,
            llvm=Forms(in_llvm.instruction("fdiv")),  # of integers by zero it ends the process
            c=Forms(in_c.infix("/"), in_c.divided),
            casadi=Forms(lambda casadi, a, b: a / b, lambda casadi, a, b: in_casadi.whole(casadi, a / b)),
        ),
        Operation(
            name="neg",
            number=np.negative,
            array=lax.neg,
            partials=lambda g, a, y: [g.constant(-1.0)],
            maker=lambda g: g.neg,
            llvm=Forms(in_llvm.instruction("fneg"), in_llvm.negative),
            c=Forms(in_c.prefix("-"), in_c.negative),
            casadi=_python(operator.neg),
        ),
        Operation(
            name="abs",
            number=np.abs,
            array=lax.abs,
            partials=_slope,
            parity=1,
            llvm=Forms(in_llvm.call("fabs"), in_llvm.magnitude),
            c=Forms(in_c.function("fabs"), in_c.magnitude),
            casadi=in_casadi.function("fabs"),
        ),
        Operation(
            name="sign",
            number=np.sign,
            array=lax.sign,
            parity=-1,
            llvm=Forms(in_llvm.sign, in_llvm.integer_sign),
            c=Forms(in_c.sign, in_c.integer_sign),
            casadi=in_casadi.function("sign"),
        ),
        Operation(
            name="floor",
            number=np.floor,
            array=lax.floor,
            llvm=Forms(in_llvm.call("floor")),
            c=Forms(in_c.function("floor")),
            casadi=in_casadi.function("floor"),
        ),
        Operation(
            name="ceil",
            number=np.ceil,
            array=lax.ceil,
            llvm=Forms(in_llvm.call("ceil")),
            c=Forms(in_c.function("ceil")),
            casadi=in_casadi.function("ceil"),
        ),
        Operation(
            name="rem",
            number=np.fmod,
            array=lax.rem,
            arity=2,
            partials=_remainder,
            llvm=Forms(in_llvm.library("fmod")),
            c=Forms(in_c.function("fmod"), in_c.rest),
            casadi=in_casadi.function("fmod"),
        ),
        Operation(
            name="max",
            number=np.maximum,
            array=lax.max,
            arity=2,
            partials=_further("gt"),
            symmetric=True,
            llvm=Forms(in_llvm.larger("ogt"), in_llvm.chosen("icmp sgt"), in_llvm.instruction("or")),
            c=Forms(in_c.larger, in_c.larger_integer, in_c.infix("||")),
            casadi=in_casadi.function("fmax"),
        ),
        Operation(
            name="min",
            number=np.minimum,
            array=lax.min,
            arity=2,
            partials=_further("lt"),
            symmetric=True,
            llvm=Forms(in_llvm.larger("olt"), in_llvm.chosen("icmp slt"), in_llvm.instruction("and")),
            c=Forms(in_c.smaller, in_c.smaller_integer, in_c.infix("&&")),
            casadi=in_casadi.function("fmin"),
        ),
        Operation(
            name="clamp",
            number=lambda low, x, high: np.minimum(np.maximum(low, x), high),
            array=lambda low, x, high: lax.clamp(low, x, high),
            arity=3,
            partials=_clamped,
            llvm=Forms(
                in_llvm.clamped(in_llvm.larger("ogt"), in_llvm.larger("olt")),
                in_llvm.clamped(in_llvm.chosen("icmp sgt"), in_llvm.chosen("icmp slt")),
            ),
            c=Forms(in_c.clamped(in_c.larger, in_c.smaller), in_c.clamped(in_c.larger_integer, in_c.smaller_integer)),
            casadi=everywhere(lambda casadi, low, x, high: casadi.fmin(casadi.fmax(low, x), high)),
        ),
    ]
}


def _of_many(name: str, pair: Operation) -> Extreme:
    return Extreme(
        name=name,
        takes=(),
        number=lambda *a: functools.reduce(pair.number, a),
        array=lambda *a: functools.reduce(pair.array, a),
        partials=_evenly,
        pair=pair,
    )


#: Of three and more.
LARGEST, SMALLEST = _of_many("largest", ARITHMETIC["max"]), _of_many("smallest", ARITHMETIC["min"])


# ---- primitives made of them -----------------------------------------------------------------------------------------


def power(g: Graph, x: int, n: int) -> int:
    """x^n by repeated squaring."""
    if n < 0:
        return g.div(g.one, power(g, x, -n))
    result: int | None = None
    while n:
        if n & 1:
            result = x if result is None else g.mul(result, x)
        n >>= 1
        if n:
            x = g.mul(x, x)
    return g.one if result is None else result


def _integer_pow(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes] | None:
    g = reader.graph
    if a.size and g.dtypes[a.reshape(-1)[0]] != g.dtype:
        return None
    return [each(lambda x: power(g, x, eqn.params["y"]), a)]


def _added(reader: Reader, eqn: Any, a: Nodes, b: Nodes) -> list[Nodes]:
    return [each(reader.graph.add, a, b)]


def _square(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [each(lambda x: reader.graph.mul(x, x), a)]


PRODUCTS: dict[str, Entry] = entries(
    Entry(name="add_any", read=_added, inside=small_inside, example=(lambda x: jax.grad(lambda y: y @ y)(x), _X)),
    Entry(name="square", read=_square, inside=small_inside, example=(lax.square, _X)),
    Entry(
        name="integer_pow",
        takes=(takes(y=ANY),),
        read=_integer_pow,
        inside=small_inside,
        example=(lambda x: lax.integer_pow(x, 3), _X),
    ),
)
