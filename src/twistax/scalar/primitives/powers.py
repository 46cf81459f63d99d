"""Whole powers, whose derivative n x^(n-1) is a power, too."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from .entry import Operation, Slope
from .interface import Graph
from .operations import OPERATIONS

Number = TypeVar("Number")

_MUL, _DIV, _NEG, _POW = (OPERATIONS[name] for name in ("mul", "div", "neg", "pow"))


def by_squaring(multiply: Callable[[Number, Number], Number], x: Number, n: int) -> Number:
    """x^n for n > 0, by at most 2 log2(n) products."""
    result: Number | None = None
    while True:
        if n & 1:
            result = x if result is None else multiply(result, x)
        n >>= 1
        if not n:
            return x if result is None else result
        x = multiply(x, x)


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class WholePower(Operation):
    """x^n. Code writers expand it to products of x, or of 1 / x.

    No product leaves the range of numbers unless the power does: 1 / (x x x) is zero, or infinite, where x x x is too
    large, or too small, and x^-3 is not.

    Attributes:
        exponent: n, none of -1, 0, 1 and 2, which are other operations.
    """

    exponent: int


@functools.cache
def whole_power(n: int) -> WholePower:
    """The operation x^n."""

    def computed(x: Any) -> Any:
        return by_squaring(operator.mul, 1 / x if n < 0 else x, abs(n))

    def written(g: Graph, x: int) -> int:
        return by_squaring(g.mul, g.div(g.one, x) if n < 0 else x, abs(n))

    def slopes(g: Graph, a: tuple[int, ...], y: int) -> Sequence[Slope]:
        factor = g.constant(float(n))
        if n > 0:
            return [g.mul(factor, power(g, a[0], n - 1))]
        # x^(n-1) may be zero in floating point where its product with a derivative of x is not.
        return [(g.mul(factor, y), g.div(g.one, a[0]))]

    return WholePower(
        name=f"power {n}",
        number=computed,
        array=computed,
        parity=-1 if n % 2 else 1,
        is_power=True,
        partials=slopes,
        maker=lambda g: lambda x: power(g, x, n),
        written=lambda g: functools.partial(written, g),
        exponent=n,
    )


def power(g: Graph, x: int, n: int) -> int:
    """The node of x^n for a whole number n; for x^-n that of (1 / x)^n."""
    if n > 1 and (below := g.reciprocal_of(x)) is not None:
        return power(g, below, -n)
    if n in (0, 1):
        return x if n else g.one
    if n in (-1, 2):
        return g.mul(x, x) if n > 0 else g.div(g.one, x)
    return g.node(whole_power(n), x)


def factors_in_range(g: Graph, a: int, b: int) -> tuple[int, int] | None:
    """Two factors of a b, for b = c y^-n, that are representable if a and the product are; None: a and b themselves.

    a y^-2 is (a / y) / y, and a y^-n is (a / y) y^(1-n) where y^(1-n) is known: each lies between a and the product.
    (a d) y^-2 is (a / y) (d / y) where a / y is known. The first is what JAX makes of the derivative of a power, the
    other of that of a quotient.
    """
    c, base = g.one, b
    if g.nodes[b][0] is _MUL:  # with a number, before or behind the rest
        c, base = sorted(g.nodes[b][1:], key=lambda k: g.numbers[k] is None)
        if g.numbers[c] is None:
            return None
    operation, *operands = g.nodes[base]
    if isinstance(operation, WholePower) and operation.exponent == -2:
        return _over_square(g, a, c, operands[0])
    if isinstance(operation, WholePower) and operation.exponent < 0:
        above = g.known(whole_power(operation.exponent + 1), operands[0])
    elif operation is _POW and (n := g.numbers[operands[1]]) is not None and n < -1.0:
        above = g.known(_POW, operands[0], g.constant(n + 1.0))
    else:
        return None
    return None if above is None else (g.mul(c, above), g.div(a, operands[0]))


def _over_square(g: Graph, a: int, c: int, y: int) -> tuple[int, int]:
    """Two factors of c a y^-2."""
    negative = g.nodes[a][0] is _NEG
    product = g.nodes[g.nodes[a][1] if negative else a]
    if product[0] is _MUL:
        for factor, other in (product[1:], product[:0:-1]):
            if (quotient := g.known(_DIV, factor, y)) is not None:
                return g.mul(c, quotient), g.div(g.neg(other) if negative else other, y)
    inverse = g.div(g.one, y)
    return g.mul(g.mul(a, c), inverse), inverse
