"""Scales of a problem, and how far a point is from an optimum in them."""

from __future__ import annotations

from typing import Any, NamedTuple


class Scales(NamedTuple):
    """Sizes by which unknowns, rows and the objective are divided."""

    d: Any  # (nodes, n)
    u: Any  # (intervals, m)
    border: Any  # (g,)
    rows: Any  # (rows,)
    cost: Any


class Errors(NamedTuple):
    """How far a point is from the first-order conditions, scaled."""

    stationarity: Any
    feasibility: Any
    complementarity: Any  # largest s w
    gap: Any  # sum of s w and of |multiplier times violation|: what they can cost
