"""How each operation of a scalar program is written in CasADi, whose scalars are all real numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...errors import ModelError
from ..scalar.operations import Convert, Operation, by_primitive

__all__ = ["CasadiForms"]


class CasadiForms:
    """The operations with the functions of CasADi.

    Args:
        casadi: the module.
    """

    def __init__(self, casadi: Any) -> None:
        self._casadi = casadi
        self._forms = {by_primitive[name]: form for name, form in _forms(casadi).items()}

    def __call__(self, operation: Operation, own: np.dtype[Any], types: list[np.dtype[Any]], *arguments: Any) -> Any:
        """The expression of an operation; `own` is the type of its result, `types` those of its arguments.

        Raises:
            ModelError: CasADi has no such operation.
        """
        if isinstance(operation, Convert):
            return self._converted(own, types[0], arguments[0])
        kind = types[-1].kind
        form = self._forms.get(operation)
        if form is None or (kind in "iu" and operation.name in _REAL_ONLY) or kind == "c":
            raise ModelError(f"CasADi has no {operation.name} of {types[-1].name}")
        if kind in "iu" and operation.name == "div":
            return _whole(self._casadi, arguments[0] / arguments[1])
        return form(*arguments)

    def _converted(self, result: np.dtype[Any], own: np.dtype[Any], a: Any) -> Any:
        if result.kind == "c":
            raise ModelError("CasADi has no complex numbers")
        if result.kind == "b" and own.kind != "b":
            return a != 0
        return _whole(self._casadi, a) if result.kind in "iu" and own.kind == "f" else a


#: Bits of integers CasADi does not know; truth values it does.
_REAL_ONLY = frozenset(("and", "or", "xor", "not"))


def _whole(casadi: Any, a: Any) -> Any:
    """The whole part, towards zero."""
    return casadi.sign(a) * casadi.floor(casadi.fabs(a))


def _forms(casadi: Any) -> Mapping[str, Callable[..., Any]]:
    """The operations by their names."""
    plain = ("sign", "floor", "ceil", "sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos")
    more = ("atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "fmax", "fmin", "fmod", "fabs")
    own = {name: getattr(casadi, name) for name in (*plain, *more)}
    larger, smaller = own.pop("fmax"), own.pop("fmin")
    return {
        **{name: own[name] for name in own if name not in ("fmod", "fabs")},
        "abs": own["fabs"],
        "rem": own["fmod"],
        "max": larger,
        "min": smaller,
        "clamp": lambda low, x, high: smaller(larger(low, x), high),
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "neg": lambda a: -a,
        "pow": lambda a, b: a**b,
        "cbrt": lambda a: casadi.sign(a) * casadi.fabs(a) ** (1.0 / 3.0),
        "exp2": lambda a: 2.0**a,
        "logistic": lambda a: 1.0 / (1.0 + casadi.exp(-a)),
        # Where JAX stops, a rule of its own takes over; CasADi differentiates what the rule stands for.
        "stop_gradient": lambda a: a,
        "eq": lambda a, b: a == b,
        "ne": lambda a, b: a != b,
        "lt": lambda a, b: a < b,
        "le": lambda a, b: a <= b,
        "gt": lambda a, b: a > b,
        "ge": lambda a, b: a >= b,
        "is_finite": lambda a: casadi.fabs(a) < np.inf,
        "and": casadi.logic_and,
        "or": casadi.logic_or,
        "xor": lambda a, b: a != b,
        "not": casadi.logic_not,
        "select": casadi.if_else,
    }
