"""Symmetric compositions, as data."""

from __future__ import annotations

from .composition import Composition

__all__ = ["ALL", "KAHAN_LI6", "KAHAN_LI8", "STRANG", "SUZUKI4"]

_OUTER = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))

#: Source: Strang, On the construction and comparison of difference schemes (1968).
STRANG = Composition("Strang", 2, [1.0])

#: Source: Suzuki, Fractal decomposition of exponential operators (1990).
SUZUKI4 = Composition("Suzuki 4", 4, [_OUTER, _OUTER, 1.0 - 4.0 * _OUTER, _OUTER, _OUTER])

#: Nine stages. Source: Kahan and Li, Composition constants for raising the orders of unconventional schemes (1997).
KAHAN_LI6 = Composition(
    "Kahan-Li 6",
    6,
    [
        0.39216144400731413927925056,
        0.33259913678935943859974864,
        -0.70624617255763935980996482,
        0.08221359629355080023149045,
        0.79854399093482996339895035,
        0.08221359629355080023149045,
        -0.70624617255763935980996482,
        0.33259913678935943859974864,
        0.39216144400731413927925056,
    ],
)

#: Seventeen stages. Source: as `KAHAN_LI6`.
KAHAN_LI8 = Composition(
    "Kahan-Li 8",
    8,
    [
        0.13020248308889008087881763,
        0.56116298177510838456196441,
        -0.38947496264484728640807860,
        0.15884190655515560089621075,
        -0.39590389413323757733623154,
        0.18453964097831570709183254,
        0.25837438768632204729397911,
        0.29501172360931029887096624,
        -0.60550853383003451169892108,
        0.29501172360931029887096624,
        0.25837438768632204729397911,
        0.18453964097831570709183254,
        -0.39590389413323757733623154,
        0.15884190655515560089621075,
        -0.38947496264484728640807860,
        0.56116298177510838456196441,
        0.13020248308889008087881763,
    ],
)

#: Every composition, by order.
ALL: tuple[Composition, ...] = (STRANG, SUZUKI4, KAHAN_LI6, KAHAN_LI8)
