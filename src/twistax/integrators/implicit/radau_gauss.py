"""Tableaus of implicit methods, as data."""

from __future__ import annotations

from math import sqrt

from .collocation import CollocationTableau

__all__ = ["GAUSS_LEGENDRE4", "GAUSS_LEGENDRE6", "IMPLICIT", "RADAU_IIA3", "RADAU_IIA5", "RADAU_IIA9"]

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

#: Radau IIA with five stages: the last row of a is b. L-stable.
#: Source: nodes and weights found in sixty digits from the conditions of collocation; as above, and Hairer, Wanner,
#: Stiff differential equations solved by Radau methods (1999), for their use.
_RADAU9 = [
    [0.072998864317903324, -0.026735331107945572, 0.018676929763984354, -0.01287910609330644, 0.0050428392338820152],
    [0.15377523147918247, 0.14621486784749351, -0.03644456890512809, 0.021233063119304719, -0.0079355799027287775],
    [0.14006304568480987, 0.29896712949128348, 0.16758507013524896, -0.033969101686617747, 0.010944288744192252],
    [0.14489430810953476, 0.27650006876015923, 0.32579792291042103, 0.12875675325490976, -0.015708917378805328],
    [0.14371356079122594, 0.28135601514946206, 0.31182652297574125, 0.22310390108357074, 0.04],
]
RADAU_IIA9 = CollocationTableau(
    "Radau IIA 9",
    9,
    a=_RADAU9,
    b=_RADAU9[-1],
    c=[0.057104196114517682, 0.27684301363812383, 0.58359043236891682, 0.86024013565621945, 1],
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
IMPLICIT: tuple[CollocationTableau, ...] = (
    RADAU_IIA3,
    GAUSS_LEGENDRE4,
    RADAU_IIA5,
    GAUSS_LEGENDRE6,
    RADAU_IIA9,
)
