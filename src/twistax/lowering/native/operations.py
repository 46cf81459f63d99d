"""The operations of scalar programs as instructions on vectors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..scalar.operations import Convert, Operation, by_primitive
from .code import NAMES, Code, NotNative

__all__ = ["TURNING", "check", "instructions"]

#: From the type of the arguments and their values to the value of the result.
Rule = Callable[..., str]


def instructions(code: Code, operation: Operation, kinds: Sequence[str], arguments: Sequence[str]) -> str:
    """The value of an operation on values of these types.

    Raises:
        NotNative: there is no rule for it.
    """
    if isinstance(operation, Convert):
        return _convert(code, kinds[0], NAMES[np.dtype(operation.result)], arguments[0])
    return _rule(operation, kinds)(code, kinds[-1], *arguments)


def check(operation: Operation, kinds: Sequence[str]) -> None:
    """Raises NotNative where there is no rule."""
    turning = operation in TURNING and kinds[0] in _REAL
    if not turning and not isinstance(operation, Convert):
        _rule(operation, kinds)


def _rule(operation: Operation, kinds: Sequence[str]) -> Rule:
    table = _OF_REALS if kinds[-1] in _REAL else _OF_TRUTH if kinds[-1] == "i1" else _OF_INTEGERS
    rule = _ON_ALL.get(operation) or table.get(operation)
    if rule is None:
        raise NotNative(f"{operation.name} of {kinds[-1]} has no native form")
    return rule


_REAL = ("double", "float")

#: Worked out several at a time, by `sines_and_cosines`.
TURNING = (by_primitive["sin"], by_primitive["cos"])


def _named(**rules: Rule) -> dict[Operation, Rule]:
    return {by_primitive[name.rstrip("_")]: rule for name, rule in rules.items()}


def _binary(name: str) -> Rule:
    return lambda code, kind, a, b: code.binary(name, kind, a, b)


def _call(name: str) -> Rule:
    return lambda code, kind, *arguments: code.call(name, kind, *arguments)


def _library(name: str) -> Rule:
    return lambda code, kind, *arguments: code.library(name, kind, *arguments)


def _compare(name: str) -> Rule:
    return lambda code, kind, a, b: code.emit(f"{name} {code.vector(kind)} {a}, {b}")


def _larger(comparison: str) -> Rule:
    """Not a number where one of them is not."""

    def rule(code: Code, kind: str, a: str, b: str) -> str:
        first = code.select(kind, code.emit(f"fcmp {comparison} {code.vector(kind)} {a}, {b}"), a, b)
        return code.select(kind, code.emit(f"fcmp uno {code.vector(kind)} {a}, {a}"), a, first)

    return rule


_MAX, _MIN = _larger("ogt"), _larger("olt")


def _sign(code: Code, kind: str, x: str) -> str:
    """Zero, with its sign, and what is not a number as they are."""
    own = code.vector(kind)
    one = code.call("copysign", kind, code.constant(kind, 1.0), x)
    return code.select(kind, code.emit(f"fcmp one {own} {x}, {code.constant(kind, 0.0)}"), one, x)


def _finite(code: Code, kind: str, x: str) -> str:
    size = code.call("fabs", kind, x)
    return code.emit(f"fcmp olt {code.vector(kind)} {size}, {code.constant(kind, np.inf)}")


def _logistic(code: Code, kind: str, x: str) -> str:
    one = code.constant(kind, 1.0)
    exp = code.library("exp", kind, code.emit(f"fneg {code.vector(kind)} {x}"))
    return code.binary("fdiv", kind, one, code.binary("fadd", kind, one, exp))


def _integer_sign(code: Code, kind: str, x: str) -> str:
    below = code.binary("ashr", kind, x, code.constant(kind, 31 if kind == "i32" else 63))
    above = code.emit(f"icmp sgt {code.vector(kind)} {x}, zeroinitializer")
    return code.binary("or", kind, below, code.convert("zext", "i1", kind, above))


def _integer_abs(code: Code, kind: str, x: str) -> str:
    return _chosen("sgt")(code, kind, x, code.binary("sub", kind, "zeroinitializer", x))


def _chosen(comparison: str) -> Rule:
    def rule(code: Code, kind: str, a: str, b: str) -> str:
        return code.select(kind, code.emit(f"icmp {comparison} {code.vector(kind)} {a}, {b}"), a, b)

    return rule


_ON_ALL = _named(
    stop_gradient=lambda code, kind, x: x,
    select=lambda code, kind, c, a, b: code.select(kind, c, a, b),
)

# "contract" lets a product and a sum be one instruction.
_OF_REALS = _named(
    add=_binary("fadd contract"),
    sub=_binary("fsub contract"),
    mul=_binary("fmul contract"),
    div=_binary("fdiv"),
    neg=lambda code, kind, x: code.emit(f"fneg {code.vector(kind)} {x}"),
    abs=_call("fabs"),
    sqrt=_call("sqrt"),
    floor=_call("floor"),
    ceil=_call("ceil"),
    sign=_sign,
    max=_MAX,
    min=_MIN,
    clamp=lambda code, kind, low, x, high: _MIN(code, kind, _MAX(code, kind, low, x), high),
    rem=_library("fmod"),
    logistic=_logistic,
    eq=_compare("fcmp oeq"),
    ne=_compare("fcmp une"),
    lt=_compare("fcmp olt"),
    le=_compare("fcmp ole"),
    gt=_compare("fcmp ogt"),
    ge=_compare("fcmp oge"),
    is_finite=_finite,
    **{name: _library(name) for name in ("pow", "atan2", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "tan")},
    **{name: _library(name) for name in ("asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh")},
)

_BITS = _named(and_=_binary("and"), or_=_binary("or"), xor=_binary("xor"))
_EQUAL = _named(eq=_compare("icmp eq"), ne=_compare("icmp ne"))

_OF_TRUTH = (
    _BITS
    | _EQUAL
    | _named(
        not_=lambda code, kind, x: code.binary("xor", kind, x, code.constant(kind, True)),
        lt=_compare("icmp ult"),
        le=_compare("icmp ule"),
        gt=_compare("icmp ugt"),
        ge=_compare("icmp uge"),
        max=_binary("or"),
        min=_binary("and"),
    )
)

# Division is not among them: by zero it ends the process.
_OF_INTEGERS = (
    _BITS
    | _EQUAL
    | _named(
        add=_binary("add"),
        sub=_binary("sub"),
        mul=_binary("mul"),
        neg=lambda code, kind, x: code.binary("sub", kind, "zeroinitializer", x),
        abs=_integer_abs,
        sign=_integer_sign,
        max=_chosen("sgt"),
        min=_chosen("slt"),
        clamp=lambda code, kind, low, x, high: _chosen("slt")(code, kind, _chosen("sgt")(code, kind, low, x), high),
        not_=lambda code, kind, x: code.binary("xor", kind, x, code.constant(kind, -1)),
        lt=_compare("icmp slt"),
        le=_compare("icmp sle"),
        gt=_compare("icmp sgt"),
        ge=_compare("icmp sge"),
    )
)


def _convert(code: Code, source: str, target: str, x: str) -> str:
    """To another type, as JAX does: to the nearest integer that there is, and to truth where it is not zero."""
    if source == target:
        return x
    if target == "i1":
        if source in _REAL:
            return code.emit(f"fcmp une {code.vector(source)} {x}, zeroinitializer")
        return code.emit(f"icmp ne {code.vector(source)} {x}, zeroinitializer")
    if target in _REAL:
        if source in _REAL:
            return code.convert("fpext" if target == "double" else "fptrunc", source, target, x)
        return code.convert("uitofp" if source == "i1" else "sitofp", source, target, x)
    if source in _REAL:
        ends = f"v{code.lanes}{target}.v{code.lanes}{'f64' if source == 'double' else 'f32'}"
        own, result = code.vector(source), code.vector(target)
        code.module.declarations.add(f"declare {result} @llvm.fptosi.sat.{ends}({own})")
        return code.emit(f"call {result} @llvm.fptosi.sat.{ends}({own} {x})")
    if source == "i1":
        return code.convert("zext", source, target, x)
    return code.convert("sext" if target == "i64" else "trunc", source, target, x)
