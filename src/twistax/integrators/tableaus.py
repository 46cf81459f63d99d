"""Butcher tableaus, as data."""

from __future__ import annotations

from .tableau import ButcherTableau

__all__ = ["ALL", "EULER", "HEUN", "RK4"]

#: Euler's method.
EULER = ButcherTableau("Euler", 1, a=[[0.0]], b=[1.0], c=[0.0])

#: Heun's method of order 2, the explicit trapezoidal rule.
HEUN = ButcherTableau("Heun", 2, a=[[0.0, 0.0], [1.0, 0.0]], b=[0.5, 0.5], c=[0.0, 1.0])

#: The classical method of Runge and Kutta.
#: Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.1.
RK4 = ButcherTableau(
    "RK4",
    4,
    a=[[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    b=[1 / 6, 1 / 3, 1 / 3, 1 / 6],
    c=[0.0, 0.5, 0.5, 1.0],
)

#: Every explicit tableau, by order.
ALL: tuple[ButcherTableau, ...] = (EULER, HEUN, RK4)
