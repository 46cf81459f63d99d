"""Derivatives of a plan with respect to its initial state, from the linearised first-order conditions."""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from ...solver.core import Units
from ...solver.members import Moves
from ...solver.options import Options
from ...solver.prepared import PreparedSolve
from ..transcription.staged import Staged

#: Distances from bounds below this value, in units of their variables, are round-off.
GAINS_LEAST = 1e-12
#: A plan is a strict minimum if its Hessian is positive definite after this subtraction from the diagonal.
GAINS_CURVATURE = 1e-12


class Gains:
    """The derivatives of the first controls of a plan with respect to its initial state.

    Args:
        solve: the prepared solve that holds the plan.
        staged: the transcribed problem.
    """

    def __init__(self, solve: PreparedSolve, staged: Staged, units: Units) -> None:
        self._solve, self._units = solve, np.asarray(units.size)
        self._stages = staged.transcription.stages
        fixed = solve.lower == solve.upper
        self._moves = Moves(staged.transcription, units, Options(curvature=GAINS_CURVATURE), fixed, transposed=False)

    def __call__(self, n: int, columns: Array) -> Array:
        """(columns, n) derivatives of some variables with respect to the first n tangents of the first node.

        Raises:
            TrajectoryError: the plan is not a strict minimum, or its derivatives are not finite.
        """
        solve, stages = self._solve, self._stages
        least = GAINS_LEAST * self._units
        below, above = (np.maximum(a, least) for a in (solve.v - solve.lower, solve.upper - solve.v))
        of_bounds, of_rows = solve.zl / below + solve.zu / above, solve.y / np.maximum(solve.s, GAINS_LEAST)
        row = np.concatenate([solve.z, solve.lam, solve.y, solve.ye, of_bounds, of_rows, np.ones(1)])
        sides = np.zeros((n, stages.variables + sum(stages.row_counts) + 1))
        sides[np.arange(n), np.arange(n)] = 1.0
        return np.array(self._moves.now(row, sides)[:, columns].T)
