"""The table of operations on scalars."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax import lax

from .entry import Forms, Operation, Select, Slope, code, convert, default, everywhere, quotient, remainder, whole
from .interface import Graph

_BOOL = np.dtype(bool)


def on(g: Graph, name: str, *arguments: int) -> int:
    """The node of the operation of a name."""
    return g.node(OPERATIONS[name], *arguments)


# ---- how they are written --------------------------------------------------------------------------------------------


_instruction, _intrinsic, _chosen = (functools.partial(code, name) for name in ("instruction", "intrinsic", "chosen"))


def _python(function: Any) -> Forms:
    """CasADi's expressions have Python's operators."""
    return everywhere(lambda casadi, *a: function(*a))


def _named(name: str, number: Any, arity: int = 1, *, array: Any = None, **more: Any) -> Operation:
    """An operation with one name in JAX, the C library and CasADi, unless given otherwise."""
    operands = ", ".join(["$a", "$b"][:arity])
    by_name = {
        "exact": True,
        "llvm": Forms(code("library", name)),
        "c": Forms(f"{name}$f({operands})"),
        "casadi": everywhere(lambda casadi, *a: getattr(casadi, name)(*a)),
    }
    return Operation(name=name, number=number, array=array or getattr(lax, name), arity=arity, **{**by_name, **more})


#: Of which NumPy may round the results otherwise than XLA.
_rough = functools.partial(_named, exact=False)


def _ring(sign: str, name: str, number: Any, partials: Any, **more: Any) -> Operation:
    """Integers wrap around. LLVM's "contract" lets a product and a sum be one instruction."""
    return _named(
        name,
        number,
        2,
        partials=partials,
        symmetric=sign != "-",
        maker=operator.attrgetter(name),
        llvm=Forms(_instruction(f"f{name} contract"), _instruction(name)),
        c=Forms(f"$a {sign} $b", f"($T)(($U)$a {sign} ($U)$b)"),
        casadi=_python(getattr(operator, name)),
        **more,
    )


def _function(name: str, number: Any, slope: Callable[[Graph, int, int], Slope], **more: Any) -> Operation:
    """A function of one real number; `slope` of (graph, x, y) is the derivative of y by x."""
    # JAX lets some of them be asked for another accuracy.
    more = {"exact": False, "takes": "|accuracy", "when": default("accuracy"), **more}
    return _named(name, number, partials=lambda g, a, y: [slope(g, a[0], y)], **more)


def _comparison(sign: str, name: str, number: Any, **more: Any) -> Operation:
    """False where one is NaN, but for `ne`. Truth values have an order too."""
    equality = name in ("eq", "ne")
    real = "une" if name == "ne" else f"o{name}"
    signed, unsigned = (name, name) if equality else (f"s{name}", f"u{name}")
    return _named(
        name,
        number,
        2,
        result=_BOOL,
        symmetric=equality,
        llvm=Forms(*map(_instruction, (f"fcmp {real}", f"icmp {signed}", f"icmp {unsigned}"))),
        c=everywhere(f"$a {sign} $b"),
        casadi=_python(getattr(operator, name)),
        **more,
    )


def _bits(bit: str, truth: str, name: str, casadi: str, **more: Any) -> Operation:
    """Of integers bit by bit, or of truth values, by C's signs. CasADi has no bits of integers."""
    return _named(
        name,
        getattr(np, f"bitwise_{name}"),
        2,
        array=getattr(lax, f"bitwise_{name}"),
        symmetric=True,
        llvm=Forms(None, _instruction(name), _instruction(name)),
        c=Forms(None, f"($T)($a {bit} $b)", f"$a {truth} $b"),
        casadi=Forms(None, None, lambda module, a, b: getattr(module, casadi)(a, b)),
        **more,
    )


def _extreme(name: str, number: Any, than: str, instruction: str, sign: str) -> Operation:
    """The larger or the smaller, NaN where one of them is; derivatives are halves where they are equal."""

    def partials(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
        tie = g.select(on(g, "eq", *a), g.constant(0.5), g.zero)
        first = g.select(on(g, than, *a), g.one, tie)
        return [first, g.sub(g.one, first)]

    compare = {"gt": ">", "lt": "<"}[than]
    return _named(
        name,
        number,
        2,
        partials=partials,
        symmetric=True,
        llvm=Forms(code("further", f"fcmp o{than}"), _chosen(f"icmp s{than}"), _instruction(instruction)),
        c=Forms(f"($a {compare} $b || isnan($a)) ? $a : $b", f"$a {compare} $b ? $a : $b", f"$a {sign} $b"),
        casadi=everywhere(lambda casadi, *a: getattr(casadi, f"f{name}")(*a)),
    )


def _of_many(name: str, pair: str) -> Operation:
    """The largest or smallest of three and more; equal ones share the derivative, as after JAX's reductions."""
    two = OPERATIONS[pair]

    def partials(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
        equal = [g.select(on(g, "eq", x, y), g.one, g.zero) for x in a]
        share = g.div(g.one, functools.reduce(g.add, equal))
        return [g.mul(is_extreme, share) for is_extreme in equal]

    return Operation(
        name=name,
        number=lambda *a: functools.reduce(two.number, a),
        array=lambda *a: functools.reduce(two.array, a),
        partials=partials,
        written=lambda g: lambda *a: functools.reduce(functools.partial(g.node, two), a),
    )


# ---- derivatives and nodes -------------------------------------------------------------------------------------------


def _quotient_slopes(g: Graph, a: tuple[int, ...], y: int) -> Sequence[Slope]:
    """Of y = a / b: 1 / b, and -y (1 / b) as two factors: 1 / b^2 may be zero where y t / b is not."""
    inverse = _inverse(g, a[1])
    return [inverse, (g.neg(y), inverse)]


def _remainder(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """Of x - n y, n the whole part of x / y."""
    ratio = g.div(*a)
    return [g.one, g.neg(g.mul(on(g, "sign", ratio), on(g, "floor", on(g, "abs", ratio))))]


def _clamped(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    """Zero at the limits themselves."""
    low, x, high = a
    inside = on(g, "and", on(g, "gt", x, low), on(g, "lt", x, high))
    conditions = (on(g, "gt", low, x), inside, on(g, "lt", high, x))
    return [g.select(condition, g.one, g.zero) for condition in conditions]


def _power(g: Graph, a: tuple[int, ...], y: int) -> Sequence[Slope]:
    """n x^(n-1), for negative n as n y / x: x^(n-1) may be zero in floating point where n y t / x is not."""
    x, n = a
    negative = on(g, "lt", n, g.zero)
    lower = on(g, "pow", x, g.select(on(g, "eq", n, g.zero), g.one, g.sub(n, g.one)))
    base = g.select(on(g, "eq", x, g.zero), g.one, x)
    weight = g.mul(n, g.select(negative, y, lower))
    return [(weight, g.select(negative, _inverse(g, x), g.one)), g.mul(on(g, "log", base), y)]


def _angle(g: Graph, a: tuple[int, ...], y: int) -> Sequence[int | None]:
    inverse = _inverse(g, g.add(g.mul(a[0], a[0]), g.mul(a[1], a[1])))
    return [g.mul(a[1], inverse), g.neg(g.mul(a[0], inverse))]


def _square_plus(g: Graph, x: int) -> int:
    """1 + x^2."""
    return g.add(g.one, g.mul(x, x))


def _beside_one(g: Graph, x: int) -> int:
    """1 - x^2, without cancellation near one."""
    return g.mul(g.sub(g.one, x), g.add(g.one, x))


def _inverse(g: Graph, x: int) -> int:
    return g.div(g.one, x)


def inverse_root(g: Graph, x: int) -> int:
    """1 / sqrt(x)."""
    return g.div(g.one, on(g, "sqrt", x))


def _power_node(g: Graph, x: int, n: int) -> int:
    """The exponent may be an integer."""
    return on(g, "pow", x, n if g.dtypes[n] == g.dtypes[x] else g.node(convert(g.dtypes[x]), n))


def _greater(g: Graph, a: int, b: int) -> int:
    """a > b; false for the structural zero a, so that it never becomes a pivot."""
    never = a == g.zero and g.operation(b) is OPERATIONS["abs"]
    return g.constant(False, _BOOL) if never else on(g, "gt", a, b)


def _pair(name: str, absorbing: bool, g: Graph, a: int, b: int) -> int:
    """and, or: of truth values with what is known left out; of integers bit by bit."""
    for x, y in ((a, b), (b, a)) if g.dtypes[a] == _BOOL else ():
        if g.numbers[x] is not None:
            return x if bool(g.numbers[x]) is absorbing else y
    return a if a == b else on(g, name, a, b)


def _made(function: Any, *first: Any) -> Any:
    """A maker of nodes by function(*first, graph, *arguments)."""
    return lambda g: functools.partial(function, *first, g)


# ---- the rows --------------------------------------------------------------------------------------------------------

_ROWS = [
    _ring("+", "add", np.add, lambda g, a, y: [g.one, g.one]),
    _ring("-", "sub", np.subtract, lambda g, a, y: [g.one, g.constant(-1.0)]),
    _ring("*", "mul", np.multiply, lambda g, a, y: [a[1], a[0]], takes="out_dtype", when=default("out_dtype")),
    _named(
        "div",
        quotient,
        2,
        partials=_quotient_slopes,
        maker=operator.attrgetter("div"),
        llvm=Forms(_instruction("fdiv")),  # of integers by zero it ends the process
        c=Forms(
            "$a / $b",
            "($T)($b == 0 ? -1 : $b == -1 ? ($T)(0U - ($U)$a) : ($T)($a / $b))",
            unsigned="($T)($b == 0 ? ($T)-1 : ($T)($a / $b))",
        ),
        casadi=Forms(lambda casadi, a, b: a / b, lambda casadi, a, b: whole(casadi, a / b)),
    ),
    _named(
        "neg",
        np.negative,
        partials=lambda g, a, y: [g.constant(-1.0)],
        maker=operator.attrgetter("neg"),
        llvm=Forms(_instruction("fneg"), code("negative")),
        c=Forms("-$a", "($T)(0U - ($U)$a)"),
        casadi=_python(operator.neg),
    ),
    _named(
        "abs",
        np.abs,
        partials=lambda g, a, y: [g.select(on(g, "ge", a[0], g.zero), g.one, g.constant(-1.0))],  # 1 at zero
        parity=1,
        llvm=Forms(_intrinsic("fabs"), code("magnitude")),
        c=Forms("fabs$f($a)", "$a < 0 ? ($T)(0U - ($U)$a) : $a", unsigned="$a"),
        casadi=everywhere(lambda casadi, a: casadi.fabs(a)),
    ),
    _named(
        "sign",
        np.sign,
        parity=-1,
        llvm=Forms(code("sign"), code("integer_sign")),
        c=Forms("$a > 0 ? 1 : $a < 0 ? -1 : $a", "($T)($a > 0 ? 1 : $a < 0 ? -1 : 0)", unsigned="$a > 0 ? 1 : 0"),
    ),
    _named("floor", np.floor, llvm=Forms(_intrinsic("floor"))),
    _named("ceil", np.ceil, llvm=Forms(_intrinsic("ceil"))),
    _named(
        "rem",
        remainder,
        2,
        partials=_remainder,
        llvm=Forms(code("library", "fmod")),
        c=Forms(
            "fmod$f($a, $b)",
            "($T)($b == 0 ? $a : $b == -1 ? 0 : $a % $b)",
            unsigned="($T)($b == 0 ? $a : $a % $b)",
        ),
        casadi=everywhere(lambda casadi, a, b: casadi.fmod(a, b)),
    ),
    _extreme("max", np.maximum, "gt", "or", "||"),
    _extreme("min", np.minimum, "lt", "and", "&&"),
    _named(
        "clamp",
        lambda low, x, high: np.minimum(np.maximum(low, x), high),
        3,
        array=lambda low, x, high: lax.clamp(low, x, high),
        partials=_clamped,
        llvm=Forms(
            lambda code, kind, a, b, c: code.further("fcmp olt", kind, code.further("fcmp ogt", kind, a, b), c),
            lambda code, kind, a, b, c: code.chosen("icmp slt", kind, code.chosen("icmp sgt", kind, a, b), c),
        ),
        c=Forms(
            "($a > $b || isnan($a)) ? (($a < $c || isnan($a)) ? $a : $c) : (($b < $c || isnan($b)) ? $b : $c)",
            "$a > $b ? ($a < $c ? $a : $c) : ($b < $c ? $b : $c)",
        ),
        casadi=everywhere(lambda casadi, low, x, high: casadi.fmin(casadi.fmax(low, x), high)),
    ),
    # ---- elementary functions
    _rough("pow", np.power, 2, partials=_power, is_power=True, maker=_made(_power_node), casadi=_python(operator.pow)),
    _rough("atan2", np.arctan2, 2, partials=_angle),
    _function(
        "sqrt", np.sqrt, lambda g, x, y: (g.one, _inverse(g, g.add(y, y))), exact=True, llvm=Forms(_intrinsic("sqrt"))
    ),
    _function(
        "cbrt",
        np.cbrt,
        lambda g, x, y: (g.one, g.div(g.constant(1.0 / 3.0), g.mul(y, y))),
        parity=-1,
        casadi=everywhere(lambda casadi, a: casadi.sign(a) * casadi.fabs(a) ** (1.0 / 3.0)),
    ),
    _function("exp", np.exp, lambda g, x, y: y, llvm=Forms(code("exponential"))),
    _function(
        "exp2",
        np.exp2,
        lambda g, x, y: g.mul(g.constant(float(np.log(2.0))), y),
        casadi=everywhere(lambda casadi, a: 2.0**a),
    ),
    _function("expm1", np.expm1, lambda g, x, y: g.add(y, g.one), llvm=Forms(code("exponential_less_one"))),
    _function("log", np.log, lambda g, x, y: (g.one, _inverse(g, x))),
    _function("log1p", np.log1p, lambda g, x, y: _inverse(g, g.add(g.one, x))),
    _function(
        "logistic",
        lambda x: 1.0 / (1.0 + np.exp(-x)),
        lambda g, x, y: g.mul(y, g.sub(g.one, y)),
        llvm=Forms(code("logistic")),
        c=Forms("1 / (1 + exp$f(-$a))"),
        casadi=everywhere(lambda casadi, a: 1.0 / (1.0 + casadi.exp(-a))),
    ),
    _function("sin", np.sin, lambda g, x, y: on(g, "cos", x), parity=-1, llvm=Forms(code("turned", 0))),
    _function("cos", np.cos, lambda g, x, y: g.neg(on(g, "sin", x)), parity=1, llvm=Forms(code("turned", 1))),
    _function("tan", np.tan, lambda g, x, y: _square_plus(g, y), parity=-1),
    _function("asin", np.arcsin, lambda g, x, y: inverse_root(g, _beside_one(g, x)), parity=-1),
    _function("acos", np.arccos, lambda g, x, y: g.neg(inverse_root(g, _beside_one(g, x)))),
    _function("atan", np.arctan, lambda g, x, y: _inverse(g, _square_plus(g, x)), parity=-1),
    _function("sinh", np.sinh, lambda g, x, y: on(g, "cosh", x), parity=-1),
    _function("cosh", np.cosh, lambda g, x, y: on(g, "sinh", x), parity=1),
    _function("tanh", np.tanh, lambda g, x, y: _beside_one(g, y), parity=-1, llvm=Forms(code("hyperbolic_tangent"))),
    _function("asinh", np.arcsinh, lambda g, x, y: inverse_root(g, _square_plus(g, x)), parity=-1),
    _function("acosh", np.arccosh, lambda g, x, y: inverse_root(g, g.mul(g.sub(x, g.one), g.add(x, g.one)))),
    _function("atanh", np.arctanh, lambda g, x, y: _inverse(g, _beside_one(g, x)), parity=-1),
    # ---- logic
    _comparison("==", "eq", np.equal),
    _comparison("!=", "ne", np.not_equal),
    _comparison("<", "lt", np.less),
    _comparison("<=", "le", np.less_equal),
    _comparison(">", "gt", np.greater, maker=_made(_greater)),
    _comparison(">=", "ge", np.greater_equal),
    _named(
        "is_finite",
        np.isfinite,
        result=_BOOL,
        llvm=Forms(code("finite")),
        c=Forms("isfinite($a) != 0"),
        casadi=everywhere(lambda casadi, a: casadi.fabs(a) < np.inf),
    ),
    _bits("&", "&&", "and", "logic_and", maker=_made(_pair, "and", False)),
    _bits("|", "||", "or", "logic_or", maker=_made(_pair, "or", True)),
    _bits("^", "!=", "xor", "ne"),
    _named(
        "not",
        np.invert,
        array=lax.bitwise_not,
        llvm=Forms(None, code("inverted", -1), code("inverted", True)),
        c=Forms(None, "($T)(~$a)", "!$a"),
        casadi=Forms(None, None, lambda casadi, a: casadi.logic_not(a)),
    ),
    Operation(
        name="stop_gradient",
        number=np.positive,
        array=lambda x: x,
        maker=lambda g: lambda x: x if g.numbers[x] is not None else on(g, "stop_gradient", x),
        moves=True,
        llvm=everywhere(lambda code, kind, x: x),
        c=everywhere("$a"),
        # Where JAX stops, a rule of its own takes over; CasADi differentiates what the rule stands for.
        casadi=everywhere(lambda casadi, a: a),
    ),
    Select(
        name="select",  # JAX's own, of many cases, is `select_n`
        number=np.where,
        array=lambda c, a, b: lax.select(c, a, b),
        arity=3,
        maker=operator.attrgetter("select"),
        llvm=everywhere(code("select")),
        c=Forms("$a ? $b : $c", "($T)($a ? $b : $c)", "$a ? $b : $c"),
        casadi=everywhere(lambda casadi, c, a, b: casadi.if_else(c, a, b)),
    ),
]

#: By name.
OPERATIONS: dict[str, Operation] = {operation.name: operation for operation in _ROWS}

LARGEST, SMALLEST = _of_many("largest", "max"), _of_many("smallest", "min")
