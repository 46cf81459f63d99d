"""Butcher tableaus: `tx.tableaus.RK4` and the others, `tx.tableaus.ALL`; make your own with `ButcherTableau`."""

from .integrators.tableau import ButcherTableau
from .integrators.tableaus import *  # noqa: F403
from .integrators.tableaus import __all__ as _tableaus

__all__ = [*_tableaus, "ButcherTableau"]
