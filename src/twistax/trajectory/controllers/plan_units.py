"""The solver's units of a controller: measured at its first plan, and anew where a state is far from the plan."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np
from numpy import ndarray as Array

from ...jax_inside import in_double
from ...solver.core import Units
from ...solver.prepared import PreparedSolve
from ..start_units import StartUnits
from ..strategy.measure import COST
from ..transcription.staged import Staged
from .barrier import BARRIER_MOST, BARRIER_SHARE

#: A measured state so many units away from the plan says that the units do not fit: the first barrier parameter is at
#: its limit there.
_FAR = BARRIER_MOST / BARRIER_SHARE
#: Units that differ by no more than this factor are alike.
_ALIKE = 10.0


class PlanUnits:
    """Units that follow a plan.

    A plan at rest says nothing of what states and controls a disturbance takes, or that they are as small as the noise
    in it. A state that is far away from it, in its units, says that they are wrong: then they are measured at the plan
    with that state, and at the next plans until two in a row are alike.

    Args:
        staged: of one phase.
        first: measured at the first plan.

    Attributes:
        units: for the solver's core.
        are_new: whether they are those of another plan than the one that was solved last.
    """

    def __init__(self, staged: Staged, first: StartUnits) -> None:
        self._staged, self._measured, self._stay = staged, first, False
        self.units, self.are_new = _for_core(first), False

    def are_far_below(self, difference: Array) -> bool:
        """Whether the units do not fit a move of the states."""
        return not self._stay and self.largest(difference) > _FAR

    def largest(self, difference: Array) -> float:
        """The largest entry of a move of the states, in their units."""
        return float((np.abs(difference) / np.asarray(self.units.size)[: len(difference)]).max(initial=0.0))

    def measure(self, solve: PreparedSolve) -> bool:
        """Measure units at the plan of a solve; whether they are others than before."""
        with in_double(), np.errstate(all="ignore"):
            measured = StartUnits(self._staged, self._staged.point(solve.z.copy()))
        self.are_new = bool(measured.distance(self._measured) > np.log(_ALIKE))
        if self.are_new:
            self._measured, self.units = measured, _for_core(measured)
            solve.set_units(self.units)
        return self.are_new

    @contextlib.contextmanager
    def constant(self) -> Iterator[None]:
        """Within it units stay, as in C."""
        self._stay = True
        try:
            yield
        finally:
            self._stay = False


def _for_core(units: StartUnits) -> Units:
    return Units(units.v, units.rows, units.equalities, COST * units.cost)
