"""How each operation of a scalar program is written in C99.

Real numbers follow the operations' meaning in JAX, also where libm's function of the name differs: max and min pass
not-a-number on. Integers wrap around and never divide by zero, as XLA's.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from ...errors import ModelError
from ..scalar.operations import Convert, Operation, by_primitive
from .c_types import CType

__all__ = ["Written", "written"]


@dataclasses.dataclass(frozen=True)
class Written:
    """An operation in C.

    Attributes:
        text: the expression.
        helpers: definitions of functions that it calls, by name.
    """

    text: str
    helpers: tuple[tuple[str, str], ...] = ()


#: (type of the arguments, the arguments) -> the expression. None of the three where the type has no such operation.
Form = Callable[..., "Written"]


@dataclasses.dataclass(frozen=True)
class _Forms:
    """The forms of one operation on real numbers, integers and truth values."""

    real: Form | None = None
    integer: Form | None = None
    boolean: Form | None = None


def written(operation: Operation, result: CType, types: list[CType], arguments: list[str]) -> Written:
    """The expression of an operation.

    Raises:
        ModelError: the type has no such operation in C.
    """
    own = types[-1]
    if isinstance(operation, Convert):
        return _converted(result, own, arguments[0])
    forms = _FORMS[operation]
    form = forms.boolean if own.boolean else forms.real if own.real else forms.integer
    if form is None:
        raise ModelError(f"C99 code has no {operation.name} of {own.name}")
    return form(own, *arguments)


# ---- the pieces ------------------------------------------------------------------------------------------------------


def _infix(sign: str) -> Form:
    return lambda c, a, b: Written(f"{a} {sign} {b}")


def _prefix(sign: str) -> Form:
    return lambda c, a: Written(f"{sign}{a}")


def _libm(name: str) -> Form:
    return lambda c, *a: Written(f"{name}{c.suffix}({', '.join(a)})")


def _helper(name: str, parameters: str, body: str) -> Form:
    """A call of a function of one type: T its name, U the unsigned type to add in, f the suffix of libm's names."""

    def form(c: CType, *a: str) -> Written:
        own = f"{name}_{c.name.removesuffix('_t')}"
        listed = ", ".join(f"{c.name} {p}" for p in parameters.split())
        text = body.replace("@T", c.name).replace("@U", c.unsigned).replace("@f", c.suffix)
        least = c.literal(c.least) if not c.real and not c.boolean else ""
        most = c.literal(c.most) if not c.real and not c.boolean else ""
        text = text.replace("@least", least).replace("@most", most)
        text = text.replace("@1", c.literal(1)).replace("@0", c.literal(0)).replace("@-1", _minus_one(c))
        return Written(
            f"{own}({', '.join(a)})", ((own, f"static {c.name} {own}({listed})\n{{\n    return {text};\n}}\n"),)
        )

    return form


def _minus_one(c: CType) -> str:
    return "" if c.dtype.kind in "bu" else c.literal(-1)


def _wrapped(sign: str) -> Form:
    return lambda c, a, b: Written(f"({c.name})(({c.unsigned}){a} {sign} ({c.unsigned}){b})")


def _bits(sign: str) -> Form:
    return lambda c, a, b: Written(f"({c.name})({a} {sign} {b})")


def _by_sign(signed: Form, unsigned: Form) -> Form:
    return lambda c, *a: (signed if c.dtype.kind == "i" else unsigned)(c, *a)


def _same(c: CType, a: str) -> Written:
    return Written(a)


_NEGATIVE = "(@T)(0U - (@U)a)"
_DIVIDED = _by_sign(
    _helper("divided", "a b", f"b == @0 ? @-1 : b == @-1 ? {_NEGATIVE} : (@T)(a / b)"),
    _helper("divided", "a b", "b == @0 ? @most : (@T)(a / b)"),
)
_REST = _by_sign(
    _helper("rest", "a b", "b == @0 ? a : b == @-1 ? @0 : (@T)(a % b)"),
    _helper("rest", "a b", "b == @0 ? a : (@T)(a % b)"),
)
_LARGER = "(a > b || isnan(a)) ? a : b"
_SMALLER = "(a < b || isnan(a)) ? a : b"


def _clamped(c: CType, low: str, x: str, high: str) -> Written:
    larger, smaller = _FORMS[by_primitive["max"]], _FORMS[by_primitive["min"]]
    above, below = (larger.real, smaller.real) if c.real else (larger.integer, smaller.integer)
    if above is None or below is None:
        raise ModelError(f"C99 code has no clamp of {c.name}")
    inner = above(c, low, x)
    outer = below(c, inner.text, high)
    return Written(outer.text, (*inner.helpers, *outer.helpers))


def _selected(c: CType, which: str, a: str, b: str) -> Written:
    return Written(f"{which} ? {a} : {b}")


def _everywhere(form: Form) -> _Forms:
    return _Forms(form, form, form)


_COMPARISONS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
_LIBM = (
    *("floor", "ceil", "pow", "atan2", "sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "sin", "cos", "tan"),
    *("asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)

_FORMS: dict[Operation, _Forms] = {
    by_primitive[name]: forms
    for name, forms in {
        "add": _Forms(_infix("+"), _wrapped("+")),
        "sub": _Forms(_infix("-"), _wrapped("-")),
        "mul": _Forms(_infix("*"), _wrapped("*")),
        "div": _Forms(_infix("/"), _DIVIDED),
        "neg": _Forms(_prefix("-"), _helper("negative", "a", _NEGATIVE)),
        "abs": _Forms(_libm("fabs"), _by_sign(_helper("magnitude", "a", f"a < @0 ? {_NEGATIVE} : a"), _same)),
        "sign": _Forms(
            _helper("sign", "a", "a > @0 ? @1 : a < @0 ? @-1 : a"),
            _by_sign(_helper("sign", "a", "a > @0 ? @1 : a < @0 ? @-1 : a"), _helper("sign", "a", "a > @0 ? @1 : a")),
        ),
        "rem": _Forms(_libm("fmod"), _REST),
        "max": _Forms(_helper("larger", "a b", _LARGER), _helper("larger", "a b", "a > b ? a : b"), _infix("||")),
        "min": _Forms(_helper("smaller", "a b", _SMALLER), _helper("smaller", "a b", "a < b ? a : b"), _infix("&&")),
        "clamp": _Forms(_clamped, _clamped),
        "logistic": _Forms(_helper("logistic", "a", "@1 / (@1 + exp@f(-a))")),
        "stop_gradient": _everywhere(_same),
        "is_finite": _Forms(lambda c, a: Written(f"isfinite({a}) != 0")),
        "and": _Forms(None, _bits("&"), _infix("&&")),
        "or": _Forms(None, _bits("|"), _infix("||")),
        "xor": _Forms(None, _bits("^"), _infix("!=")),
        "not": _Forms(None, lambda c, a: Written(f"({c.name})(~{a})"), _prefix("!")),
        "select": _Forms(_selected, lambda c, *a: Written(f"({c.name})({_selected(c, *a).text})"), _selected),
        **{name: _everywhere(_infix(sign)) for name, sign in _COMPARISONS.items()},
        **{name: _Forms(_libm(name)) for name in _LIBM},
    }.items()
}


def _converted(result: CType, own: CType, a: str) -> Written:
    """To truth values: whether it is not zero. To integers: the whole part, kept in range; not-a-number gives zero."""
    if result.boolean:
        return Written(f"{a} != {own.literal(0)}")
    if result.real or not own.real:
        return Written(f"({result.name}){a}")
    name = f"whole_{result.name.removesuffix('_t')}_of_{own.name}"
    # The limits as real numbers: the upper one may round up, to one beyond the largest integer.
    low, high = own.literal(float(result.least)), own.literal(own.dtype.type(result.most))
    text = (
        f"isnan(a) ? {result.literal(0)} : a <= {low} ? {result.literal(result.least)} "
        f": a >= {high} ? {result.literal(result.most)} : ({result.name})a"
    )
    return Written(
        f"{name}({a})", ((name, f"static {result.name} {name}({own.name} a)\n{{\n    return {text};\n}}\n"),)
    )
