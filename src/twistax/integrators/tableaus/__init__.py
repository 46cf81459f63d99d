"""Butcher tableaus, as data."""

from __future__ import annotations

from ..tableau import ButcherTableau
from .eighth_order import DOP853, DORMAND_PRINCE8
from .fifth_order import DORMAND_PRINCE5, TSIT5
from .low_order import BOGACKI_SHAMPINE3, EULER, HEUN, RK4

__all__ = [
    "ALL",
    "BOGACKI_SHAMPINE3",
    "DOP853",
    "DORMAND_PRINCE5",
    "DORMAND_PRINCE8",
    "EULER",
    "HEUN",
    "RK4",
    "TSIT5",
]

#: Every explicit tableau, by order.
ALL: tuple[ButcherTableau, ...] = (
    EULER,
    HEUN,
    BOGACKI_SHAMPINE3,
    RK4,
    DORMAND_PRINCE5,
    TSIT5,
    DOP853,
    DORMAND_PRINCE8,
)
