"""Whole powers, with the derivative n x^(n-1) by powers themselves."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from .entry import Operation, Slope

if TYPE_CHECKING:
    from .graph import Graph

Number = TypeVar("Number")


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
    """x^n. Emitters write products of x, or of 1 / x.

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
        partials=slopes,
        maker=lambda g: lambda x: power(g, x, n),
        written=lambda g: functools.partial(written, g),
        exponent=n,
    )


def power(g: Graph, x: int, n: int) -> int:
    """The node of x^n for a whole number n; of (1 / x)^n that of x^-n."""
    if n > 1 and (below := g.reciprocal_of(x)) is not None:
        return power(g, below, -n)
    if n in (0, 1):
        return x if n else g.one
    if n in (-1, 2):
        return g.mul(x, x) if n > 0 else g.div(g.one, x)
    return g.node(whole_power(n), x)
