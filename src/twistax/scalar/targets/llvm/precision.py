"""The two precisions of numbers, as formulas of elementary functions need them; and which one they are computed in."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Protocol


class Writer(Protocol):
    """What formulas are written with; see `Code`."""

    module: Any

    def constant(self, kind: str, value: Any) -> str: ...
    def instruction(self, name: str, kind: str, *arguments: str) -> str: ...
    def intrinsic(self, name: str, kind: str, *arguments: str) -> str: ...
    def convert(self, name: str, source: str, target: str, value: str) -> str: ...
    def select(self, kind: str, condition: str, a: str, b: str) -> str: ...
    def chosen(self, comparison: str, kind: str, a: str, b: str) -> str: ...
    def multiply_add(self, kind: str, a: str, b: str, c: str) -> str: ...
    def polynomial(self, kind: str, x: str, coefficients: Any) -> str: ...


@dataclasses.dataclass(frozen=True)
class Precision:
    """A precision in binary format (IEEE 754).

    Attributes:
        kind, integer: LLVM's names of the type, and of the integers with as many bits.
        digits: of the fraction, in bits.
        bias: of the exponent.
    """

    kind: str
    integer: str
    digits: int
    bias: int

    @property
    def rounding(self) -> float:
        """1.5 times 2 to the number of digits: added to a number it leaves the nearest integer in the lowest bits."""
        return 1.5 * 2.0**self.digits

    def power_of_two(self, code: Writer, k: str) -> str:
        """2^k of an integer."""
        biased = code.instruction("add", self.integer, k, code.constant(self.integer, self.bias))
        shifted = code.instruction("shl", self.integer, biased, code.constant(self.integer, self.digits))
        return code.convert("bitcast", self.integer, self.kind, shifted)


DOUBLE, SINGLE = Precision("double", "i64", 52, 1023), Precision("float", "i32", 23, 127)


def computed_in(code: Writer, kind: str) -> Precision:
    """The precision in which functions of a type are computed: double where the processor has the time."""
    return SINGLE if kind == "float" and code.module.processor.narrow else DOUBLE


def in_precision(code: Writer, function: Callable[[Writer, Precision, str], str], kind: str, x: str) -> str:
    """A function of a number of a type, computed in the precision of `computed_in`."""
    precision = computed_in(code, kind)
    if precision.kind == kind:
        return function(code, precision, x)
    result = function(code, precision, code.convert("fpext", kind, precision.kind, x))
    return code.convert("fptrunc", precision.kind, kind, result)
