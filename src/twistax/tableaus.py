"""Butcher tableaus: `tx.tableaus.RK4` and the others, `tx.tableaus.ALL`; make your own with `ButcherTableau`."""

from .integrators.tableau import ButcherTableau
from .integrators.tableaus import ALL, EULER, HEUN, RK4

__all__ = ["ALL", "EULER", "HEUN", "RK4", "ButcherTableau"]
