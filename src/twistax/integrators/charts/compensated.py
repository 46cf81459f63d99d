"""States in single precision, stored between steps with what rounding takes off them: compensated addition.

Without it a million steps in float32 lose 1 % of a time: each adds little to much, and rounds it the same way. It is
in every step, however many are taken, so that their number stays an input.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ...groups import Product
from .chart import Block, Chart, Coordinates, StateCoordinates, coordinates_of

#: Numbers that are rounded coarser than this are compensated: those of float32, not those of float64.
_COARSE = 1e-10


class Compensated(Coordinates):
    """Coordinates whose stored numbers y + r come as (y, r): r is what rounding took off y so far.

    A step that moves y by d makes s = fl(y + (d + r)) of it, and r becomes the error of that sum, to the last bit. The
    numbers of a rotation are those of its quaternion, of which d = q (Exp(z) - 1); putting it back to length one is
    such a sum too. In double precision r is left out.

    Source: Neumaier, Rundungsfehleranalyse einiger Verfahren zur Summation endlicher Summen (1974); Knuth, The Art of
    Computer Programming 2 (1997), section 4.2.2, theorem B, for the error of a sum.
    """

    def __init__(self, plain: Coordinates, count: int) -> None:
        self._plain, self._count = plain, count

    def _high(self, y: Block) -> Block:
        return y[: self._count]

    def enter(self, g: jax.Array) -> Block:
        y = self._plain.enter(g)
        coarse = float(jnp.finfo(g.dtype).eps) > _COARSE
        return (*y, *map(jnp.zeros_like, y)) if coarse else y

    def value(self, y: Block) -> jax.Array:
        return self._plain.value(self._high(y))

    def move(self, y: Block, z: Block) -> Block:
        return self._added(y, lambda high: self._plain.shift(high, z), lambda: self._plain.move(y, z))

    def settle(self, moved: Block) -> Block:
        return self._added(moved, self._plain.settling, lambda: self._plain.settle(moved))

    def _added(self, y: Block, shift: Callable[[Block], Block], plain: Callable[[], Block]) -> Block:
        """y and what a shift of its numbers makes of it; `plain` where nothing is carried."""
        high, low = self._high(y), y[self._count :]
        if not low:
            return plain()
        moved = shift(high)
        if not moved:
            return y
        pairs = [_sum(a, b + r) for a, b, r in zip(high, moved, low, strict=True)]
        return (*(s for s, _ in pairs), *(r for _, r in pairs))

    def rate(self, omega: jax.Array) -> Block:
        return self._plain.rate(omega)

    def tangent(self, z: Block) -> jax.Array:
        return self._plain.tangent(z)

    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        return self._plain.slope(z, self._high(moved), omega)

    def first_slope(self, y: Block, omega: Block) -> Block:
        return self._plain.first_slope(self._high(y), omega)

    def deviation(self, e: Block, after: Block) -> Block:
        return self._plain.deviation(e, self._high(after))

    def sizes(self, before: Block, after: Block) -> Block:
        return self._plain.sizes(self._high(before), self._high(after))


def _sum(a: jax.Array, b: jax.Array) -> tuple[jax.Array, jax.Array]:
    """fl(a + b), and its error, which has no derivative."""
    s = a + b
    fixed_a, fixed_b, fixed_s = jax.lax.stop_gradient((a, b, s))
    rest = fixed_s - fixed_a
    return s, (fixed_a - (fixed_s - rest)) + (fixed_b - rest)


@functools.lru_cache(maxsize=256)
def compensated(chart: Chart, group: Product) -> StateCoordinates:
    """The coordinates of a state in a chart, for steps that follow each other; the same object for equal arguments.

    Groups that a chart does not know move by their own maps, as they are.
    """
    parts: dict[str, Any] = {}
    for name, part in coordinates_of(chart, group).parts.items():
        count = part.numbers
        parts[name] = part if count is None else Compensated(part, count)
    return StateCoordinates(parts)
