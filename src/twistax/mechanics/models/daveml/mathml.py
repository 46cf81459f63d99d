"""Content MathML 2, the notation of calculations in DAVE-ML, as expressions. Angles are in rad."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from typing import Any as Anything

from ....checks import listed
from ....errors import TwistaxError
from ....expr import (
    Abs,
    Acos,
    All,
    Any,
    Asin,
    Atan,
    Atan2,
    Cond,
    Constant,
    Cos,
    Cosh,
    Exp,
    Expr,
    Log,
    Max,
    Min,
    Not,
    Sign,
    Sin,
    Sinh,
    Tan,
    Tanh,
    Where,
    to_expr,
)
from ..xml_file import Element

#: Deeper nesting is refused; usual files have a tenth of it.
_DEPTH = 100

Build = Callable[..., Expr]


def _chain(holds: Callable[[Expr, Expr], Expr]) -> Build:
    """A chain of comparisons of two or more operands, each with the next."""
    return lambda *a: All(*(holds(x, y) for x, y in pairwise(a))) if len(a) > 2 else holds(*a)


def _one_of(a: Expr, b: Expr) -> Expr:
    return All(Any(a, b), Not(All(a, b)))


def _root(a: Expr, degree: Expr) -> Expr:
    """The real root; for an odd degree also of negative numbers."""
    if isinstance(degree, Constant) and float(degree.value) % 2.0 == 1.0:
        return Sign(a) * Abs(a) ** (1.0 / degree)
    return a ** (1.0 / degree)


#: Operators: the smallest and the largest number of operands (None: no limit), and the node that they build.
_OPERATORS: dict[str, tuple[int, int | None, Build]] = {
    "plus": (1, None, lambda *a: reduce(lambda x, y: x + y, a)),
    "times": (1, None, lambda *a: reduce(lambda x, y: x * y, a)),
    "minus": (1, 2, lambda a, b=None: -a if b is None else a - b),
    "divide": (2, 2, lambda a, b: a / b),
    "power": (2, 2, lambda a, b: a**b),
    "root": (1, 1, lambda a: a**0.5),
    "abs": (1, 1, Abs),
    "exp": (1, 1, Exp),
    "ln": (1, 1, Log),
    "log": (1, 1, lambda a: Log(a) / math.log(10.0)),
    "max": (1, None, lambda *a: Max(*a) if len(a) > 1 else a[0]),
    "min": (1, None, lambda *a: Min(*a) if len(a) > 1 else a[0]),
    "sin": (1, 1, Sin),
    "cos": (1, 1, Cos),
    "tan": (1, 1, Tan),
    "sec": (1, 1, lambda a: 1.0 / Cos(a)),
    "csc": (1, 1, lambda a: 1.0 / Sin(a)),
    "cot": (1, 1, lambda a: Cos(a) / Sin(a)),
    "arcsin": (1, 1, Asin),
    "arccos": (1, 1, Acos),
    "arctan": (1, 1, Atan),
    "sinh": (1, 1, Sinh),
    "cosh": (1, 1, Cosh),
    "tanh": (1, 1, Tanh),
    "lt": (2, None, _chain(lambda a, b: a < b)),
    "gt": (2, None, _chain(lambda a, b: a > b)),
    "leq": (2, None, _chain(lambda a, b: a <= b)),
    "geq": (2, None, _chain(lambda a, b: a >= b)),
    "eq": (2, None, _chain(lambda a, b: a == b)),
    "neq": (2, 2, lambda a, b: Not(a == b)),
    "and": (1, None, All),
    "or": (1, None, Any),
    "not": (1, 1, Not),
    "xor": (2, 2, _one_of),
    "implies": (2, 2, lambda a, b: Any(Not(a), b)),
}
#: Names of `csymbol` elements besides those of MathML, which are in DAVE-ML's function spaces.
_SYMBOLS: dict[str, tuple[int, int | None, Build]] = {"atan2": (2, 2, Atan2)}
_CONSTANTS: dict[str, Anything] = {"pi": math.pi, "exponentiale": math.e, "true": True, "false": False}
#: Operators whose value or derivative is undefined for some operands.
_PARTIAL = {"root", "ln", "log", "arcsin", "arccos", "tan", "sec", "csc", "cot"}


class Calculation:
    """One <math> element as an expression.

    A branch of a <piecewise> with a division whose divisor may be zero, or with a root, is built with `Cond`, so that
    it is evaluated only if it is selected. Other branches are built with `Where`, which is faster.

    Args:
        variable: the expression of the variable that a <ci> names.
    """

    def __init__(self, variable: Callable[[Element], Expr]) -> None:
        self._variable = variable
        self._partial = 0  # the number of operations so far that are not defined everywhere

    def __call__(self, math: Element) -> Expr:
        """The value of the single expression in <math>. Raises ModelError with element and line."""
        return self._value(_only(math), 0)

    def _value(self, element: Element, depth: int) -> Expr:
        if depth > _DEPTH:
            raise element.wrong(f"operations are nested more than {_DEPTH} deep")
        try:
            if element.tag == "cn":
                return Constant(_number(element))
            if element.tag == "ci":
                return self._variable(element)
            if element.tag in _CONSTANTS:
                return to_expr(_CONSTANTS[element.tag])
            if element.tag == "piecewise":
                return self._piecewise(element, depth)
            if element.tag == "apply":
                return self._apply(element, depth)
        except TwistaxError as error:
            placed = ", line " in str(error)
            raise error if placed else element.wrong(str(error)) from None
        raise element.wrong(f"expected cn, ci, apply, piecewise or one of {', '.join(_CONSTANTS)}, got <{element.tag}>")

    def _apply(self, element: Element, depth: int) -> Expr:
        if not element.children:
            raise element.wrong("expected an operator and its operands")
        operator, *rest = element.children
        if operator.tag == "piecewise" and not rest:  # some files use this form
            return self._value(operator, depth + 1)
        name, known = (operator.content.strip(), _SYMBOLS) if operator.tag == "csymbol" else (operator.tag, _OPERATORS)
        if name not in known:
            raise operator.wrong(f"unknown operator {name!r}; known are {listed(known, name)}")
        qualifiers = {"root": "degree", "log": "logbase"}
        qualifier = next((e for e in rest if e.tag == qualifiers.get(name)), None)
        operands = [self._value(e, depth + 1) for e in rest if e is not qualifier]
        least, most, build = known[name]
        if len(operands) < least or (most is not None and len(operands) > most):
            wanted = f"{least}" if most == least else f"{least} or more" if most is None else f"{least} to {most}"
            raise operator.wrong(f"expected {wanted} operands, got {len(operands)}")
        self._partial += self._is_partial(name, operands)
        if qualifier is not None:
            by = self._value(_only(qualifier), depth + 1)
            return _root(operands[0], by) if name == "root" else Log(operands[0]) / Log(by)
        return build(*operands)

    @staticmethod
    def _is_partial(name: str, operands: list[Expr]) -> bool:
        if name in ("divide", "power"):
            exponent_or_divisor = operands[1]
            if not isinstance(exponent_or_divisor, Constant):
                return True
            value = float(exponent_or_divisor.value)
            return value == 0.0 if name == "divide" else value < 0.0 or value != round(value)
        return name in _PARTIAL

    def _piecewise(self, element: Element, depth: int) -> Expr:
        otherwise = element.first("otherwise")
        if otherwise is None:
            raise element.wrong("expected <otherwise>: without it there is no value if no condition holds")
        pieces = element.all("piece")
        for piece in pieces:
            if len(piece.children) != 2:
                raise piece.wrong(f"expected a value and a condition, got {len(piece.children)} elements")
        before = self._partial
        value = self._value(_only(otherwise), depth + 1)
        for piece in reversed(pieces):
            chosen, condition = (self._value(child, depth + 1) for child in piece.children)
            value = (Where if self._partial == before else Cond)(condition, chosen, value)
        return value


def names_in(math: Element) -> list[Element]:
    """All <ci> elements of a <math> element, in the order of the file."""
    names, pending = [], [math]
    while pending:
        element = pending.pop()
        names += [element] if element.tag == "ci" else []
        pending += reversed(element.children)
    return names


def _only(element: Element) -> Element:
    if len(element.children) != 1:
        raise element.wrong(f"expected one element inside, got {len(element.children)}")
    return element.children[0]


def _number(element: Element) -> float:
    words, kind = element.content.split(), element.attributes.get("type", "real")
    parts = len(element.all("sep")) + 1
    if len(words) == parts == 2 and kind == "e-notation":
        return element.read("e".join(words))
    if len(words) == parts == 2 and kind == "rational":
        over, under = map(element.read, words)
        if under == 0.0:
            raise element.wrong("expected a denominator that is not zero")
        return over / under
    if kind not in ("real", "integer") or parts != 1 or element.attributes.get("base", "10") != "10":
        raise element.wrong("expected a real number, an integer, or e-notation or rational with <sep/>, in base 10")
    return element.read(element.content)
