"""The end of a solve, and what is known about it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy import ndarray as Array

from ..start_units import StartUnits
from ..transcription.iterate import Iterate, Values
from .accuracy import Accuracy, FlatRow
from .status import Status

#: Called with (iterations so far, objective, largest violation) before every step; True ends the search.
Callback = Callable[[int, float, float], Any]


class Scales(NamedTuple):
    """Sizes by which unknowns, rows and the objective are divided."""

    d: Any  # (nodes, n)
    u: Any  # (intervals, m)
    border: Any  # (g,)
    rows: Any  # (rows,)
    cost: Any


class Errors(NamedTuple):
    """The scaled residuals of the first-order conditions."""

    stationarity: Any
    feasibility: Any
    complementarity: Any  # largest s w
    gap: Any  # sum of s w and of |multiplier times violation|: what they can cost
    excess: Any  # of the objective over that of the minimum nearby, relative


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a run of the solver."""

    point: Iterate
    values: Values
    errors: Errors
    dynamics: Array  # (intervals, n) multipliers in the problem's units
    rows: Array  # (rows,)
    scaled_rows: Array  # (rows,) multipliers, scaled
    slack: Array  # (rows,) in the problem's units
    violations: Array  # (intervals * n + rows,) scaled: of the dynamics, then of the rows
    scales: Scales
    status: Status
    iterations: int
    accuracy: Accuracy | None = None  # of the mesh; None before its check, and of points that are not finite
    units: StartUnits | None = None  # of the solver
    flat: FlatRow | None = None  # a row without slope
    saddle: bool = False  # whether the objective falls to second order from there, and no search beside it found better
    refusal: str = ""  # why it was not solved

    def refused(self, refusal: str) -> Outcome:
        """The outcome of a case that was not solved, with the same shapes: all numbers are NaN."""
        names = [field.name for field in dataclasses.fields(self) if field.default is dataclasses.MISSING]
        numbers = {name: getattr(self, name) for name in names if name not in ("status", "iterations")}
        nothing = jax.tree.map(lambda a: np.full(np.shape(a), np.nan) if np.ndim(a) else np.nan, numbers)
        return Outcome(**nothing, status=Status.REFUSED, iterations=0, refusal=refusal)

    @property
    def cost(self) -> float:
        return float(self.values.cost)

    @property
    def violation(self) -> float:
        return float(self.violations.max(initial=0.0))
