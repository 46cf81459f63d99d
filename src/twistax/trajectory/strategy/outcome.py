"""The outcome of a run of the solver."""

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

#: Called with (number of iterations, objective, largest violation) before every step; ends the search by returning
#: True.
Callback = Callable[[int, float, float], Any]


class Scales(NamedTuple):
    """Scales by which unknowns, rows and the objective are divided."""

    d: Any  # (nodes, n)
    u: Any  # (intervals, m)
    border: Any  # (g,)
    rows: Any  # (rows,)
    cost: Any


class Errors(NamedTuple):
    """The scaled residuals of the first-order conditions."""

    stationarity: Any
    feasibility: Any
    complementarity: Any  # largest s w (product of a slack and its multiplier)
    gap: Any  # sum of s w and of |multiplier times violation|: their possible effect on the objective
    excess: Any  # relative difference of the objective from that of the minimum nearby


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of a run of the solver."""

    point: Iterate
    values: Values
    errors: Errors
    dynamics: Array  # (intervals, n) multipliers in the problem's units
    rows: Array  # (rows,)
    scaled_rows: Array  # (rows,) multipliers, scaled
    slack: Array  # (rows,) in the problem's units
    violations: Array  # (intervals * n + rows,) scaled: those of the dynamics, then those of the rows
    scales: Scales
    status: Status
    iterations: int
    accuracy: Accuracy | None = None  # mesh accuracy; None before its check, and for points that are not finite
    units: StartUnits | None = None  # of the solver
    flat: FlatRow | None = None  # a row whose gradient vanishes
    saddle: bool = False  # whether the objective decreases to second order, and restarts found no better point
    refusal: str = ""  # the reason why the case was not solved

    def refused(self, refusal: str) -> Outcome:
        """The outcome of an invalid case: arrays of the same shapes, with all numbers NaN."""
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
