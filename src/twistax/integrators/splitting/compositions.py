"""Symmetric compositions: their coefficients, which are checked at construction."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..tableaus import Coefficients

__all__ = ["ALL", "KAHAN_LI6", "KAHAN_LI8", "STRANG", "SUZUKI4", "Composition"]

#: Weights are given in double precision; sums of them may be off by a few units in the last place.
_TOLERANCE = 1e-14


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Composition(Coefficients):
    """A symmetric composition of a symmetric method of order 2: successive steps of length w_1 h, ..., w_s h.

    `order` is the order of the composition. From order 4 on, some weights are negative: these steps go backward in
    time.

    Attributes:
        name: its name in tables.
        order: 2, 4, 6, ...
        weights: (s,), read-only and symmetric; they sum to 1, and from order 4 on their cubes, from order 6
            on also their fifth powers and so on, sum to 0.

    Raises:
        ModelError: an invalid order, a wrong shape, a value that is not finite, or a wrong sum.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section V.3.
    """

    name: str
    order: int
    weights: Any
    kind = "composition"

    def __post_init__(self) -> None:
        if not isinstance(self.order, int) or self.order < 2 or self.order % 2:
            raise self._error(f"order must be an even whole number, got {self.order!r}")
        weights = self._read("weights")
        if weights.ndim != 1 or not weights.size:
            raise self._error(f"weights must have shape (s,), got {weights.shape}")
        if not np.array_equal(weights, weights[::-1]):
            raise self._error("weights must read the same backwards")
        for power in range(1, self.order, 2):
            wanted = 1.0 if power == 1 else 0.0
            total = (weights**power).sum()
            if abs(total - wanted) > _TOLERANCE * np.abs(weights**power).sum():
                what = "weights" if power == 1 else f"powers {power} of the weights"
                raise self._error(f"{what} must sum to {wanted:g} for order {self.order}, but they sum to {total:.16g}")

    @property
    def stages(self) -> int:
        """s, the number of weights."""
        return int(self.weights.size)

    @property
    def nodes(self) -> np.ndarray:
        """The midpoints of the stages, in steps: the times of the momentum changes."""
        return np.cumsum(self.weights) - 0.5 * self.weights

    @property
    def between(self) -> np.ndarray:
        """(s + 1,): the distances to the first node, between nodes, and from the last node to the end, in steps."""
        return 0.5 * (np.append(0.0, self.weights) + np.append(self.weights, 0.0))


def _mirrored(*half: float) -> list[float]:
    """The palindrome of weights that are given up to the middle one."""
    return [*half, *reversed(half[:-1])]


_OUTER = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))

#: Source: Strang, On the construction and comparison of difference schemes (1968).
STRANG = Composition("Strang", 2, [1.0])

#: Source: Suzuki, Fractal decomposition of exponential operators (1990).
SUZUKI4 = Composition("Suzuki 4", 4, [_OUTER, _OUTER, 1.0 - 4.0 * _OUTER, _OUTER, _OUTER])

# fmt: off
#: Nine stages. Source: Kahan and Li, Composition constants for raising the orders of unconventional schemes (1997).
KAHAN_LI6 = Composition("Kahan-Li 6", 6, _mirrored(
    0.39216144400731413927925056, 0.33259913678935943859974864, -0.70624617255763935980996482,
    0.08221359629355080023149045, 0.79854399093482996339895035,
))

#: Seventeen stages. Source: as `KAHAN_LI6`.
KAHAN_LI8 = Composition("Kahan-Li 8", 8, _mirrored(
    0.13020248308889008087881763, 0.56116298177510838456196441, -0.38947496264484728640807860,
    0.15884190655515560089621075, -0.39590389413323757733623154, 0.18453964097831570709183254,
    0.25837438768632204729397911, 0.29501172360931029887096624, -0.60550853383003451169892108,
))
# fmt: on

#: Every composition, by order.
ALL: tuple[Composition, ...] = (STRANG, SUZUKI4, KAHAN_LI6, KAHAN_LI8)
