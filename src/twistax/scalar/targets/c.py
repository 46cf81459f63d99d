"""Types, numbers and operations in C99.

Operations on real numbers have the semantics of JAX, also where the libm function of the same name differs: max and min
propagate NaN. Integers wrap around and never trap on division by zero, as in XLA.
"""

from __future__ import annotations

import dataclasses
import math
import string
from collections.abc import Sequence
from decimal import Decimal
from typing import Any

import numpy as np

from ...errors import ModelError
from ..primitives.entry import Operation


@dataclasses.dataclass(frozen=True)
class CType:
    """A scalar type of C and the corresponding NumPy type."""

    name: str
    dtype: np.dtype[Any]

    @property
    def suffix(self) -> str:
        """The suffix of functions of libm and of literals."""
        return "f" if self.dtype == np.float32 else ""

    @property
    def unsigned(self) -> str:
        """The type in which integers of this one are added without overflow."""
        return "uint64_t" if self.dtype.itemsize == 8 else "uint32_t"

    def literal(self, value: Any) -> str:
        """A number as an operand; negative ones in parentheses.

        Real numbers stand in decimals where these are short and exactly the number, else in hexadecimals, which the
        standard wants rounded correctly (C99, 6.4.4.2).
        """
        if self.dtype.kind == "b":
            return "1" if value else "0"
        if self.dtype.kind != "f":
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
        raise ModelError(f"the system uses numbers of type {dtype.name}, which C99 does not have")
    return CType(names[dtype.name], dtype)


def expression(operation: Operation, argument: CType, result: CType, values: Sequence[str]) -> str:
    """An operation on values of a type as an expression.

    Raises:
        ModelError: C has no such operation.
    """
    form = operation.c.of(argument.dtype)
    if form is None:
        raise ModelError(f"C99 code does not support the operation {operation.name} for {argument.name}")
    words = {"T": argument.name, "R": result.name, "U": argument.unsigned, "f": argument.suffix}
    if result.dtype.kind in "iu":
        ends = np.iinfo(result.dtype)
        words |= {"least": result.literal(ends.min), "most": result.literal(ends.max)}
    return string.Template(form).substitute(words, **dict(zip("abc", values)))
