"""The solver's units of a controller: measured at its first plan, and again after a large
change of the measured state.
"""

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

#: The ratio of the initial barrier parameter of a call to the largest move of the measured state, in units of the
#: states, and its limits.
BARRIER_SHARE, BARRIER_LEAST, BARRIER_MOST = 1e-2, 1e-7, 1e-1
#: A measured state that differs from the plan by this number of units indicates wrong units: the initial barrier
#: parameter would be at its limit.
_FAR = BARRIER_MOST / BARRIER_SHARE
#: Units that differ by at most this factor count as equal.
_ALIKE = 10.0


class PlanUnits:
    """Units that are adapted to the plan.

    A plan at rest contains no information about the states and controls that a disturbance requires. A state that is
    far from the plan, in units of the states, indicates that the units are wrong. Then they are measured at the plan
    with that state, and at each following plan until two successive measurements agree.

    Args:
        staged: the transcribed problem.
        first: the units measured at the first plan.

    Attributes:
        units: the current units, for the solver's core.
        are_new: whether they were measured at another plan than the one that was solved last.
    """

    def __init__(self, staged: Staged, first: StartUnits) -> None:
        self._staged, self._measured, self._stay = staged, first, False
        self.units, self.are_new = _for_core(first), False

    def are_far_below(self, difference: Array) -> bool:
        """Whether the units are too small for a move of the states."""
        return not self._stay and self.largest(difference) > _FAR

    def largest(self, difference: Array) -> float:
        """The largest entry of a move of the states, in units of the states."""
        return float((np.abs(difference) / np.asarray(self.units.size)[: len(difference)]).max(initial=0.0))

    def measure(self, solve: PreparedSolve) -> bool:
        """Measure the units at the plan of a solve; return whether they have changed."""
        with in_double(), np.errstate(all="ignore"):
            measured = StartUnits(self._staged, self._staged.point(solve.z.copy()))
        self.are_new = bool(measured.distance(self._measured) > np.log(_ALIKE))
        if self.are_new:
            self._measured, self.units = measured, _for_core(measured)
            solve.set_units(self.units)
        return self.are_new

    def saved(self) -> tuple[StartUnits, bool]:
        """What `load` continues from."""
        return self._measured, self.are_new

    def load(self, saved: tuple[StartUnits, bool], solve: PreparedSolve) -> None:
        """Continue with the units of another controller of this problem."""
        self._measured, self.are_new = saved
        self.units = _for_core(self._measured)
        solve.set_units(self.units)

    @contextlib.contextmanager
    def constant(self) -> Iterator[None]:
        """A context in which the units are constant, as in C code."""
        self._stay = True
        try:
            yield
        finally:
            self._stay = False


def _for_core(units: StartUnits) -> Units:
    return Units(units.v, units.rows, units.equalities, COST * units.cost)
