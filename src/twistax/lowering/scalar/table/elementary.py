"""Elementary functions: powers and roots, exponentials, trigonometry, hyperbolic functions."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jax import lax

from .. import in_c, in_casadi, in_llvm
from ..entry import DEFAULT, NOTHING, Entry, Nodes, each, entries, small_inside, takes
from ..operation import Forms, Operation, everywhere
from .logic import LOGIC, convert

if TYPE_CHECKING:
    from ..graph import Graph
    from ..reader import Reader

__all__ = ["ELEMENTARY", "ROOTS"]

#: JAX lets some of them be asked for another accuracy.
_TAKES = (NOTHING, takes(accuracy=DEFAULT))


def _function(
    name: str,
    number: Any,
    array: Any,
    slope: Callable[[Graph, int, int], int],
    *,
    parity: int = 0,
    llvm: Any = None,
    c: Any = None,
    casadi: Any = None,
    at: float = 0.5,
) -> Operation:
    """A function of one real number, called the same in libm and CasADi where nothing else is said.

    Args:
        slope: (graph, x, y) -> the derivative of y by x.
        at: a number that it is defined for.
    """
    return Operation(
        name=name,
        takes=_TAKES,
        number=number,
        array=array,
        partials=lambda g, a, y: [slope(g, a[0], y)],
        parity=parity,
        example=(array, np.array([at])),
        llvm=Forms(llvm or in_llvm.library(name)),
        c=Forms(c or in_c.function(name)),
        casadi=everywhere(casadi) if casadi else in_casadi.function(name),
    )


# ---- derivatives -----------------------------------------------------------------------------------------------------


def _of(name: str, g: Graph, x: int) -> int:
    return g.node(ELEMENTARY[name], x)


def _square_plus(g: Graph, x: int) -> int:
    """1 + x^2."""
    return g.add(g.one, g.mul(x, x))


def _beside_one(g: Graph, x: int) -> int:
    """1 - x^2, without cancellation near one."""
    return g.mul(g.sub(g.one, x), g.add(g.one, x))


def _inverse(g: Graph, x: int) -> int:
    return g.div(g.one, x)


def _inverse_root(g: Graph, x: int) -> int:
    return g.div(g.one, _of("sqrt", g, x))


def _power(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    x, n = a
    zero_power = g.node(LOGIC["eq"], n, g.zero)
    lower = g.node(ELEMENTARY["pow"], x, g.select(zero_power, g.one, g.sub(n, g.one)))
    base = g.select(g.node(LOGIC["eq"], x, g.zero), g.one, x)
    return [g.mul(n, lower), g.mul(_of("log", g, base), y)]


def _angle(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    inverse = _inverse(g, g.add(g.mul(a[0], a[0]), g.mul(a[1], a[1])))
    return [g.mul(a[1], inverse), g.neg(g.mul(a[0], inverse))]


# ---- operations ------------------------------------------------------------------------------------------------------


def _power_node(g: Graph, x: int, n: int) -> int:
    """The exponent may be an integer."""
    same = n if g.dtypes[n] == g.dtypes[x] else g.node(convert(g.dtypes[x]), n)
    return g.node(ELEMENTARY["pow"], x, same)


ELEMENTARY: dict[str, Operation] = {
    operation.name: operation
    for operation in [
        Operation(
            name="pow",
            number=np.power,
            array=lax.pow,
            arity=2,
            partials=_power,
            maker=lambda g: functools.partial(_power_node, g),
            llvm=Forms(in_llvm.library("pow")),
            c=Forms(in_c.function("pow")),
            casadi=everywhere(lambda casadi, a, b: a**b),
        ),
        Operation(
            name="atan2",
            number=np.arctan2,
            array=lax.atan2,
            arity=2,
            partials=_angle,
            llvm=Forms(in_llvm.library("atan2")),
            c=Forms(in_c.function("atan2")),
            casadi=in_casadi.function("atan2"),
        ),
        _function("sqrt", np.sqrt, lax.sqrt, lambda g, x, y: g.div(g.constant(0.5), y), llvm=in_llvm.call("sqrt")),
        _function(
            "cbrt",
            np.cbrt,
            lax.cbrt,
            lambda g, x, y: g.div(g.constant(1.0 / 3.0), g.mul(y, y)),
            parity=-1,
            casadi=lambda casadi, a: casadi.sign(a) * casadi.fabs(a) ** (1.0 / 3.0),
        ),
        _function("exp", np.exp, lax.exp, lambda g, x, y: y),
        _function(
            "exp2",
            np.exp2,
            lax.exp2,
            lambda g, x, y: g.mul(g.constant(float(np.log(2.0))), y),
            casadi=lambda casadi, a: 2.0**a,
        ),
        _function("expm1", np.expm1, lax.expm1, lambda g, x, y: g.add(y, g.one)),
        _function("log", np.log, lax.log, lambda g, x, y: _inverse(g, x)),
        _function("log1p", np.log1p, lax.log1p, lambda g, x, y: _inverse(g, g.add(g.one, x))),
        _function(
            "logistic",
            lambda x: 1.0 / (1.0 + np.exp(-x)),
            lax.logistic,
            lambda g, x, y: g.mul(y, g.sub(g.one, y)),
            llvm=in_llvm.logistic,
            c=in_c.helper("logistic", "a", "@1 / (@1 + exp@f(-a))"),
            casadi=lambda casadi, a: 1.0 / (1.0 + casadi.exp(-a)),
        ),
        _function("sin", np.sin, lax.sin, lambda g, x, y: _of("cos", g, x), parity=-1, llvm=in_llvm.paired(0)),
        _function("cos", np.cos, lax.cos, lambda g, x, y: g.neg(_of("sin", g, x)), parity=1, llvm=in_llvm.paired(1)),
        _function("tan", np.tan, lax.tan, lambda g, x, y: _square_plus(g, y), parity=-1),
        _function("asin", np.arcsin, lax.asin, lambda g, x, y: _inverse_root(g, _beside_one(g, x)), parity=-1),
        _function("acos", np.arccos, lax.acos, lambda g, x, y: g.neg(_inverse_root(g, _beside_one(g, x)))),
        _function("atan", np.arctan, lax.atan, lambda g, x, y: _inverse(g, _square_plus(g, x)), parity=-1),
        _function("sinh", np.sinh, lax.sinh, lambda g, x, y: _of("cosh", g, x), parity=-1),
        _function("cosh", np.cosh, lax.cosh, lambda g, x, y: _of("sinh", g, x), parity=1),
        _function("tanh", np.tanh, lax.tanh, lambda g, x, y: _beside_one(g, y), parity=-1),
        _function("asinh", np.arcsinh, lax.asinh, lambda g, x, y: _inverse_root(g, _square_plus(g, x)), parity=-1),
        _function(
            "acosh",
            np.arccosh,
            lax.acosh,
            lambda g, x, y: _inverse_root(g, g.mul(g.sub(x, g.one), g.add(x, g.one))),
            at=2.0,
        ),
        _function("atanh", np.arctanh, lax.atanh, lambda g, x, y: _inverse(g, _beside_one(g, x)), parity=-1),
    ]
}


# ---- primitives made of them -----------------------------------------------------------------------------------------


def _rsqrt(reader: Reader, eqn: Any, a: Nodes) -> list[Nodes]:
    return [each(lambda x: _inverse_root(reader.graph, x), a)]


ROOTS: dict[str, Entry] = entries(
    Entry(name="rsqrt", takes=_TAKES, read=_rsqrt, inside=small_inside, example=(lax.rsqrt, np.array([0.5])))
)
