"""Python and NumPy operators on expressions: each builds a node."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, cast

import numpy as np

if TYPE_CHECKING:
    from .constraint import Equality, Inequality
    from .node import Expr


class Operators:
    """The operators of `Expr`. Nodes are looked up at call time, because they are built on this class."""

    # NumPy asks this method before it tries to loop over us: `array @ expr`, `np.sin(expr)`.
    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        from .numpy_protocol import apply_ufunc

        return apply_ufunc(ufunc, method, inputs, kwargs)

    def __array_function__(self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any) -> Any:
        from .numpy_protocol import apply_function

        return apply_function(func, args, kwargs)

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError(
            f"{type(self).__name__} is an expression and has no numbers yet.\n"
            "  fix: lower it with tx.lower(expr) and call the function, or build with tx.Stack / tx.Concat"
        )

    def __add__(self, other: Any) -> Expr:
        return _n().Add(self, other)

    def __radd__(self, other: Any) -> Expr:
        return _n().Add(other, self)

    def __sub__(self, other: Any) -> Expr:
        return _n().Sub(self, other)

    def __rsub__(self, other: Any) -> Expr:
        return _n().Sub(other, self)

    def __mul__(self, other: Any) -> Expr:
        return _n().Mul(self, other)

    def __rmul__(self, other: Any) -> Expr:
        return _n().Mul(other, self)

    def __truediv__(self, other: Any) -> Expr:
        return _n().Div(self, other)

    def __rtruediv__(self, other: Any) -> Expr:
        return _n().Div(other, self)

    def __matmul__(self, other: Any) -> Expr:
        return _n().MatMul(self, other)

    def __rmatmul__(self, other: Any) -> Expr:
        return _n().MatMul(other, self)

    def __pow__(self, other: Any) -> Expr:
        return _n().Power(self, other)

    def __rpow__(self, other: Any) -> Expr:
        return _n().Power(other, self)

    def __neg__(self) -> Expr:
        return _n().Neg(self)

    def __pos__(self) -> Expr:
        return cast("Expr", self)

    def __abs__(self) -> Expr:
        return _n().Abs(self)

    def __getitem__(self, index: Any) -> Expr:
        return _n().Index(self, index)

    @property
    def T(self) -> Expr:
        """Transpose."""
        return _n().Transpose(self)

    def __le__(self, other: Any) -> Inequality:
        return _n().Inequality(self, other)

    def __ge__(self, other: Any) -> Inequality:
        return _n().Inequality(other, self)

    def __eq__(self, other: Any) -> Equality:  # type: ignore[override]
        return _n().Equality(self, other)

    __hash__ = object.__hash__

    def __ne__(self, other: Any) -> bool:
        raise TypeError("!= has no meaning for expressions. To compare structure use a.key() != b.key().")

    def __lt__(self, other: Any) -> bool:
        raise TypeError("< builds no constraint: an optimiser cannot hold a strict inequality. Use <=.")

    def __gt__(self, other: Any) -> bool:
        raise TypeError("> builds no constraint: an optimiser cannot hold a strict inequality. Use >=.")

    def __bool__(self) -> bool:
        raise TypeError(
            f"{type(self).__name__} has no truth value before it is evaluated.\n"
            "  fix: use tx.Where or tx.Cond to choose inside an expression; compare structure with a.key() == b.key()"
        )

    def __len__(self) -> int:
        shape = cast("Expr", self).check_shape()
        if not shape:
            raise TypeError(f"{self!r} is a scalar and has no length")
        return shape[0]

    def __iter__(self) -> Iterator[Expr]:
        return (self[i] for i in range(len(self)))

    def __contains__(self, item: Any) -> bool:
        raise TypeError("'in' has no meaning for expressions: == builds a constraint. Compare keys instead.")


def _n() -> Any:
    """The package with all nodes."""
    return sys.modules[__package__ or ""]
