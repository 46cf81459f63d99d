"""Tableaus of implicit methods, as data."""

from __future__ import annotations

from math import sqrt

from .collocation import CollocationTableau

__all__ = ["GAUSS_LEGENDRE4", "GAUSS_LEGENDRE6", "IMPLICIT", "RADAU_IIA3", "RADAU_IIA5"]

_3, _6, _15 = sqrt(3.0), sqrt(6.0), sqrt(15.0)

#: Radau IIA with two stages. L-stable.
#: Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.5.
RADAU_IIA3 = CollocationTableau(
    "Radau IIA 3",
    3,
    a=[[5 / 12, -1 / 12], [3 / 4, 1 / 4]],
    b=[3 / 4, 1 / 4],
    c=[1 / 3, 1],
)

#: Radau IIA with three stages, the method of the program RADAU5. L-stable.
#: Source: as above.
RADAU_IIA5 = CollocationTableau(
    "Radau IIA 5",
    5,
    a=[
        [(88 - 7 * _6) / 360, (296 - 169 * _6) / 1800, (-2 + 3 * _6) / 225],
        [(296 + 169 * _6) / 1800, (88 + 7 * _6) / 360, (-2 - 3 * _6) / 225],
        [(16 - _6) / 36, (16 + _6) / 36, 1 / 9],
    ],
    b=[(16 - _6) / 36, (16 + _6) / 36, 1 / 9],
    c=[(4 - _6) / 10, (4 + _6) / 10, 1],
)

#: Gauss with two stages. A-stable, symmetric.
#: Source: as above.
GAUSS_LEGENDRE4 = CollocationTableau(
    "Gauss-Legendre 4",
    4,
    a=[[1 / 4, 1 / 4 - _3 / 6], [1 / 4 + _3 / 6, 1 / 4]],
    b=[1 / 2, 1 / 2],
    c=[1 / 2 - _3 / 6, 1 / 2 + _3 / 6],
)

#: Gauss with three stages. A-stable, symmetric.
#: Source: as above.
GAUSS_LEGENDRE6 = CollocationTableau(
    "Gauss-Legendre 6",
    6,
    a=[
        [5 / 36, 2 / 9 - _15 / 15, 5 / 36 - _15 / 30],
        [5 / 36 + _15 / 24, 2 / 9, 5 / 36 - _15 / 24],
        [5 / 36 + _15 / 30, 2 / 9 + _15 / 15, 5 / 36],
    ],
    b=[5 / 18, 4 / 9, 5 / 18],
    c=[1 / 2 - _15 / 10, 1 / 2, 1 / 2 + _15 / 10],
)

#: Every implicit tableau, by order.
IMPLICIT: tuple[CollocationTableau, ...] = (RADAU_IIA3, GAUSS_LEGENDRE4, RADAU_IIA5, GAUSS_LEGENDRE6)
