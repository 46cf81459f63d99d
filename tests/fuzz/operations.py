"""All that a term may do: for each operation its code, the same by NumPy, and which operands it wants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random
from typing import Any

import numpy as np
import scipy.interpolate
import scipy.linalg
from scipy.spatial.transform import Rotation
from term import Shape

import twistax as tx


@dataclass(frozen=True)
class Graded:
    """Wanted as an operand: a leaf that is a matrix n x n of a large condition number."""

    n: int

    def matrix(self, source: Random) -> np.ndarray:
        generator = np.random.default_rng(source.getrandbits(32))
        left, right = (np.linalg.qr(generator.normal(size=(self.n, self.n)))[0] for _ in range(2))
        return (left * np.geomspace(1.0, 10.0 ** -source.uniform(4.0, 10.0), self.n)) @ right


@dataclass(frozen=True)
class Plan:
    """An operation that gives a wanted shape: code with a field for each operand, NumPy's function, the operands.

    An operand is wanted by its shape, or as a plan of the operands before it.
    """

    code: str
    numpy: Callable[..., Any]
    args: tuple[Operand, ...]
    setup: str = ""
    shape: Shape = ()


Operand = Shape | Graded | Plan


Maker = Callable[[Random, Shape], Plan | None]
MAKERS: list[Maker] = []


def maker(function: Maker) -> Maker:
    MAKERS.append(function)
    return function


def smaller(source: Random, shape: Shape) -> Shape:
    """A shape that broadcasts to this one."""
    return source.choice([shape, shape, shape, (), shape[1:], tuple(1 if source.random() < 0.3 else n for n in shape)])


def positive(a: Any) -> Any:
    return np.tanh(a) @ np.swapaxes(np.tanh(a), -1, -2) + 2.0 * np.eye(np.shape(a)[0])


POSITIVE = "(tx.Tanh({0}) @ tx.Tanh({0}).T + 2.0 * np.eye(%d))"


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
    "tx.Atan2({0}, {1})": np.arctan2,
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


@cache
def refused(code: str, shapes: tuple[Shape, ...]) -> bool:
    """Whether no such expression can be built."""
    leaves = [tx.State(f"a{k}", shape=shape) for k, shape in enumerate(shapes)]
    names = {f"a{k}": leaf for k, leaf in enumerate(leaves)}
    try:
        eval(code.format(*names), {"tx": tx, "np": np, **names})
    except (TypeError, ValueError):
        return True
    return False


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


def _reduced(source: Random) -> Shape:
    return source.choice([(2,), (3,), (4,), (6,), (2, 2), (2, 3), (3, 3), (4, 4), (2, 2, 3)])


@maker
def reduction(source: Random, shape: Shape) -> Plan | None:
    if shape:
        return None
    whole = _reduced(source)
    found = [("tx.linalg.Sum({0})", np.sum, whole)]
    vector = source.choice([(2,), (3,), (6,)])
    found += [
        ("tx.linalg.Norm({0})", lambda a: np.linalg.norm(a), vector),
        ("tx.linalg.Norm({0}, 1)", lambda a: np.linalg.norm(a, 1), vector),
        ('tx.linalg.Norm({0}, "inf")', lambda a: np.linalg.norm(a, np.inf), vector),
        ("tx.linalg.Norm({0})", lambda a: np.linalg.norm(a), (3, 3)),
        ('tx.linalg.Norm({0}, "inf")', lambda a: np.linalg.norm(a, np.inf), (2, 3)),
        ("tx.linalg.Trace({0})", np.trace, source.choice([(2, 2), (3, 3)])),
        ("np.sum({0})", np.sum, whole),
        ("tx.linalg.Norm({0})", np.linalg.norm, whole if len(whole) < 3 else (6,)),
        (
            "tx.Interp({0}, axes=[-1.0, -0.2, 0.5, 1.0, 3.0], values=[2.0, -1, 0.5, 1.0, 4.0])",
            lambda a: np.interp(a, [-1.0, -0.2, 0.5, 1.0, 3.0], [2.0, -1, 0.5, 1.0, 4.0]),
            (),
        ),
        ("tx.Linterp({0}, [-1, 0.5, 3], [2.0, -1, 0.5])", lambda a: np.interp(a, [-1, 0.5, 3], [2, -1, 0.5]), ()),
    ]  # fmt: skip
    code, numpy, arg = source.choice(found)
    return Plan(code, numpy, (arg,))


@maker
def product(source: Random, shape: Shape) -> Plan | None:
    n = source.choice([2, 3, 4])
    if shape == ():
        code = source.choice(["{0} @ {1}", "tx.linalg.Dot({0}, {1})", "np.dot({0}, {1})"])
        return Plan(f"({code})", np.dot, ((n,), (n,)))
    if len(shape) == 1:
        sides = [("({0} @ {1})", (*shape, n), (n,)), ("({0} @ {1})", (n,), (n, *shape))]
        code, a, b = source.choice(sides)
        return Plan(source.choice([code, "np.dot({0}, {1})"]), np.matmul, (a, b))
    if len(shape) == 2:
        found = [
            Plan("({0} @ {1})", np.matmul, ((shape[0], n), (n, shape[1]))),
            Plan("np.dot({0}, {1})", np.dot, ((shape[0], n), (n, shape[1]))),
            Plan("tx.linalg.Outer({0}, {1})", np.outer, ((shape[0],), (shape[1],))),
            Plan("{0}.T", np.transpose, ((shape[1], shape[0]),)),
            Plan("np.transpose({0})", np.transpose, ((shape[1], shape[0]),)),
        ]
        if shape == (3, 3):
            found.append(Plan("tx.spatial.SSM({0})", lambda a: np.cross(np.eye(3), a), ((3,),)))
        if shape[0] == shape[1]:
            found.append(Plan("tx.linalg.Diag({0})", np.diag, ((shape[0],),)))
        return source.choice(found)
    return Plan("({0} @ {1})", np.matmul, ((*shape[:-1], n), (*shape[:-2], n, shape[-1])))


@maker
def refusable(source: Random, shape: Shape) -> Plan | None:
    """What NumPy means by it, where this package takes it at all."""
    if shape:
        return None
    found: list[tuple[str, Callable[..., Any], tuple[Shape, ...]]] = [
        ("np.sum(np.dot({0}, {1}) ** 2)", lambda a, b: np.sum(np.dot(a, b) ** 2), ((2, 2, 3), (2, 3, 2))),
        ("np.sum(np.dot({0}, {1}) ** 2)", lambda a, b: np.sum(np.dot(a, b) ** 2), ((2, 2, 3), (3,))),
        ("np.sum(np.fmax({0}, {1}))", lambda a, b: np.sum(np.fmax(a, b)), ((3,), (3,))),
        ("np.max(np.block([[{0}, {1}]]))", lambda a, b: np.max(np.block([[a, b]])), ((2, 2), (2, 3))),
    ]
    code, numpy, args = source.choice(found)
    return None if refused(code, args) else Plan(code, numpy, args)


@maker
def solve(source: Random, shape: Shape) -> Plan | None:
    """Of positive definite matrices, and of any."""
    if not shape or len(shape) > 2:
        return None
    n = shape[0]
    # Operands of their own, so that noise is put on them: the error of LAPACK itself is that of its matrix.
    square = ((n, n), Plan(POSITIVE % n, positive, (), shape=(n, n)))
    rough = ((n, n), Plan(f"({{0}} + 0.25 * np.eye({n}))", lambda a: a + 0.25 * np.eye(n), (), shape=(n, n)))
    by_lapack, inverse = lambda a, m, b: np.linalg.solve(m, b), lambda a, m: np.linalg.inv(m)
    found = [Plan("tx.linalg.Solve({1}, {2})", by_lapack, (*own, shape)) for own in (square, rough)]
    graded = Graded(n)
    if n < 5:
        # A right-hand side of a solution of size one: there the error of an algorithm shows.
        right = Plan("({0} @ {1})", np.matmul, (), shape=shape)
        found += 2 * [Plan("tx.linalg.Solve({0}, {2})", lambda a, x, b: np.linalg.solve(a, b), (graded, shape, right))]
        if shape == (n,):
            found.append(
                Plan("(tx.linalg.Inv({0}) @ {2})", lambda a, x, b: np.linalg.solve(a, b), (graded, shape, right))
            )
    if shape == (n, n):
        found += [Plan("tx.linalg.Inv({1})", inverse, own) for own in (square, rough)]
    return source.choice(found)


@maker
def joined(source: Random, shape: Shape) -> Plan | None:
    if not shape:
        return None
    if len(shape) == 1:
        n = shape[0]
        if n == 1:
            return Plan("tx.Concat({0})", np.atleast_1d, ((),))
        k = source.randint(1, n - 1)
        found = [
            Plan("tx.Concat({0}, {1})", lambda a, b: np.concatenate([a, b]), ((k,), (n - k,))),
            Plan("np.concatenate([{0}, {1}])", lambda a, b: np.concatenate([a, b]), ((k,), (n - k,))),
            Plan("tx.Hstack({0}, {1})", lambda a, b: np.hstack([a, b]), ((k,), (n - k,))),
            Plan(f"tx.Concat({{0}}, {{1}})[{k}:]", lambda a, b: np.concatenate([a, b])[k:], ((k,), (n,))),
        ]
        if n <= 6:
            fields = ", ".join(f"{{{i}}}" for i in range(n))
            found.append(Plan(f"tx.Stack({fields})", lambda *a: np.stack(a), ((),) * n))
            found.append(Plan(f"tx.Concat({fields})", lambda *a: np.stack(a), ((),) * n))
        return source.choice(found)
    fields = ", ".join(f"{{{i}}}" for i in range(shape[0]))
    found = [
        Plan(f"tx.Stack({fields})", lambda *a: np.stack(a), (shape[1:],) * shape[0]),
        Plan(f"np.stack([{fields}])", lambda *a: np.stack(a), (shape[1:],) * shape[0]),
    ]
    if len(shape) == 2 and shape[1] > 1:
        k = source.randint(1, shape[1] - 1)
        halves = ((shape[0], k), (shape[0], shape[1] - k))
        found.append(Plan("tx.Hstack({0}, {1})", lambda a, b: np.hstack([a, b]), halves))
        found.append(Plan("tx.Block([[{0}, {1}]])", lambda a, b: np.block([[a, b]]), halves))
        found.append(Plan("np.block([[{0}, {1}]])", lambda a, b: np.block([[a, b]]), halves))
    if len(shape) == 2 and shape[0] > 1:
        k = source.randint(1, shape[0] - 1)
        found.append(
            Plan("tx.Vstack({0}, {1})", lambda a, b: np.vstack([a, b]), ((k, shape[1]), (shape[0] - k, shape[1])))
        )
    return source.choice(found)


def _index(source: Random, n: int) -> tuple[str, str]:
    """Code of an index of one axis, and whether it is basic ("b") or a list ("a")."""
    k = source.randint(-n, n - 1)
    lo, hi = sorted((source.randint(0, n - 1), source.randint(0, n - 1)))
    several = [source.randint(-n, n - 1) for _ in range(source.randint(1, 3))]
    mask = [source.random() < 0.6 for _ in range(n)]
    mask[source.randrange(n)] = True
    return source.choice(
        [
            (str(k), "b"), (":", "b"), (f"{lo}:{hi + 1}", "b"), ("::-1", "b"), (f"{lo}::2", "b"), ("-1:", "b"),
            (str(several), "a"), (f"np.array({several})", "a"), (str(mask), "a"), (f"np.array({mask})", "a"),
        ]
    )  # fmt: skip


@maker
def index(source: Random, shape: Shape) -> Plan | None:
    """Of all kinds, mixed. The operand's shape is drawn, and indices until one gives the wanted shape."""
    for _ in range(30):
        whole = source.choice([(3,), (4,), (2, 3), (3, 3), (3, 4), (2, 2, 3), (3, 2, 4), (2, 1, 3)])
        count = source.randint(1, len(whole))
        parts = [_index(source, n)[0] for n in whole[:count]]
        if source.random() < 0.15:
            parts.insert(source.randint(0, count), "None")
        if source.random() < 0.15:
            parts.append("...")
        text = ", ".join(parts)
        try:
            found = eval(f"a[{text}]", {"a": np.zeros(whole), "np": np})
        except IndexError:
            continue
        if found.shape == shape:
            code = compile(f"a[{text}]", "index", "eval")
            return Plan(f"{{0}}[{text}]", lambda a, code=code: eval(code, {"a": a, "np": np}), (whole,))
    return None


@maker
def index_of_a_join(source: Random, shape: Shape) -> Plan | None:
    """What rewrites look into."""
    for _ in range(10):
        rows = source.choice([(2, 2), (3,), (2, 3)])
        found = [_index(source, n)[0] for n in (2, *rows)[: source.randint(1, 1 + len(rows))]]
        if source.random() < 0.4:  # a number, a slice and a list: NumPy puts the list's axis first
            last = str([0, source.randint(-2, 1)])
            found = [str(source.randint(-2, 1)), *[":"] * (len(rows) - 1), last]
        parts = ", ".join(found)
        try:
            entries = eval(f"a[{parts}]", {"a": np.zeros((2, *rows)), "np": np})
        except IndexError:
            continue
        if entries.shape == shape:
            code = compile(f"a[{parts}]", "index", "eval")
            return Plan(
                f"tx.Stack({{0}}, {{1}})[{parts}]",
                lambda a, b, code=code: eval(code, {"a": np.stack([a, b]), "np": np}),
                (rows, rows),
            )
    return None


@maker
def batch(source: Random, shape: Shape) -> Plan | None:
    if not shape:
        return None
    n = source.choice([2, 3])
    found = [Plan("tx.Vmap(lambda row: row * row + {1}, batch={0})", lambda a, b: a * a + b, (shape, ()))]
    if len(shape) == 1:
        m = shape[0]
        found += [
            Plan("tx.Vmap(lambda row: tx.linalg.Sum(row), batch={0})", lambda a: a.sum(axis=-1), ((*shape, n),)),
            Plan("tx.Vmap(lambda c: c @ {1}, batch={0}, axis=1)", lambda a, b: a.T @ b, ((n, m), (n,))),
            Plan("tx.Vmap(lambda c: c[0] - c[1], batch={0}, axis=1)", lambda a: a[0] - a[1], ((max(m, 2), m),)),
            Plan("tx.Vmap(lambda a, b: a @ b, batch=[{0}, {1}])", lambda a, b: np.sum(a * b, axis=1), ((m, n), (m, n))),
            Plan("tx.Vmap(lambda a: tx.Linterp(a, [-1, 0.5, 3], [2.0, -1, 0.5]), batch={0})",
                 lambda a: np.interp(a, [-1, 0.5, 3], [2, -1, 0.5]), (shape,)),
        ]  # fmt: skip
    if len(shape) == 2:
        m, k = shape
        found += [
            Plan("tx.Vmap(lambda a: tx.Vmap(lambda b: a - 2.0 * b, batch={1}), batch={0})",
                 lambda a, b: a[:, None] - 2.0 * b[None], ((m,), (k,))),
            Plan("tx.Vmap(lambda c: c * {1}, batch={0}, axis=1)", lambda a, b: a.T * b, ((k, m), (k,))),
        ]  # fmt: skip
    return source.choice(found)


_KNOTS, _LINES = [-1.0, 0.25, 1.0, 3.0], [-2.0, 0.0, 1.5]
_TABLE = (np.arange(12.0).reshape(4, 3) ** 1.5 % 5.0).round(2).tolist()


def _cubic(method: str) -> Any:
    kind = {"cubic": scipy.interpolate.CubicSpline, "pchip": scipy.interpolate.PchipInterpolator}[method]
    return kind(_KNOTS, np.array(_TABLE)[:, 0])


def _bilinear(x: Any, y: Any) -> Any:
    points = np.stack(np.broadcast_arrays(np.clip(x, -1.0, 3.0), np.clip(y, -2.0, 1.5)), axis=-1)
    return scipy.interpolate.RegularGridInterpolator((_KNOTS, _LINES), _TABLE)(points).reshape(points.shape[:-1])


@maker
def table(source: Random, shape: Shape) -> Plan | None:
    found = [
        Plan(f"tx.Linterp({{0}}, {_KNOTS}, np.array({_TABLE})[:, 1])",
             lambda a: np.interp(a, _KNOTS, np.array(_TABLE)[:, 1]), (shape,)),
        Plan(f"tx.Bilerp({{0}}, {{1}}, {_KNOTS}, {_LINES}, {_TABLE})", _bilinear, (shape, ())),
        *(
            Plan(f'tx.Cinterp(tx.Tanh({{0}}), {_KNOTS}, np.array({_TABLE})[:, 0], "{method}")',
                 lambda a, method=method: _cubic(method)(np.tanh(a)), (shape,))
            for method in ("cubic", "pchip")
        ),
    ]  # fmt: skip
    if shape and shape[-1] == 3:
        found.append(
            Plan(
                f"tx.Linterp({{0}}, {_KNOTS}, {_TABLE})",
                lambda a: np.stack([np.interp(a, _KNOTS, column) for column in np.transpose(_TABLE)], axis=-1),
                (shape[:-1],),
            )
        )
    return source.choice(found)


def _hat(xi: Any) -> Any:
    v, w = xi[:3], xi[3:]
    return np.block([[np.cross(np.eye(3), w), v[:, None]], [np.zeros((1, 4))]])


def _adjoint(xi: Any) -> Any:
    v, w = np.cross(np.eye(3), xi[:3]), np.cross(np.eye(3), xi[3:])
    return np.block([[w, v], [np.zeros((3, 3)), w]])


def _exp(xi: Any) -> Any:
    return scipy.linalg.expm(np.asarray(_hat(xi), float))


def _big_adjoint(xi: Any) -> Any:
    return scipy.linalg.expm(np.asarray(_adjoint(xi), float))


def _phi(A: Any) -> Any:
    """sum A^k / (k + 1)!, by the exponential of a larger matrix."""
    n = len(A)
    whole = np.block([[np.asarray(A, float), np.eye(n)], [np.zeros((n, 2 * n))]])
    return scipy.linalg.expm(whole)[:n, n:]


@maker
def lie(source: Random, shape: Shape) -> Plan | None:
    """Against exponentials of matrices, on twists of at most one radian."""
    small = "tx.Tanh({0})"
    tanh = np.tanh
    found: dict[Shape, list[Plan]] = {
        (6,): [
            Plan("tx.lie.Adjoint({0}, {1})", lambda a, b: _adjoint(a) @ b, ((6,), (6,))),
            Plan("tx.lie.AdjointDual({0}, {1})", lambda a, b: -_adjoint(a).T @ b, ((6,), (6,))),
            Plan(
                f"(tx.lie.SE3Adjoint(tx.lie.SE3Exp({small})) @ {{1}})",
                lambda a, b: _big_adjoint(tanh(a)) @ b,
                ((6,), (6,)),
            ),
            Plan(
                f"(tx.lie.SE3AdjointDual(tx.lie.SE3Exp({small})) @ {{1}})",
                lambda a, b: np.linalg.inv(_big_adjoint(tanh(a))).T @ b,
                ((6,), (6,)),
            ),
            Plan(f"tx.lie.SE3Log(tx.lie.SE3Exp({small}))", lambda a: tanh(a), ((6,),)),
            *(
                Plan(
                    f"tx.lie.{name}(tx.lie.twist(linear=np.zeros(3), angular={{0}}, order={order}), "
                    f"{{1}}, order={order})",
                    lambda a, b, matrix=matrix, roll=roll: np.roll(
                        matrix(np.append(np.zeros(3), a)) @ np.roll(b, roll), roll
                    ),
                    ((3,), (6,)),
                )
                for name, matrix in (("Adjoint", _adjoint), ("AdjointDual", lambda a: -_adjoint(a).T))
                for order, roll in (("tx.LINEAR_FIRST", 0), ("tx.ANGULAR_FIRST", 3))
            ),
            *(
                Plan(
                    f"tx.lie.{name}({{0}}, {{1}}, order=tx.ANGULAR_FIRST)",
                    lambda a, b, matrix=matrix: np.roll(matrix(np.roll(a, 3)) @ np.roll(b, 3), 3),
                    ((6,), (6,)),
                )
                for name, matrix in (("Adjoint", _adjoint), ("AdjointDual", lambda a: -_adjoint(a).T))
            ),
            Plan(
                f"tx.linalg.Solve(tx.lie.SE3Adjoint(tx.lie.SE3Exp({small})), {{1}})",
                lambda a, b: np.linalg.solve(_big_adjoint(tanh(a)), b),
                ((6,), (6,)),
            ),
            Plan("tx.lie.twist(linear={0}, angular={1})", lambda a, b: np.concatenate([a, b]), ((3,), (3,))),
        ],
        (3,): [
            Plan("tx.linalg.Cross({0}, {1})", np.cross, ((3,), (3,))),
            Plan("np.cross({0}, {1})", np.cross, ((3,), (3,))),
            Plan(
                f"tx.lie.Act(tx.lie.SE3Exp({small}), {{1}})",
                lambda a, b: _exp(tanh(a))[:3, :3] @ b + _exp(tanh(a))[:3, 3],
                ((6,), (3,)),
            ),
            Plan(f"tx.lie.SO3Log(tx.lie.SO3Exp({small}))", tanh, ((3,),)),
            Plan("tx.lie.linear({0})", lambda a: a[:3], ((6,),)),
            Plan("tx.lie.angular({0})", lambda a: a[3:], ((6,),)),
        ],
        (3, 3): [
            Plan(
                "tx.pose(euler={0}, sequence='ZXZ')[:3, :3]",
                lambda a: Rotation.from_euler("ZXZ", a).as_matrix(),
                ((3,),),
            ),
            Plan(
                "tx.lie.EulerRotation(tx.lie.euler(tx.lie.SO3Exp({0})))",
                lambda a: Rotation.from_rotvec(a).as_matrix(),
                ((3,),),
            ),
            Plan(
                f"tx.lie.SO3Exp({small})",
                lambda a: scipy.linalg.expm(np.asarray(np.cross(np.eye(3), tanh(a)), float)),
                ((3,),),
            ),
        ],
        (4, 4): [
            Plan(f"tx.lie.SE3Exp({small})", lambda a: _exp(tanh(a)), ((6,),)),
            Plan(
                f"tx.lie.Inverse(tx.lie.SE3Exp({small}))",
                lambda a: np.linalg.inv(_exp(tanh(a))),
                ((6,),),
            ),
            Plan("tx.lie.Hat({0})", _hat, ((6,),)),
        ],
        (6, 6): [
            Plan(
                f"(tx.lie.LeftJacobian({small}) @ tx.lie.LeftJacobianInverse({small}))",
                lambda a: np.eye(6),
                ((6,),),
            ),
            Plan(f"tx.lie.RightJacobian({small})", lambda a: _phi(-_adjoint(tanh(a))), ((6,),)),
            Plan(f"tx.lie.LeftJacobian({small})", lambda a: _phi(_adjoint(tanh(a))), ((6,),)),
            Plan(f"tx.lie.SE3Adjoint(tx.lie.SE3Exp({small}))", lambda a: _big_adjoint(tanh(a)), ((6,),)),
        ],
    }
    return source.choice(found[shape]) if shape in found else None


MAKERS.extend([lie, lie])  # of the shapes that it gives few come
