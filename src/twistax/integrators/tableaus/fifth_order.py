"""Pairs of order five with an embedded solution of order four."""

from __future__ import annotations

from ..tableau import ButcherTableau, lower_triangle

__all__ = ["DORMAND_PRINCE5", "TSIT5"]

#: The pair 5(4) of Dormand and Prince; its last stage is the first of the next step.
#: Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), table II.5.2.
DORMAND_PRINCE5 = ButcherTableau(
    "Dormand-Prince 5(4)",
    5,
    a=lower_triangle(
        [
            [1 / 5],
            [3 / 40, 9 / 40],
            [44 / 45, -56 / 15, 32 / 9],
            [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
            [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
            [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
        ]
    ),
    b=[35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0],
    c=[0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1],
    embedded_order=4,
    b_embedded=[5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40],
)

#: The pair 5(4) of Tsitouras; its last stage is the first of the next step.
#: Source: Tsitouras, Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying assumption,
#: Computers and Mathematics with Applications 62 (2011), table 1, to double precision.
TSIT5 = ButcherTableau(
    "Tsitouras 5(4)",
    5,
    a=lower_triangle(
        [
            [0.161],
            [-0.008480655492356989, 0.335480655492357],
            [2.8971530571054935, -6.359448489975075, 4.3622954328695815],
            [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525],
            [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383],
            [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774],
        ]
    ),
    b=[0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774, 0],
    c=[0, 0.161, 0.327, 0.9, 0.9800255409045097, 1, 1],
    embedded_order=4,
    b_embedded=[
        0.09468075576583945,
        0.009183565540343254,
        0.4877705284247616,
        1.234297566930479,
        -2.7077123499835256,
        1.866628418170587,
        0.015151515151515152,
    ],
)
