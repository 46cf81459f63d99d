"""Where the interior point stands, and in which scales."""

from __future__ import annotations

from typing import Any, NamedTuple

from .transcribed import Point, Values

#: The points that the filter remembers.
FILTER = 128


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


class State(NamedTuple):
    """Where the solver stands. Slacks and multipliers are scaled."""

    point: Point
    values: Values
    slack: Any  # (rows,), 1 where a row is no inequality
    dynamics: Any  # (intervals, n) multipliers
    rows: Any  # (rows,) multipliers
    barrier: Any
    damping: Any  # the last that was needed
    raised: Any  # what the last step needed
    filter: Any  # (2, FILTER) violation and barrier function
    filtered: Any  # how many
    first: Any  # violation at the start
    scales: Scales
    errors: Errors
    share: Any  # of the last step
    stuck: Any  # the line search found no step
