"""The operations of a scalar program: one object says everything of each.

An operation knows how to work on numbers (NumPy, for folding constants), on arrays (JAX, for the emitter), and how
tangents and cotangents pass through it, again as nodes of the graph. Derivatives at kinks are those of JAX.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .algebra import Algebra

__all__ = ["LARGEST", "SMALLEST", "Extreme", "Operation", "Select", "by_primitive", "convert"]

#: Nodes of the derivatives of an operation with respect to its arguments; None where one is zero everywhere.
Partials = Callable[[Algebra, tuple[int, ...], int], Sequence[int | None]]


@dataclasses.dataclass(frozen=True, eq=False)
class Operation:
    """An operation on scalars. Compared and hashed by identity.

    Attributes:
        name: how counts and pictures call it; that of the JAX primitive where there is one.
        number: the operation on NumPy scalars or arrays.
        array: the operation on JAX arrays of one shape.
        partials: the derivatives; None where they are zero or not defined (comparisons, rounding).
        result: the type of the result, None: that of the arguments.
        symmetric: whether arguments may be swapped.
        parity: -1 for odd functions, 1 for even ones, 0 for others.
    """

    name: str
    number: Callable[..., Any]
    array: Callable[..., jax.Array]
    partials: Partials | None = None
    result: np.dtype[Any] | None = None
    symmetric: bool = False
    parity: int = 0

    def __repr__(self) -> str:
        return self.name

    def tangents(
        self, g: Algebra, arguments: tuple[int, ...], node: int, along: Sequence[Sequence[int | None]]
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

    def cotangents(self, g: Algebra, arguments: tuple[int, ...], node: int, cotangent: int) -> Sequence[int | None]:
        """What the cotangent of the result gives to each argument."""
        if self.partials is None:
            return [None] * len(arguments)
        found = self.partials(g, arguments, node)
        return [None if partial is None else g.scaled(partial, cotangent) for partial in found]


class Select(Operation):
    """Select(c, a, b): a where c, else b. Derivatives are selected too: nothing of the other branch is multiplied."""

    def tangents(
        self, g: Algebra, arguments: tuple[int, ...], node: int, along: Sequence[Sequence[int | None]]
    ) -> list[int | None]:
        zero = g.constant(0.0, g.dtypes[node])
        return [
            None
            if a is None and b is None
            else g.select(arguments[0], zero if a is None else a, zero if b is None else b)
            for _, a, b in along
        ]

    def cotangents(self, g: Algebra, arguments: tuple[int, ...], node: int, cotangent: int) -> Sequence[int | None]:
        c, zero = arguments[0], g.constant(0.0, g.dtypes[node])
        return [None, g.select(c, cotangent, zero), g.select(c, zero, cotangent)]


class Convert(Operation):
    """The conversion to another type. Linear between floating-point types, else of no derivative."""

    def tangents(
        self, g: Algebra, arguments: tuple[int, ...], node: int, along: Sequence[Sequence[int | None]]
    ) -> list[int | None]:
        if not self._linear(g, arguments):
            return [None] * len(along)
        return [None if t is None else g.node(self, t) for (t,) in along]

    def cotangents(self, g: Algebra, arguments: tuple[int, ...], node: int, cotangent: int) -> Sequence[int | None]:
        return [g.node(convert(g.dtypes[arguments[0]]), cotangent) if self._linear(g, arguments) else None]

    def _linear(self, g: Algebra, arguments: tuple[int, ...]) -> bool:
        return all(d is not None and jnp.issubdtype(d, jnp.inexact) for d in (self.result, g.dtypes[arguments[0]]))


class Extreme(Operation):
    """The largest or the smallest of many. Equal ones share the derivative evenly, as after JAX's reductions.

    Attributes:
        pair: that of two; emitters write one after the other.
    """

    pair: Operation

    def __init__(self, name: str, pair: Operation) -> None:
        super().__init__(
            name,
            lambda *a: functools.reduce(pair.number, a),
            lambda *a: functools.reduce(pair.array, a),
            _evenly,
        )
        object.__setattr__(self, "pair", pair)


_BOOL = np.dtype(bool)

# ---- the partial derivatives -----------------------------------------------------------------------------------------


def _half(g: Algebra) -> int:
    return g.constant(0.5)


def _one(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    return [g.one] * len(a)


def _div(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    inverse = g.div(g.one, a[1])
    return [inverse, g.neg(g.mul(y, inverse))]


def _larger(greater: Operation) -> Partials:
    def partials(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
        first = g.select(g.node(greater, *a), g.one, g.select(g.node(by_primitive["eq"], *a), _half(g), g.zero))
        return [first, g.sub(g.one, first)]

    return partials


def _evenly(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    equal = [g.select(g.node(by_primitive["eq"], x, y), g.one, g.zero) for x in a]
    share = g.div(g.one, functools.reduce(g.add, equal))
    return [g.mul(each, share) for each in equal]


def _rem(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """x - n y, n the whole part of x / y."""
    ratio = g.div(*a)
    whole = g.mul(_call("sign")(g, ratio), _call("floor")(g, _call("abs")(g, ratio)))
    return [g.one, g.neg(whole)]


def _clamp(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """Zero at the limits themselves."""
    low, x, high = a
    greater, less = by_primitive["gt"], by_primitive["lt"]

    def where(condition: int) -> int:
        return g.select(condition, g.one, g.zero)

    inside = g.node(by_primitive["and"], g.node(greater, x, low), g.node(less, x, high))
    return [where(g.node(greater, low, x)), where(inside), where(g.node(less, high, x))]


def _atan2(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    inverse = g.div(g.one, g.add(g.mul(a[0], a[0]), g.mul(a[1], a[1])))
    return [g.mul(a[1], inverse), g.neg(g.mul(a[0], inverse))]


def _pow(g: Algebra, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    x, n = a
    zero_power = g.node(by_primitive["eq"], n, g.zero)
    lower = g.node(by_primitive["pow"], x, g.select(zero_power, g.one, g.sub(n, g.one)))
    base = g.select(g.node(by_primitive["eq"], x, g.zero), g.one, x)
    return [g.mul(n, lower), g.mul(g.node(by_primitive["log"], base), y)]


def _of(function: Callable[[Algebra, int, int], int]) -> Partials:
    """The partials of a function of one argument x with result y."""
    return lambda g, a, y: [function(g, a[0], y)]


def _call(name: str) -> Callable[[Algebra, int], int]:
    return lambda g, x: g.node(by_primitive[name], x)


def _slope(g: Algebra, x: int, y: int) -> int:
    """Of |x|: 1 at zero."""
    return g.select(g.node(by_primitive["ge"], x, g.zero), g.one, g.constant(-1.0))


def _beside_one(g: Algebra, x: int) -> int:
    """1 - x^2, without cancellation near one."""
    return g.mul(g.sub(g.one, x), g.add(g.one, x))


def _arc(g: Algebra, x: int, y: int) -> int:
    return g.div(g.one, _call("sqrt")(g, _beside_one(g, x)))


def _arc_of_sinh(g: Algebra, x: int, y: int) -> int:
    return g.div(g.one, _call("sqrt")(g, _square_plus(g, x)))


def _arc_of_cosh(g: Algebra, x: int, y: int) -> int:
    return g.div(g.one, _call("sqrt")(g, g.mul(g.sub(x, g.one), g.add(x, g.one))))


def _square_plus(g: Algebra, x: int) -> int:
    """1 + x^2."""
    return g.add(g.one, g.mul(x, x))


# ---- the operations --------------------------------------------------------------------------------------------------


def _logistic(x: Any) -> Any:
    return 1.0 / (1.0 + np.exp(-x))


def _between(low: Any, x: Any, high: Any) -> Any:
    return np.minimum(np.maximum(low, x), high)


#: The operations by the name of the JAX primitive that they are.
by_primitive: dict[str, Operation] = {
    operation.name: operation
    for operation in [
        Operation("add", np.add, lax.add, _one, symmetric=True),
        Operation("sub", np.subtract, lax.sub, lambda g, a, y: [g.one, g.constant(-1.0)]),
        Operation("mul", np.multiply, lax.mul, lambda g, a, y: [a[1], a[0]], symmetric=True),
        Operation("div", np.divide, lax.div, _div),
        Operation("neg", np.negative, lax.neg, lambda g, a, y: [g.constant(-1.0)]),
        Operation("abs", np.abs, lax.abs, _of(_slope), parity=1),
        Operation("sign", np.sign, lax.sign, parity=-1),
        Operation("floor", np.floor, lax.floor),
        Operation("ceil", np.ceil, lax.ceil),
        Operation("rem", np.fmod, lax.rem, _rem),
        Operation("max", np.maximum, lax.max, None, symmetric=True),
        Operation("min", np.minimum, lax.min, None, symmetric=True),
        Operation("clamp", _between, lambda low, x, high: lax.clamp(low, x, high), _clamp),
        Operation("pow", np.power, lax.pow, _pow),
        Operation("atan2", np.arctan2, lax.atan2, _atan2),
        Operation("sqrt", np.sqrt, lax.sqrt, _of(lambda g, x, y: g.div(_half(g), y))),
        Operation("cbrt", np.cbrt, lax.cbrt, _of(lambda g, x, y: g.div(g.constant(1.0 / 3.0), g.mul(y, y))), parity=-1),
        Operation("exp", np.exp, lax.exp, _of(lambda g, x, y: y)),
        Operation("exp2", np.exp2, lax.exp2, _of(lambda g, x, y: g.mul(g.constant(float(np.log(2.0))), y))),
        Operation("expm1", np.expm1, lax.expm1, _of(lambda g, x, y: g.add(y, g.one))),
        Operation("log", np.log, lax.log, _of(lambda g, x, y: g.div(g.one, x))),
        Operation("log1p", np.log1p, lax.log1p, _of(lambda g, x, y: g.div(g.one, g.add(g.one, x)))),
        Operation("sin", np.sin, lax.sin, _of(lambda g, x, y: _call("cos")(g, x)), parity=-1),
        Operation("cos", np.cos, lax.cos, _of(lambda g, x, y: g.neg(_call("sin")(g, x))), parity=1),
        Operation("tan", np.tan, lax.tan, _of(lambda g, x, y: _square_plus(g, y)), parity=-1),
        Operation("asin", np.arcsin, lax.asin, _of(_arc), parity=-1),
        Operation("acos", np.arccos, lax.acos, _of(lambda g, x, y: g.neg(_arc(g, x, y)))),
        Operation("atan", np.arctan, lax.atan, _of(lambda g, x, y: g.div(g.one, _square_plus(g, x))), parity=-1),
        Operation("sinh", np.sinh, lax.sinh, _of(lambda g, x, y: _call("cosh")(g, x)), parity=-1),
        Operation("cosh", np.cosh, lax.cosh, _of(lambda g, x, y: _call("sinh")(g, x)), parity=1),
        Operation("tanh", np.tanh, lax.tanh, _of(lambda g, x, y: _beside_one(g, y)), parity=-1),
        Operation(
            "asinh",
            np.arcsinh,
            lax.asinh,
            _of(_arc_of_sinh),
            parity=-1,
        ),
        Operation("acosh", np.arccosh, lax.acosh, _of(_arc_of_cosh)),
        Operation("atanh", np.arctanh, lax.atanh, _of(lambda g, x, y: g.div(g.one, _beside_one(g, x))), parity=-1),
        Operation("logistic", _logistic, lax.logistic, _of(lambda g, x, y: g.mul(y, g.sub(g.one, y)))),
        Operation("stop_gradient", np.positive, lambda x: x),
        Operation("eq", np.equal, lax.eq, result=_BOOL, symmetric=True),
        Operation("ne", np.not_equal, lax.ne, result=_BOOL, symmetric=True),
        Operation("lt", np.less, lax.lt, result=_BOOL),
        Operation("le", np.less_equal, lax.le, result=_BOOL),
        Operation("gt", np.greater, lax.gt, result=_BOOL),
        Operation("ge", np.greater_equal, lax.ge, result=_BOOL),
        Operation("is_finite", np.isfinite, lax.is_finite, result=_BOOL),
        Operation("and", np.bitwise_and, lax.bitwise_and, symmetric=True),
        Operation("or", np.bitwise_or, lax.bitwise_or, symmetric=True),
        Operation("xor", np.bitwise_xor, lax.bitwise_xor, symmetric=True),
        Operation("not", np.invert, lax.bitwise_not),
        Select("select", np.where, lambda c, a, b: lax.select(c, a, b)),
    ]
}
for _name, _above in (("max", "gt"), ("min", "lt")):
    by_primitive[_name] = dataclasses.replace(by_primitive[_name], partials=_larger(by_primitive[_above]))

#: Of three and more.
LARGEST, SMALLEST = Extreme("largest", by_primitive["max"]), Extreme("smallest", by_primitive["min"])

_CONVERSIONS: dict[np.dtype[Any], Operation] = {}


def convert(dtype: np.dtype[Any]) -> Operation:
    """The conversion to a type."""
    if dtype not in _CONVERSIONS:
        _CONVERSIONS[dtype] = Convert(
            f"to {dtype.name}",
            lambda x: (x if np.issubdtype(dtype, np.complexfloating) else np.real(x)).astype(dtype),
            lambda x: lax.convert_element_type(x, dtype),
            result=dtype,
        )
    return _CONVERSIONS[dtype]
