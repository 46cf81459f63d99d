"""How operations are written in CasADi, whose scalars are all real numbers; a form takes the module and expressions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from .operation import Forms, everywhere

__all__ = ["converted", "function", "same", "whole"]

Form: TypeAlias = Callable[..., Any]


def function(name: str) -> Forms:
    """One of CasADi's, on all types."""
    return everywhere(lambda casadi, *a: getattr(casadi, name)(*a))


def same(casadi: Any, a: Any) -> Any:
    return a


def whole(casadi: Any, a: Any) -> Any:
    """The whole part, towards zero."""
    return casadi.sign(a) * casadi.floor(casadi.fabs(a))


def converted(dtype: np.dtype[Any]) -> Forms:
    """To a type; there are no complex numbers."""
    if dtype.kind == "c":
        return Forms()
    if dtype.kind == "b":
        return Forms(lambda casadi, a: a != 0, lambda casadi, a: a != 0, same)
    return Forms(whole if dtype.kind in "iu" else same, same, same)
