"""Elementary functions in two precisions: the exponential and functions derived from it.

`trigonometry.py` has sine and cosine. The exponential: x = k log 2 + r with |r| <= log(2) / 2 (W. J. Cody and
W. Waite, Software Manual for the Elementary Functions, 1980), and a Taylor series in r. Below 2 units in the last
place.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Protocol

#: log 2 in two pieces, of which the first has so few bits that a k of any exponent times it is exact.
_LOG_TWO = {
    "double": (6.93147180369123816490e-01, 1.90821492927058770002e-10),
    "float": (0.693145751953125, 1.428606820309417e-06),
}
#: (e^r - 1 - r) / r^2.
_SERIES = {kind: [1.0 / math.factorial(k) for k in range(2, most)] for kind, most in (("double", 14), ("float", 8))}
#: Beyond these bounds of x nothing changes in e^x, and below the last in e^x - 1.
_BOUNDS = {"double": (-800.0, 800.0, -60.0), "float": (-110.0, 110.0, -30.0)}


class Writer(Protocol):
    """The interface by which formulas write code; see `Code`."""

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
    """The precision in which functions of a type are computed: double if the processor is fast enough."""
    return SINGLE if kind == "float" and code.module.processor.narrow else DOUBLE


def in_precision(code: Writer, function: Callable[[Writer, Precision, str], str], kind: str, x: str) -> str:
    """A function of a number of a type, computed in the precision of `computed_in`."""
    precision = computed_in(code, kind)
    if precision.kind == kind:
        return function(code, precision, x)
    result = function(code, precision, code.convert("fpext", kind, precision.kind, x))
    return code.convert("fptrunc", precision.kind, kind, result)


def exponential(code: Writer, precision: Precision, x: str) -> str:
    """e^x."""
    least, most, _ = _BOUNDS[precision.kind]
    series, high, low = _reduced(code, precision, x, least, most)
    scale = precision.power_of_two(code, high)
    sized = code.multiply_add(precision.kind, scale, series, scale)
    return code.instruction("fmul", precision.kind, sized, precision.power_of_two(code, low))


def exponential_less_one(code: Writer, precision: Precision, x: str) -> str:
    """e^x - 1, accurate for small x."""
    # (2^h s + (2^h - 2^-l)) 2^l with k = h + l and the series s.
    _, most, least = _BOUNDS[precision.kind]
    series, high, low = _reduced(code, precision, x, least, most)
    scale = precision.power_of_two(code, high)
    down = precision.power_of_two(
        code, code.instruction("sub", precision.integer, code.constant(precision.integer, 0), low)
    )
    rest = code.instruction("fsub", precision.kind, scale, down)
    sized = code.multiply_add(precision.kind, scale, series, rest)
    result = code.instruction("fmul", precision.kind, sized, precision.power_of_two(code, low))
    return code.intrinsic("copysign", precision.kind, result, x)


def hyperbolic_tangent(code: Writer, precision: Precision, x: str) -> str:
    """By e^(2 |x|) - 1."""
    d, two = precision.kind, code.constant(precision.kind, 2.0)
    size = code.chosen("fcmp olt", d, code.constant(d, 30.0), code.intrinsic("fabs", d, x))
    raised = exponential_less_one(code, precision, code.instruction("fmul", d, two, size))
    # Near zero a / (a + 2), beyond 1 - 2 / (a + 2): one division for both.
    large = code.instruction("fcmp ogt", d, size, code.constant(d, 0.55))
    above, below = code.select(d, large, two, raised), code.instruction("fadd", d, raised, two)
    near = code.instruction("fdiv", d, above, below)
    far = code.instruction("fsub", d, code.constant(d, 1.0), near)
    return code.intrinsic("copysign", d, code.select(d, large, far, near), x)


def _reduced(code: Writer, precision: Precision, x: str, least: float, most: float) -> tuple[str, str, str]:
    """e^r - 1, and k as the sum of two halves, of x between bounds beyond which nothing changes; NaN stays."""
    d = precision.kind
    x = code.select(d, code.instruction("fcmp olt", d, x, code.constant(d, least)), code.constant(d, least), x)
    x = code.select(d, code.instruction("fcmp ogt", d, x, code.constant(d, most)), code.constant(d, most), x)
    rounding = code.constant(d, precision.rounding)
    shifted = code.multiply_add(d, x, code.constant(d, 1.0 / math.log(2.0)), rounding)
    k, r = code.instruction("fsub", d, shifted, rounding), x
    for piece in _LOG_TWO[d]:
        r = code.multiply_add(d, k, code.constant(d, -piece), r)
    square = code.instruction("fmul", d, r, r)
    # Even and odd powers side by side: half as many products wait for one another.
    even, odd = (code.polynomial(d, square, _SERIES[d][first::2]) for first in (0, 1))
    series = code.multiply_add(d, square, code.multiply_add(d, r, odd, even), r)
    bits, zero = (code.convert("bitcast", d, precision.integer, a) for a in (shifted, rounding))
    count = code.instruction("sub", precision.integer, bits, zero)
    high = code.instruction("ashr", precision.integer, count, code.constant(precision.integer, 1))
    return series, high, code.instruction("sub", precision.integer, count, high)
