"""How a solution of a problem in stages moves with what it was solved for: the linear system at it, by the core."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from ..errors import TrajectoryError
from .core import StageFunctions, Stages, Status, Units, as_problem
from .library import library
from .options import Options


class SolutionPoint(NamedTuple):
    """A solution, its multipliers, and weights multiplier / slack of bounds (by v) and of the inequalities h."""

    z: Array
    lam: Array
    y: Array
    ye: Array
    bound_weights: Array
    row_weights: Array


def linearised(
    stages: Stages,
    functions: StageFunctions,
    fixed: Array,
    point: SolutionPoint,
    sides: Array,
    *,
    transposed: bool = False,
    units: Units | None = None,
    options: Options | None = None,
) -> Array:
    """Moves of v, lam, y, ye and the cost for right sides (count, entries of all these).

    Entries of v that are fixed move by what a side has for them; the others, and the multipliers, so that the
    first-order conditions leave what the side has. `transposed`: the solutions of the transposed equations.

    Args:
        fixed: which entries of v are fixed.
    Raises:
        TrajectoryError: the solution is no strict minimum, or has no finite derivatives.
    """
    lower, upper = np.where(fixed, 0.0, -1.0), np.where(fixed, 0.0, 1.0)
    problem = as_problem(stages, functions, lower, upper, units or Units())
    arrays = [np.ascontiguousarray(a, float) for a in point]
    address = (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))
    found = np.array(sides, float, ndmin=2)
    core, chosen = library(), (options or Options()).as_structure()
    workspace = np.empty(core.workspace_size(ctypes.byref(problem.structure)))
    references = [ctypes.byref(part) for part in (problem.structure, chosen, address)]
    status = Status(core.linearised(*references, int(transposed), len(found), found.ctypes.data, workspace.ctypes.data))
    functions.check()
    if status is not Status.SOLVED:
        words = {Status.UNBOUNDED_CURVATURE: "no strict minimum", Status.NON_FINITE: "without finite derivatives"}
        raise TrajectoryError(f"the solution is {words.get(status, status.name)}")
    return found
