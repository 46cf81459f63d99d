"""Tableaus of order one to four."""

from __future__ import annotations

from ..tableau import ButcherTableau, lower_triangle

__all__ = ["BOGACKI_SHAMPINE3", "EULER", "HEUN", "RK4"]

#: Euler's method.
EULER = ButcherTableau("Euler", 1, a=[[0.0]], b=[1.0], c=[0.0])

#: Heun's method of order 2, the explicit trapezoidal rule.
HEUN = ButcherTableau("Heun", 2, a=[[0.0, 0.0], [1.0, 0.0]], b=[0.5, 0.5], c=[0.0, 1.0])

#: The pair 3(2) of Bogacki and Shampine; its last stage is the first of the next step.
#: Source: Bogacki, Shampine, A 3(2) pair of Runge-Kutta formulas, Applied Mathematics Letters 2 (1989).
BOGACKI_SHAMPINE3 = ButcherTableau(
    "Bogacki-Shampine 3(2)",
    3,
    a=lower_triangle([[1 / 2], [0, 3 / 4], [2 / 9, 1 / 3, 4 / 9]]),
    b=[2 / 9, 1 / 3, 4 / 9, 0],
    c=[0, 1 / 2, 3 / 4, 1],
    embedded_order=2,
    b_embedded=[7 / 24, 1 / 4, 1 / 3, 1 / 8],
)

#: The classical method of Runge and Kutta.
#: Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.1.
RK4 = ButcherTableau(
    "RK4",
    4,
    a=lower_triangle([[1 / 2], [0, 1 / 2], [0, 0, 1]]),
    b=[1 / 6, 1 / 3, 1 / 3, 1 / 6],
    c=[0, 1 / 2, 1 / 2, 1],
)
