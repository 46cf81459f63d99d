"""How operations are written in LLVM's intermediate language: instructions on vectors.

A form takes the `Code` that instructions go to, LLVM's name of the type of one lane, and the values of the arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from .operation import Forms

__all__ = ["NAMES", "call", "converted", "instruction", "library", "negative", "not_of", "paired", "same", "selected"]

Form: TypeAlias = Callable[..., str]

#: LLVM's names of the types that numbers may have.
NAMES: dict[np.dtype[Any], str] = {
    np.dtype(np.float64): "double",
    np.dtype(np.float32): "float",
    np.dtype(np.int64): "i64",
    np.dtype(np.int32): "i32",
    np.dtype(bool): "i1",
}


def instruction(name: str) -> Form:
    """Of one or two vectors of a type."""
    return lambda code, kind, *a: code.emit(f"{name} {code.vector(kind)} {', '.join(a)}")


def call(name: str) -> Form:
    """One of LLVM's own functions of vectors."""
    return lambda code, kind, *arguments: code.call(name, kind, *arguments)


def library(name: str) -> Form:
    """A function of the C library, lane by lane."""
    return lambda code, kind, *arguments: code.library(name, kind, *arguments)


def paired(place: int) -> Form:
    """Sine (0) or cosine (1) of an angle of which both are there already."""
    return lambda code, kind, x: code.turned[x][place]


def same(code: Any, kind: str, x: str) -> str:
    return x


def selected(code: Any, kind: str, c: str, a: str, b: str) -> str:
    return code.select(kind, c, a, b)


def larger(comparison: str) -> Form:
    """NaN where one of them is."""

    def form(code: Any, kind: str, a: str, b: str) -> str:
        first = chosen(f"fcmp {comparison}")(code, kind, a, b)
        return code.select(kind, instruction("fcmp uno")(code, kind, a, a), a, first)

    return form


def chosen(comparison: str) -> Form:
    """a where it compares so with b, else b."""
    return lambda code, kind, a, b: code.select(kind, instruction(comparison)(code, kind, a, b), a, b)


def clamped(larger: Form, smaller: Form) -> Form:
    return lambda code, kind, low, x, high: smaller(code, kind, larger(code, kind, low, x), high)


def sign(code: Any, kind: str, x: str) -> str:
    """Zero, with its sign, and NaN as they are."""
    one = code.call("copysign", kind, code.constant(kind, 1.0), x)
    return code.select(kind, instruction("fcmp one")(code, kind, x, code.constant(kind, 0.0)), one, x)


def finite(code: Any, kind: str, x: str) -> str:
    size = code.call("fabs", kind, x)
    return instruction("fcmp olt")(code, kind, size, code.constant(kind, np.inf))


def logistic(code: Any, kind: str, x: str) -> str:
    one = code.constant(kind, 1.0)
    exp = code.library("exp", kind, instruction("fneg")(code, kind, x))
    return code.binary("fdiv", kind, one, code.binary("fadd", kind, one, exp))


def negative(code: Any, kind: str, x: str) -> str:
    return code.binary("sub", kind, "zeroinitializer", x)


def magnitude(code: Any, kind: str, x: str) -> str:
    return chosen("icmp sgt")(code, kind, x, negative(code, kind, x))


def integer_sign(code: Any, kind: str, x: str) -> str:
    below = code.binary("ashr", kind, x, code.constant(kind, 31 if kind == "i32" else 63))
    above = instruction("icmp sgt")(code, kind, x, "zeroinitializer")
    return code.binary("or", kind, below, code.convert("zext", "i1", kind, above))


def not_of(ones: Any) -> Form:
    """All bits the other way; `ones` is the number of which all are set."""
    return lambda code, kind, x: code.binary("xor", kind, x, code.constant(kind, ones))


def converted(dtype: np.dtype[Any]) -> Forms:
    """To a type, as JAX does: to the nearest integer that there is, and to truth where it is not zero."""
    target = NAMES.get(dtype)
    if target is None:
        return Forms()
    if dtype.kind == "b":
        return Forms(_nonzero("fcmp une"), _nonzero("icmp ne"), same)
    if dtype.kind == "f":
        wider = "fpext" if target == "double" else "fptrunc"
        return Forms(_cast(wider, target), _cast("sitofp", target), _cast("uitofp", target))
    return Forms(_whole(target), _cast("sext" if target == "i64" else "trunc", target), _cast("zext", target))


def _nonzero(comparison: str) -> Form:
    return lambda code, kind, x: instruction(comparison)(code, kind, x, "zeroinitializer")


def _cast(name: str, target: str) -> Form:
    return lambda code, kind, x: x if kind == target else code.convert(name, kind, target, x)


def _whole(target: str) -> Form:
    def form(code: Any, kind: str, x: str) -> str:
        ends = f"v{code.lanes}{target}.v{code.lanes}{'f64' if kind == 'double' else 'f32'}"
        own, result = code.vector(kind), code.vector(target)
        code.module.declarations.add(f"declare {result} @llvm.fptosi.sat.{ends}({own})")
        return code.emit(f"call {result} @llvm.fptosi.sat.{ends}({own} {x})")

    return form
