"""Python and NumPy operators on expressions; each operator builds a node."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from ..errors import OperationError
from . import spellings

#: The node classes of the language by name, each added when it is defined: they are built on this module.
NODES: dict[str, Any] = {}


def as_node(value: Any) -> Any:
    """The value itself if it is an expression, else a Constant. Raises ModelError for other objects."""
    return value if isinstance(value, Operators) else NODES["Constant"](value)


def _unary(node: str) -> Callable[[Any], Any]:
    return lambda a: NODES[node](a)


def _both_ways(node: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """The operator of a node with two operands, and its reflected version."""
    return lambda a, b: NODES[node](a, b), lambda b, a: NODES[node](a, b)


def _refused(written: str, why: str, fix: str) -> Callable[..., Any]:
    """An operator that is not defined: its form with a and b, the reason, and the alternative."""

    def refuse(a: Any, b: Any = None, c: Any = None) -> NoReturn:
        raise OperationError(f"{written.format(a=a, b=b, c=c)}: {why}.\n  fix: {fix}")

    return refuse


_NUMBER = "an expression has no number before it is lowered, tx.lower(expr)"


class Operators:
    """The operators of `Expr`."""

    check_shape: Callable[[], tuple[int, ...]]

    __add__, __radd__ = _both_ways("Add")
    __sub__, __rsub__ = _both_ways("Sub")
    __mul__, __rmul__ = _both_ways("Mul")
    __truediv__, __rtruediv__ = _both_ways("Div")
    __matmul__, __rmatmul__ = _both_ways("MatMul")
    __pow__, __rpow__ = _both_ways("Power")
    __getitem__ = _both_ways("Index")[0]
    __neg__, __abs__ = _unary("Neg"), _unary("Abs")
    __ne__ = _refused(
        "{a!r} != {b!r}", "!= has no meaning for expressions", "a.key() != b.key() of structure, ~(a == b) of values"
    )
    __contains__ = _refused("{b!r} in {a!r}", "'in' has no meaning for expressions", "compare keys: == is a constraint")
    __and__ = __rand__ = _refused("{a!r} & {b!r}", "& has no meaning for expressions", "tx.All(a, b) of conditions")
    __or__ = __ror__ = _refused("{a!r} | {b!r}", "| has no meaning for expressions", "tx.Any(a, b) of conditions")
    __xor__ = __rxor__ = _refused(
        "{a!r} ^ {b!r}",
        "^ has no meaning for expressions",
        "a**b is a power, tx.All(tx.Any(a, b), ~tx.All(a, b)) either",
    )
    __invert__ = _unary("Not")
    __mod__ = __rmod__ = _refused(
        "{a!r} % {b!r}", "% has no meaning for expressions", "tx.Atan2(sin, cos) for an angle"
    )
    __floordiv__ = __rfloordiv__ = _refused(
        "{a!r} // {b!r}", "// has no meaning for expressions", "tx.Linterp of steps"
    )
    __setitem__ = _refused("{a!r}[{b!r}] = {c!r}", "an expression never changes", "join the parts: tx.Concat, tx.Stack")
    __float__ = _refused("float({a!r})", _NUMBER, "math.sin(x) is written tx.Sin(x), and so are the others of math")
    __complex__ = _refused("complex({a!r})", _NUMBER, "expressions are real")
    __int__ = _refused("int({a!r})", _NUMBER, "whole numbers are Python's own, outside of expressions")
    __round__ = __trunc__ = __floor__ = __ceil__ = _refused(
        "rounding {a!r}", _NUMBER, "nothing rounds; tx.Linterp over steps, or lower it"
    )
    __divmod__ = __rdivmod__ = _refused(
        "divmod({a!r}, {b!r})", "it has no meaning for expressions", "tx.Atan2(sin, cos) for an angle"
    )
    __hash__ = object.__hash__

    # NumPy calls this method before it would iterate over the expression: `array @ expr`, `np.sin(expr)`.
    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        name = ufunc.__name__
        if getattr(np, name, None) is not ufunc:
            raise OperationError(
                f"{ufunc!r} is not a ufunc of NumPy and is not defined for expressions.\n"
                "  fix: build it from tx nodes, or apply it to the numbers of the lowered function tx.lower(expr)"
            )
        function = _meaning(name, self)
        if method != "__call__":
            raise OperationError(
                f"np.{name}.{method} is not available for expressions.\n"
                "  fix: use tx.linalg.Sum, tx.linalg.Outer or an explicit sum"
            )
        if kwargs:
            raise OperationError(
                f"np.{name} does not accept keyword arguments with expressions, got {', '.join(kwargs)}\n"
                "  fix: omit them"
            )
        return function(*inputs)

    def __array_function__(self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any) -> Any:
        module = getattr(func, "__module__", "numpy").removeprefix("numpy").removeprefix(".")
        name = f"{module}.{func.__name__}" if module else func.__name__
        function = _meaning(name, self)
        try:
            return function(*args, **kwargs)
        except TypeError as error:
            raise OperationError(f"np.{name} with expressions: {error}") from None

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            raise spellings.missing(self, name, takes_expressions(name))

        __jax_array__ = spellings.for_jax()

    def __format__(self, spec: str) -> str:
        if spec:
            raise OperationError(f"{self!r} with the format {spec!r}: {_NUMBER}.\n  fix: format the evaluated number")
        return str(self)

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise OperationError(
            f"{type(self).__name__} is an expression and has no value yet.\n"
            "  fix: lower it with tx.lower(expr) and call the function, or build with tx.Stack / tx.Concat"
        )

    def __pos__(self) -> Any:
        return self

    @property
    def T(self) -> Any:
        """Transpose."""
        return NODES["Transpose"](self)

    def __lt__(self, other: Any) -> Any:
        return NODES["Less"](self, other)

    def __gt__(self, other: Any) -> Any:
        return NODES["Less"](other, self)

    def __le__(self, other: Any) -> Any:
        return NODES["Inequality"](self, other)

    def __ge__(self, other: Any) -> Any:
        return NODES["Inequality"](other, self)

    def __eq__(self, other: Any) -> Any:
        return NODES["Equality"](self, other)

    def __bool__(self) -> bool:
        raise OperationError(
            f"{type(self).__name__} has no truth value before it is evaluated.\n"
            "  fix: use tx.Where or tx.Cond to choose inside an expression; compare structure with a.key() == b.key()"
        )

    def __len__(self) -> int:
        shape = self.check_shape()
        if not shape:
            raise OperationError(
                f"{self!r} is a scalar and has no length: a vector was expected.\n"
                "  fix: tx.Stack([a, b, c]) makes a vector of scalars"
            )
        return shape[0]

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self)))


def _dot(a: Any, b: Any) -> Any:
    a, b = as_node(a), as_node(b)
    if a.ndim > 2 or b.ndim > 2:
        raise OperationError("np.dot of expressions accepts vectors and matrices; for stacks of matrices use a @ b")
    if a.ndim == 0 or b.ndim == 0:
        return NODES["Mul"](a, b)
    return NODES["Dot"](a, b) if a.ndim == b.ndim == 1 else NODES["MatMul"](a, b)


def _cross(a: Any, b: Any) -> Any:
    a, b = as_node(a), as_node(b)
    if a.ndim > 1 or b.ndim > 1:
        raise OperationError(
            "np.cross of expressions accepts vectors; tx.linalg.Cross accepts k columns (3, k) on the right"
        )
    return NODES["Cross"](a, b)


def _joined(arrays: Any, axis: int = 0) -> Any:
    exprs = [as_node(array) for array in arrays]
    if axis in (1, -1) and all(e.ndim == 2 for e in exprs):
        return NODES["Hstack"](exprs)
    if axis == 0 or (axis == -1 and all(e.ndim == 1 for e in exprs)):
        return NODES["Concat"](*exprs)
    raise OperationError("np.concatenate of expressions accepts axis 0, and for matrices axis 1")


def _stacked(arrays: Any, axis: int = 0) -> Any:
    if axis != 0:
        raise OperationError("np.stack of expressions accepts axis 0 only; transpose the result")
    return NODES["Stack"](list(arrays))


def _transposed(a: Any, axes: Any = None) -> Any:
    expr = as_node(a)
    if axes not in (None, (1, 0), [1, 0]) or expr.ndim > 2:
        raise OperationError(
            "np.transpose of an expression accepts matrices; tx.linalg.Transpose swaps the last two axes"
        )
    return expr.T


def _blocks(arrays: Any) -> Any:
    """Blocks as NumPy has them: a flat list of numbers and vectors is a vector."""
    entries = [e for row in arrays for e in (row if isinstance(row, (list, tuple)) else [row])]
    ranks = [as_node(entry).ndim for entry in entries]
    if max(ranks, default=0) > 2:
        raise OperationError("np.block of expressions accepts vectors and matrices; tx.Block joins the first two axes")
    if max(ranks, default=0) < 2 and not any(isinstance(row, (list, tuple)) for row in arrays):
        return NODES["Hstack"](list(arrays))
    return NODES["Block"](arrays)


def _clipped(a: Any, a_min: Any = None, a_max: Any = None) -> Any:
    expr = as_node(a)
    if a_min is not None:
        expr = NODES["Max"](expr, a_min)
    return expr if a_max is None else NODES["Min"](expr, a_max)


#: Functions of NumPy, each with the node that has the same operands.
_SAME = dict(
    re.findall(
        r"(\S+) (\S+)",
        """
        add Add       subtract Sub   multiply Mul  divide Div     matmul MatMul  power Power       float_power Power
        negative Neg  square Square  sqrt Sqrt     exp Exp        log Log        logaddexp LogSumExp
        absolute Abs  fabs Abs       sign Sign     maximum Max    minimum Min
        sin Sin       cos Cos        tan Tan       arcsin Asin    arccos Acos    arctan Atan       arctan2 Atan2
        sinh Sinh     cosh Cosh      tanh Tanh     equal Equality  less_equal Inequality less Less
        invert Not    logical_not Not
        vdot Dot      inner Dot      outer Outer   trace Trace    diag Diag      sum Sum           all All  any Any
        where Where   interp Linterp               linalg.inv Inv  linalg.solve Solve
        """,
    )
)

#: Others, with what they build; an argument that a function does not take is an error.
_MEANINGS: dict[str, Callable[..., Any]] = {
    "positive": as_node,
    "reciprocal": lambda x: 1.0 / x,
    "deg2rad": lambda x: x * (np.pi / 180.0),
    "radians": lambda x: x * (np.pi / 180.0),
    "rad2deg": lambda x: x * (180.0 / np.pi),
    "degrees": lambda x: x * (180.0 / np.pi),
    "greater_equal": lambda a, b: NODES["Inequality"](b, a),
    "greater": lambda a, b: NODES["Less"](b, a),
    "dot": _dot,
    "cross": _cross,
    "transpose": _transposed,
    "linalg.norm": lambda x, ord=None: NODES["Norm"](x, ord),
    "concatenate": _joined,
    "stack": _stacked,
    "hstack": lambda arrays: NODES["Hstack"](list(arrays)),
    "vstack": lambda arrays: NODES["Vstack"](list(arrays)),
    "block": _blocks,
    "clip": _clipped,
    "shape": lambda a: as_node(a).shape,
    "ndim": lambda a: as_node(a).ndim,
    "size": lambda a: int(np.prod(as_node(a).shape)),
}
#: Functions that no node means, with what is near.
_NEAR = {
    "fmax": "tx.Max, which passes NaN on where np.fmax drops it",
    "fmin": "tx.Min, which passes NaN on where np.fmin drops it",
    "not_equal": "a.key() != b.key() of structure, ~(a == b) of values",
    "hypot": "tx.Sqrt(x**2 + y**2), which overflows where the squares do",
}


def takes_expressions(name: str) -> bool:
    """Whether a function of NumPy accepts expressions."""
    return name in _SAME or name in _MEANINGS


def _meaning(name: str, expr: Any) -> Callable[..., Any]:
    """The node of a function of NumPy applied to expressions, of which `expr` is one. Raises TypeError."""
    if name in _NEAR:
        raise OperationError(f"np.{name} is not available for expressions.\n  fix: use {_NEAR[name]}")
    if name in _SAME:
        return NODES[_SAME[name]]
    if name in _MEANINGS:
        return _MEANINGS[name]
    if fix := spellings.spelled(name, "x", expr.ndim):
        raise OperationError(f"np.{name} is not available for expressions.\n  fix: {fix}")
    raise OperationError(
        f"np.{name} is not available for expressions.\n"
        "  fix: build it from tx nodes, or apply it to the numbers of the lowered function tx.lower(expr)"
    )
