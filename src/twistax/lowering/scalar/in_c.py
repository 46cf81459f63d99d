"""How types, numbers and operations are written in C99.

Real numbers follow the operations' meaning in JAX, also where libm's function of the name differs: max and min pass
NaN on. Integers wrap around and never divide by zero, as XLA's. A form takes the type of the arguments and their text.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from decimal import Decimal
from typing import Any, TypeAlias

import numpy as np

from ...errors import ModelError
from .operation import Forms

__all__ = ["CType", "Written", "c_type", "converted", "function", "helper", "infix", "prefix", "same", "wrapped"]


@dataclasses.dataclass(frozen=True)
class CType:
    """A scalar type of C and the NumPy type that it is."""

    name: str
    dtype: np.dtype[Any]

    @property
    def real(self) -> bool:
        return self.dtype.kind == "f"

    @property
    def boolean(self) -> bool:
        return self.dtype.kind == "b"

    @property
    def suffix(self) -> str:
        """Of functions of libm and of literals."""
        return "f" if self.dtype == np.float32 else ""

    @property
    def unsigned(self) -> str:
        """The type in which integers of this one are added without overflow."""
        return "uint64_t" if self.dtype.itemsize == 8 else "uint32_t"

    @property
    def least(self) -> int:
        return int(np.iinfo(self.dtype).min)

    @property
    def most(self) -> int:
        return int(np.iinfo(self.dtype).max)

    def literal(self, value: Any) -> str:
        """A number as an operand; negative ones in parentheses.

        Real numbers stand in decimals where these are short and exactly the number, else in hexadecimals, which the
        standard wants rounded correctly (C99, 6.4.4.2).
        """
        if self.boolean:
            return "1" if value else "0"
        if not self.real:
            return self._integer(int(value))
        value = float(value)
        if math.isnan(value):
            return f"({self.name})NAN"
        if math.isinf(value):
            return f"({self.name})INFINITY" if value > 0 else f"(-({self.name})INFINITY)"
        text = repr(value)
        if len(text) > 8 or "e" in text or Decimal(text) != Decimal(value):
            text = value.hex()
        text += self.suffix
        return f"({text})" if text.startswith("-") else text

    def _integer(self, value: int) -> str:
        if self.dtype.itemsize < 8:
            return f"({self.name})({value})" if value < 0 else f"({self.name}){value}"
        if value == np.iinfo(np.int64).min:
            return f"(-INT64_C({-(value + 1)}) - 1)"
        macro = "INT64_C" if self.dtype.kind == "i" else "UINT64_C"
        return f"(-{macro}({-value}))" if value < 0 else f"{macro}({value})"


def c_type(dtype: np.dtype[Any]) -> CType:
    """The type of C.

    Raises:
        ModelError: C has none: complex and half-precision numbers.
    """
    names = {"float64": "double", "float32": "float", "bool": "bool"}
    if dtype.kind in "iu":
        return CType(f"{dtype.name}_t", dtype)
    if dtype.name not in names:
        raise ModelError(f"C99 code has no numbers of type {dtype.name}; the system works in them somewhere")
    return CType(names[dtype.name], dtype)


# ---- operations ------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Written:
    """An operation in C.

    Attributes:
        text: the expression.
        helpers: definitions of functions that it calls, by name.
    """

    text: str
    helpers: tuple[tuple[str, str], ...] = ()


Form: TypeAlias = "Callable[..., Written]"


def infix(sign: str) -> Form:
    return lambda c, a, b: Written(f"{a} {sign} {b}")


def prefix(sign: str) -> Form:
    return lambda c, a: Written(f"{sign}{a}")


def function(name: str) -> Form:
    """One of libm."""
    return lambda c, *a: Written(f"{name}{c.suffix}({', '.join(a)})")


def helper(name: str, parameters: str, body: str) -> Form:
    """A call of a function of one type: @T its name, @U the unsigned type to add in, @f the suffix of libm's names."""

    def form(c: CType, *a: str) -> Written:
        own = f"{name}_{c.name.removesuffix('_t')}"
        listed = ", ".join(f"{c.name} {p}" for p in parameters.split())
        words = {"@T": c.name, "@U": c.unsigned, "@f": c.suffix, "@1": c.literal(1), "@0": c.literal(0)}
        if c.dtype.kind in "iu":
            words |= {"@most": c.literal(c.most)}
        if c.dtype.kind in "if":
            words |= {"@-1": c.literal(-1)}
        text = body
        for word, meaning in words.items():
            text = text.replace(word, meaning)
        text = f"static {c.name} {own}({listed})\n{{\n    return {text};\n}}\n"
        return Written(f"{own}({', '.join(a)})", ((own, text),))

    return form


def wrapped(sign: str) -> Form:
    """Of integers, without overflow."""
    return lambda c, a, b: Written(f"({c.name})(({c.unsigned}){a} {sign} ({c.unsigned}){b})")


def bits(sign: str) -> Form:
    return lambda c, a, b: Written(f"({c.name})({a} {sign} {b})")


def by_sign(signed: Form, unsigned: Form) -> Form:
    """Of integers with a sign, and of those without."""
    return lambda c, *a: (signed if c.dtype.kind == "i" else unsigned)(c, *a)


def same(c: CType, a: str) -> Written:
    return Written(a)


def finite(c: CType, a: str) -> Written:
    return Written(f"isfinite({a}) != 0")


def selected(c: CType, which: str, a: str, b: str) -> Written:
    text = f"{which} ? {a} : {b}"
    return Written(text if c.real or c.boolean else f"({c.name})({text})")


def clamped(larger: Form, smaller: Form) -> Form:
    def form(c: CType, low: str, x: str, high: str) -> Written:
        inner = larger(c, low, x)
        outer = smaller(c, inner.text, high)
        return Written(outer.text, (*inner.helpers, *outer.helpers))

    return form


NEGATIVE = "(@T)(0U - (@U)a)"
negative = helper("negative", "a", NEGATIVE)
magnitude = by_sign(helper("magnitude", "a", f"a < @0 ? {NEGATIVE} : a"), same)
sign = helper("sign", "a", "a > @0 ? @1 : a < @0 ? @-1 : a")
integer_sign = by_sign(sign, helper("sign", "a", "a > @0 ? @1 : a"))
divided = by_sign(
    helper("divided", "a b", f"b == @0 ? @-1 : b == @-1 ? {NEGATIVE} : (@T)(a / b)"),
    helper("divided", "a b", "b == @0 ? @most : (@T)(a / b)"),
)
rest = by_sign(
    helper("rest", "a b", "b == @0 ? a : b == @-1 ? @0 : (@T)(a % b)"),
    helper("rest", "a b", "b == @0 ? a : (@T)(a % b)"),
)
larger = helper("larger", "a b", "(a > b || isnan(a)) ? a : b")
smaller = helper("smaller", "a b", "(a < b || isnan(a)) ? a : b")
larger_integer = helper("larger", "a b", "a > b ? a : b")
smaller_integer = helper("smaller", "a b", "a < b ? a : b")


def converted(dtype: np.dtype[Any]) -> Forms:
    """To a type: to truth whether it is not zero; to integers the whole part, kept in range, of NaN zero."""
    if dtype.kind == "b":
        nonzero: Form = lambda c, a: Written(f"{a} != {c.literal(0)}")  # noqa: E731
        return Forms(nonzero, nonzero, nonzero)
    cast: Form = lambda c, a: Written(f"({c_type(dtype).name}){a}")  # noqa: E731
    return Forms(cast if dtype.kind == "f" else _whole(dtype), cast, cast)


def _whole(dtype: np.dtype[Any]) -> Form:
    def form(c: CType, a: str) -> Written:
        result = c_type(dtype)
        name = f"whole_{result.name.removesuffix('_t')}_of_{c.name}"
        # The limits as real numbers: the upper one may round up, to one beyond the largest integer.
        low, high = c.literal(float(result.least)), c.literal(c.dtype.type(result.most))
        text = (
            f"isnan(a) ? {result.literal(0)} : a <= {low} ? {result.literal(result.least)} "
            f": a >= {high} ? {result.literal(result.most)} : ({result.name})a"
        )
        return Written(
            f"{name}({a})", ((name, f"static {result.name} {name}({c.name} a)\n{{\n    return {text};\n}}\n"),)
        )

    return form
