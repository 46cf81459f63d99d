"""NumPy functions and arrays that meet expressions: each supported function builds the node of the same meaning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .arithmetic import Add, Div, MatMul, Mul, Neg, Power, Sub
from .array import Block, Concat, Hstack, Stack, Vstack
from .constraint import Equality, Inequality
from .elementwise import Abs, Exp, Log, Sign, Sqrt, Square
from .extrema import LogSumExp, Max, Min
from .interpolation import Linterp
from .linalg import Cross, Diag, Dot, Norm, Outer, Sum, Trace, Transpose
from .logic import All, Where
from .logic import Any as AnyOf
from .node import Expr, to_expr
from .solve import Inv, Solve
from .trigonometry import Acos, Asin, Atan, Atan2, Cos, Cosh, Sin, Sinh, Tan, Tanh

#: ufunc -> what it builds from its inputs.
UFUNCS: dict[np.ufunc, Callable[..., Expr]] = {
    np.add: Add,
    np.subtract: Sub,
    np.multiply: Mul,
    np.divide: Div,
    np.matmul: MatMul,
    np.negative: Neg,
    np.positive: to_expr,
    np.power: Power,
    np.float_power: Power,
    np.square: Square,
    np.sqrt: Sqrt,
    np.reciprocal: lambda x: Div(1.0, x),
    np.hypot: lambda x, y: Sqrt(Add(Square(x), Square(y))),
    np.exp: Exp,
    np.log: Log,
    np.logaddexp: LogSumExp,
    np.absolute: Abs,
    np.fabs: Abs,
    np.sign: Sign,
    np.maximum: Max,
    np.minimum: Min,
    np.fmax: Max,
    np.fmin: Min,
    np.sin: Sin,
    np.cos: Cos,
    np.tan: Tan,
    np.arcsin: Asin,
    np.arccos: Acos,
    np.arctan: Atan,
    np.arctan2: Atan2,
    np.sinh: Sinh,
    np.cosh: Cosh,
    np.tanh: Tanh,
    np.deg2rad: lambda x: Mul(x, np.pi / 180.0),
    np.radians: lambda x: Mul(x, np.pi / 180.0),
    np.rad2deg: lambda x: Mul(x, 180.0 / np.pi),
    np.degrees: lambda x: Mul(x, 180.0 / np.pi),
    np.less_equal: Inequality,
    np.greater_equal: lambda a, b: Inequality(b, a),
    np.equal: Equality,
}


def _dot(a: Any, b: Any) -> Expr:
    a, b = to_expr(a), to_expr(b)
    if a.ndim == 0 or b.ndim == 0:
        return Mul(a, b)
    return Dot(a, b) if a.ndim == b.ndim == 1 else MatMul(a, b)


def _cross(a: Any, b: Any) -> Expr:
    a, b = to_expr(a), to_expr(b)
    if a.ndim > 1 or b.ndim > 1:
        raise TypeError("np.cross of expressions knows vectors; tx.linalg.Cross takes k columns (3, k) on the right")
    return Cross(a, b)


def _joined(arrays: Any, axis: int = 0) -> Expr:
    exprs = [to_expr(array) for array in arrays]
    if axis in (1, -1) and all(e.ndim == 2 for e in exprs):
        return Hstack(exprs)
    if axis == 0 or (axis == -1 and all(e.ndim == 1 for e in exprs)):
        return Concat(*exprs)
    raise TypeError("np.concatenate of expressions knows axis 0, and axis 1 of matrices")


def _stacked(arrays: Any, axis: int = 0) -> Expr:
    if axis != 0:
        raise TypeError("np.stack of expressions knows axis 0 only; transpose the result")
    return Stack(list(arrays))


def _transposed(a: Any, axes: Any = None) -> Expr:
    expr = to_expr(a)
    if axes not in (None, (1, 0), [1, 0]) or expr.ndim > 2:
        raise TypeError("np.transpose of an expression knows matrices; tx.linalg.Transpose swaps the last two axes")
    return Transpose(expr)


def _clipped(a: Any, a_min: Any = None, a_max: Any = None) -> Expr:
    expr = to_expr(a)
    if a_min is not None:
        expr = Max(expr, a_min)
    return expr if a_max is None else Min(expr, a_max)


#: function -> what it builds from its arguments; an argument it does not take is an error.
FUNCTIONS: dict[Callable[..., Any], Callable[..., Any]] = {
    np.dot: _dot,
    np.vdot: Dot,
    np.inner: Dot,
    np.cross: _cross,
    np.outer: Outer,
    np.trace: Trace,
    np.transpose: _transposed,
    np.diag: Diag,
    np.sum: Sum,
    np.all: All,
    np.any: AnyOf,
    np.linalg.norm: lambda x, ord=None: Norm(x, ord),
    np.linalg.inv: Inv,
    np.linalg.solve: Solve,
    np.concatenate: _joined,
    np.stack: _stacked,
    np.hstack: lambda arrays: Hstack(list(arrays)),
    np.vstack: lambda arrays: Vstack(list(arrays)),
    np.block: lambda arrays: Block(arrays),
    np.where: Where,
    np.clip: _clipped,
    np.interp: Linterp,
    np.shape: lambda a: to_expr(a).shape,
    np.ndim: lambda a: to_expr(a).ndim,
    np.size: lambda a: int(np.prod(to_expr(a).shape)),
}

_STRICT = {np.less: "<=", np.greater: ">=", np.not_equal: "a.key() != b.key()"}


def apply_ufunc(ufunc: np.ufunc, method: str, inputs: tuple[Any, ...], kwargs: dict[str, Any]) -> Expr:
    """What a NumPy ufunc means for expressions.

    Raises:
        TypeError: a ufunc without a node, a method such as `np.add.reduce`, or keyword arguments.
    """
    name = f"np.{ufunc.__name__}"
    if ufunc in _STRICT:
        raise TypeError(f"{name} builds no constraint from expressions.\n  fix: use {_STRICT[ufunc]}")
    if method != "__call__":
        raise TypeError(
            f"{name}.{method} is not available for expressions.\n"
            "  fix: use tx.linalg.Sum, tx.linalg.Outer or an explicit sum"
        )
    if kwargs:
        raise TypeError(f"{name} takes no keyword arguments with expressions, got {', '.join(kwargs)}")
    if ufunc not in UFUNCS:
        raise _unsupported(name)
    return UFUNCS[ufunc](*inputs)


def apply_function(func: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """What another NumPy function means for expressions.

    Raises:
        TypeError: a function without a node, or arguments the node does not know.
    """
    if func not in FUNCTIONS:
        raise _unsupported(_name(func))
    try:
        return FUNCTIONS[func](*args, **kwargs)
    except TypeError as error:
        raise TypeError(f"{_name(func)} with expressions: {error}") from None


def _name(func: Any) -> str:
    module = getattr(func, "__module__", "numpy").replace("numpy", "np", 1)
    return f"{module}.{func.__name__}"


def _unsupported(name: str) -> TypeError:
    return TypeError(
        f"{name} is not available for expressions.\n"
        "  fix: build it from tx nodes, or lower first (tx.lower(expr)) and apply it to the numbers"
    )
