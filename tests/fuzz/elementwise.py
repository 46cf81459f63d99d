"""Operations entry by entry, choices among them, and what holds to the ends of the range."""

from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
from plans import Plan, maker, refused, smaller
from term import Shape


def soft(x: Any, c: float = 0.5) -> Any:
    p = np.maximum(x, 0.0)
    size = np.maximum(p, c)
    root = np.sqrt((p / size) ** 2 + (c / size) ** 2)
    return size * (p / size * (p / size) / (root + c / size))


UNARY: dict[str, Callable[[Any], Any]] = {
    "tx.Sin({0})": np.sin,
    "tx.Cos({0})": np.cos,
    "tx.Tan(tx.Tanh({0}))": lambda a: np.tan(np.tanh(a)),
    "tx.Asin(0.9 * tx.Sin({0}))": lambda a: np.arcsin(0.9 * np.sin(a)),
    "tx.Acos(0.9 * tx.Sin({0}))": lambda a: np.arccos(0.9 * np.sin(a)),
    "tx.Atan({0})": np.arctan,
    "tx.Sinh(tx.Atan({0}))": lambda a: np.sinh(np.arctan(a)),
    "tx.Cosh(tx.Atan({0}))": lambda a: np.cosh(np.arctan(a)),
    "tx.Tanh({0})": np.tanh,
    "tx.Exp(tx.Tanh({0}))": lambda a: np.exp(np.tanh(a)),
    "tx.Exp(-{0})": lambda a: np.exp(-a),
    "tx.Log(1.0 + tx.Abs({0}))": lambda a: np.log(1.0 + np.abs(a)),
    "tx.Exp(tx.Log(1.0 + tx.Abs({0})))": lambda a: 1.0 + np.abs(a),
    "tx.Sqrt(tx.Abs({0}))": lambda a: np.sqrt(np.abs(a)),
    "tx.Square({0})": np.square,
    "tx.Abs({0})": np.abs,
    "tx.Abs(-{0})": np.abs,
    "tx.Sign({0})": np.sign,
    "tx.PositivePart({0})": lambda a: np.maximum(a, 0.0),
    "tx.Huber({0})": lambda a: np.where(np.abs(a) <= 0.25, a * a / 2, 0.25 * (np.abs(a) - 0.125)),
    "tx.Huber({0}, delta=2.0)": lambda a: np.where(np.abs(a) <= 2.0, a * a / 2, 2.0 * (np.abs(a) - 1.0)),
    "tx.SmoothReLU({0}, c=0.5)": soft,
    "(-{0})": np.negative,
    "(-(-{0}))": lambda a: a,
    "({0} - {0})": lambda a: a - a,
    "({0} + (-{0}) + {0})": lambda a: a - a + a,
    "({0} ** 2)": lambda a: a**2,
    "({0} ** 3)": lambda a: a**3,
    "({0} ** 0)": lambda a: a**0,
    "({0} * 0.0)": lambda a: a * 0.0,
    "(0.0 - {0})": lambda a: 0.0 - a,
    "({0} / 4.0)": lambda a: a / 4.0,
    "(2.0 / (3.0 + tx.Cos({0})))": lambda a: 2.0 / (3.0 + np.cos(a)),
    "np.sin({0})": np.sin,
    "np.maximum({0}, 0.5)": lambda a: np.maximum(a, 0.5),
    "np.clip({0}, -1.0, 1.5)": lambda a: np.clip(a, -1.0, 1.5),
    "abs({0})": np.abs,
}

BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "({0} + {1})": np.add,
    "({0} - {1})": np.subtract,
    "({0} * {1})": np.multiply,
    "({0} / (2.0 + tx.Cos({1})))": lambda a, b: a / (2.0 + np.cos(b)),
    "({0} / {1})": np.divide,
    "tx.Max({0}, {1})": np.maximum,
    "tx.Min({0}, {1})": np.minimum,
    "tx.Max({0}, {1}, {0})": np.maximum,
    "tx.Max(tx.Max({0}, {1}), 0.25)": lambda a, b: np.maximum(np.maximum(a, b), 0.25),
    # At the origin zero by definition, whatever the signs of the zeros.
    "tx.Atan2({0}, {1})": lambda y, x: np.arctan2(y, np.where((x == 0.0) & (y == 0.0), 1.0, x)),
    "tx.LogSumExp({0}, {1})": np.logaddexp,
    "((1.5 + tx.Sin({0})) ** tx.Tanh({1}))": lambda a, b: (1.5 + np.sin(a)) ** np.tanh(b),
    "tx.Add({0}, {1}, {0})": lambda a, b: a + b + a,
    "tx.Mul({1}, {0}, 2.0)": lambda a, b: b * a * 2.0,
    "({0} * {1} / {1})": lambda a, b: a * b / b,
    "(np.float64(0.5) * {0} + {1})": lambda a, b: 0.5 * a + b,
}

#: What holds to the ends of the range and at NaN. What this package refuses to build is left out.
EVERYWHERE: dict[str, Callable[..., Any]] = {
    "tx.Max({0}, {1})": np.maximum,
    "tx.Min({0}, {1})": np.minimum,
    "tx.Max({0}, {1}, {2})": lambda a, b, c: np.maximum(np.maximum(a, b), c),
    "tx.Where({0} <= {1}, {0}, {2})": lambda a, b, c: np.where(a <= b, a, c),
    "tx.Where({0} >= {1}, {1}, {2})": lambda a, b, c: np.where(a >= b, b, c),
    "tx.Where({0} < {1}, {0}, {2})": lambda a, b, c: np.where(a < b, a, c),
    "tx.Where(~({0} < {1}), {0}, {2})": lambda a, b, c: np.where(a < b, c, a),
    "tx.Where({0} == {1}, 1.0, {2})": lambda a, b, c: np.where(a == b, 1.0, c),
    "tx.Abs({0})": np.abs,
    "tx.Sign({0})": np.sign,
    "tx.PositivePart({0})": lambda a: np.maximum(a, 0.0),
    "tx.SmoothReLU({0}, c=0.5)": soft,
    "tx.Atan({0})": np.arctan,
    "tx.Tanh({0})": np.tanh,
    "tx.Exp(-tx.Abs({0}))": lambda a: np.exp(-np.abs(a)),
    "tx.Sqrt(tx.Abs({0}))": lambda a: np.sqrt(np.abs(a)),
    "({0} + {1})": np.add,
    "({0} - {1})": np.subtract,
    "({0} * {1})": np.multiply,
    "tx.LogSumExp({0}, {1})": np.logaddexp,
    "tx.Cond({0}[0] <= {1}[0], {0}, {2})": lambda a, b, c: a if a[0] <= b[0] else c,
    "tx.Cond(tx.Any({0} >= {1}), {0}, {2})": lambda a, b, c: a if np.any(a >= b) else c,
    "tx.Concat({0}[:2], {1}[2:4], {2}[4:])": lambda a, b, c: np.concatenate([a[:2], b[2:4], c[4:]]),
    **{f"np.{name}({{0}}, {{1}})": getattr(np, name) for name in (
        "maximum", "minimum", "fmax", "fmin", "hypot", "logaddexp", "add", "copysign", "nextafter", "heaviside",
    )},
    **{f"np.{name}({{0}})": getattr(np, name) for name in (
        "abs", "fabs", "sign", "tanh", "negative", "rint", "floor", "nan_to_num", "signbit", "isnan", "cbrt",
    )},
}  # fmt: skip


def extremes(shape: Shape) -> list[tuple[Plan, Shape]]:
    """The operations that hold everywhere."""
    found = []
    for code, numpy in EVERYWHERE.items():
        args = (shape,) * (1 + max(k for k in range(3) if f"{{{k}}}" in code))
        if not refused(code, args):
            found.append((Plan(code, numpy, args), shape))
    return found


CONDITIONS: dict[str, Callable[..., Any]] = {
    "{0} <= {1}": np.less_equal,
    "{0} >= {1}": np.greater_equal,
    "{0} == {1}": np.equal,
    "2.0 * {0} <= {1} + {0}": lambda a, b: 2.0 * a <= b + a,
    "tx.All({0} <= {1}, {1} <= 1.0)": lambda a, b: np.all(a <= b) and np.all(b <= 1.0),
    "{0} > {1}": lambda a, b: a > b,
    "~({0} <= {1})": lambda a, b: ~np.less_equal(a, b),
    "~tx.All({0} < {1}, {1} < 1.0)": lambda a, b: not (np.all(a < b) and np.all(b < 1.0)),
    "tx.Any({0} >= {1}, {1} == 0.5)": lambda a, b: np.any(a >= b) or np.any(b == 0.5),
}


@maker
def unary(source: Random, shape: Shape) -> Plan:
    code, numpy = source.choice(list(UNARY.items()))
    return Plan(code, numpy, (shape,))


@maker
def near(source: Random, shape: Shape) -> Plan:
    """The same function of two arguments that differ a little."""
    code, numpy = source.choice(list(UNARY.items()))
    one, two = (code.replace("{0}", f"({by} * {{0}})") for by in (2.0, 2.5))
    return Plan(f"({one} - {two})", lambda a: numpy(2.0 * a) - numpy(2.5 * a), (shape,))


@maker
def binary(source: Random, shape: Shape) -> Plan:
    code, numpy = source.choice(list(BINARY.items()))
    other = smaller(source, shape)
    return (
        Plan(code, numpy, (shape, other))
        if source.random() < 0.5
        else Plan(
            code.replace("{0}", "{x}").replace("{1}", "{0}").replace("{x}", "{1}"),
            lambda a, b: numpy(b, a),
            (shape, other),
        )
    )


@maker
def choice(source: Random, shape: Shape) -> Plan:
    """`Where` takes conditions entry by entry, `Cond` one for all."""
    code, numpy = source.choice(list(CONDITIONS.items()))
    whole = source.random() < 0.5
    condition = () if whole else smaller(source, shape)
    node = "tx.Cond" if whole else "tx.Where"
    text = f"{node}({code}, {{2}}, {{3}})"
    return Plan(
        text,
        lambda a, b, yes, no: np.where(numpy(a, b), yes, no),
        (condition, condition, shape, smaller(source, shape) if not whole else shape),
    )
