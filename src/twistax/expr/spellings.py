"""Hints for users who treat an expression as an array: the equivalent form for expressions.

They cover methods and attributes of arrays, functions of `jax.numpy` and `math`, and functions of NumPy without a node.
"""

from __future__ import annotations

import dis
import functools
import inspect
import sys
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from ..errors import ModelError, OperationError, ShapeError

#: Attributes of arrays, each with what gives the same of an expression, {x} in texts.
CODE = {
    "sum": "tx.linalg.Sum({x})",
    "mean": "tx.linalg.Sum({x}) / np.size({x})",
    "var": "tx.linalg.Sum(({x} - tx.linalg.Sum({x}) / np.size({x})) ** 2) / np.size({x})",
    "std": "tx.Sqrt(tx.linalg.Sum(({x} - tx.linalg.Sum({x}) / np.size({x})) ** 2) / np.size({x}))",
    "max": "tx.Max(*{x})",
    "min": "tx.Min(*{x})",
    "ptp": "tx.Max(*{x}) - tx.Min(*{x})",
    "prod": "functools.reduce(operator.mul, {x})",
    "cumsum": "tx.Stack(list(itertools.accumulate({x})))",
    "cumprod": "tx.Stack(list(itertools.accumulate({x}, operator.mul)))",
    "dot": "{x} @ y",
    "vdot": "{x} @ y",
    "norm": "tx.linalg.Norm({x})",
    "outer": "tx.linalg.Outer({x}, y)",
    "transpose": "{x}.T",
    "swapaxes": "{x}.T",
    "mT": "{x}.T",
    "ravel": "tx.Concat(*{x})",
    "flatten": "tx.Concat(*{x})",
    "flat": "tx.Concat(*{x})",
    "reshape": "tx.Stack([{x}[:3], {x}[3:]])",
    "resize": "tx.Stack([{x}[:3], {x}[3:]])",
    "squeeze": "{x}[0]",
    "take": "{x}[[0, 2]]",
    "choose": "{x}[[0, 2]]",
    "compress": "{x}[[0, 2]]",
    "repeat": "tx.Concat({x}, {x})",
    "tile": "tx.Concat({x}, {x})",
    "diagonal": "tx.Stack([{x}[i, i] for i in range(len({x}))])",
    "trace": "tx.linalg.Trace({x})",
    "inv": "tx.linalg.Inv({x})",
    "clip": "np.clip({x}, low, high)",
    "all": "tx.All({x})",
    "any": "tx.Any({x})",
    "copy": "{x}",
    "view": "{x}",
    "conj": "{x}",
    "conjugate": "{x}",
    "real": "{x}",
    "size": "np.size({x})",
}
_NUMBERS = "tx.lower({x})(t, x, u, params), which returns an array"
_PARTS = "tx.Concat or tx.Stack of the parts, since an expression never changes"
_NO_ORDER = "tx.Max, tx.Min or tx.Where; or lower it, tx.lower({x}), and order the numbers"
_PRECISION = "nothing: values have the precision of the arrays that come in"
_NO_STEPS = "tx.Linterp over steps, since nothing rounds"
#: Others, with what to take in their place.
PROSE = {
    **dict.fromkeys(("item", "tolist", "tobytes", "tofile", "dump", "dumps", "data", "numpy"), _NUMBERS),
    **dict.fromkeys(("fill", "put", "setfield", "setflags", "itemset", "at"), _PARTS),
    **dict.fromkeys(("argmax", "argmin", "argsort", "argpartition", "partition", "sort", "nonzero"), _NO_ORDER),
    **dict.fromkeys(("astype", "dtype", "itemsize", "nbytes"), _PRECISION),
    "searchsorted": "tx.Linterp, tx.Interp or tx.Where",
    "round": _NO_STEPS,
    "imag": "nothing: expressions are real",
}


#: Methods that take the entries of a matrix one after the other, as the spellings do those of a vector.
_OF_ENTRIES = ("max", "min", "ptp", "prod", "cumsum", "cumprod")
#: What methods come to for a scalar.
_OF_SCALARS = dict.fromkeys(("max", "min", "prod", "sum", "mean"), "{x}") | {
    "ptp": "{x} - {x}",
    "cumsum": "tx.Concat({x})",
    "cumprod": "tx.Concat({x})",
}


def spelled(name: str, x: str, ndim: int = 1) -> str | None:
    """The equivalent of an attribute of arrays for the expression with the text x; None for other names."""
    text = CODE.get(name) or PROSE.get(name)
    if not ndim:
        text = _OF_SCALARS.get(name, text)
    elif ndim > 1 and name in _OF_ENTRIES:
        x = f"tx.Concat(*{x})"
    return text.format(x=x) if text else None


class MissingAttribute(OperationError, AttributeError):
    """The error for an attribute that arrays have and expressions do not; `hasattr` returns False."""


def missing(expr: Any, name: str, of_numpy: bool) -> AttributeError:
    """The error for an attribute that an expression does not have; `of_numpy`: a function of NumPy that accepts
    expressions.
    """
    if not name.startswith("_"):
        rank = _rank(expr) if name in CODE else 1
        if spelled(name, "x", rank) or of_numpy:  # the text of a large expression takes long, and `hasattr` asks often
            text = repr(expr)
            x = text if len(text) <= 20 else "x"
            fix = spelled(name, x, rank) or _called(name, x)
            return MissingAttribute(
                f"{text[:60]}.{name}: an expression is not an array and has no {name!r}.\n  fix: {fix}"
            )
    return AttributeError(f"{type(expr).__name__!r} object has no attribute {name!r}", name=name, obj=expr)


def _called(name: str, x: str) -> str:
    """A call of a function of NumPy, with dots for other arguments that it needs."""
    function = getattr(np, name)
    more = (function.nin if isinstance(function, np.ufunc) else _positional(function)) > 1
    return f"np.{name}({x}, ...)" if more else f"np.{name}({x})"


def _positional(function: Any) -> int:
    """How many arguments a function needs; 1 where it does not say."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:
        return 1
    return sum(p.default is p.empty and p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters)


def _rank(expr: Any) -> int:
    """How many axes an expression has; 1 where it has no shape, which is an error of its own."""
    try:
        return expr.ndim
    except ShapeError:
        return 1


def _bound(name: str) -> property:
    def read(leaf: Any) -> Any:
        if _reads_a_method(inspect.currentframe()):
            raise AttributeError(name)  # so that Python asks `__getattr__`
        return leaf.__dict__[name]

    return property(read)


class Bounded:
    """A leaf with `min` and `max`: its bounds, and also, as methods, the hints of other expressions.

    Without a bound `x.max` is None, so `x.max()` would only report that None is not callable.
    """

    if TYPE_CHECKING:
        min: np.ndarray | None
        max: np.ndarray | None
    else:
        min, max = _bound("min"), _bound("max")


def _reads_a_method(getter: Any) -> bool:
    """Whether the caller of a getter reads the attribute in order to call it, by the instructions of CPython."""
    caller: FrameType = getter.f_back
    code, at = caller.f_code.co_code, caller.f_lasti
    if sys.version_info < (3, 12):
        return code[at] == dis.opmap["LOAD_METHOD"]
    return code[at] == dis.opmap["LOAD_ATTR"] and bool(code[at + 1] & 1)


def for_jax() -> property:
    """`__jax_array__`: raises an error if a function of JAX requires an array, and is absent for JAX's operators.

    It raises a ModelError rather than an OperationError, because JAX replaces the message of a TypeError.
    """

    def refuse(expr: Any) -> NoReturn:
        from ..jax_inside import makes_an_array

        if not makes_an_array(inspect.currentframe()):
            raise AttributeError("__jax_array__", name="__jax_array__", obj=expr)
        _refuse(expr)

    return property(refuse)


def _refuse(expr: Any) -> NoReturn:
    raise ModelError(
        f"a function of jax or jax.numpy expects arrays, got the expression {repr(expr)[:60]}.\n"
        "  fix: use NumPy, np.sin(x), np.linalg.norm(x), or a node, tx.Sin(x), tx.linalg.Norm(x); wrap a "
        "function of arrays or a network by tx.Function(f, shape)(x); or use the lowered function tx.lower(x)"
    )


@functools.cache
def refuse_in_jax(cls: type) -> None:
    """Raise that error also if an operation of JAX gets an expression that no function of JAX has converted before, as
    in a layer of a network, where `weight @ x` is an expression and its activation is an operation of JAX.
    """
    from ..jax_inside import refuse_as_argument

    refuse_as_argument(cls, _refuse)
