"""Many cases of one problem, each solved as alone, as many at a time as there are processors."""

from __future__ import annotations

import operator
import threading
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from ..jax_inside import in_double
from ..solver.processors import processors
from .budget import Budget
from .core_solver import CoreSolver
from .outcome import Outcome
from .transcribed import Given, Point


def solve_all(solver: CoreSolver, points: Point, givens: Given, most: int, mesh_tolerance: float) -> list[Outcome]:
    """The outcomes of all cases, arrays with a leading axis."""
    points, givens = jax.tree.map(np.asarray, (points, givens))
    of_thread = threading.local()

    def solved(case: int) -> Outcome:
        point, given = jax.tree.map(operator.itemgetter(case), (points, givens))
        if not hasattr(of_thread, "solver"):
            of_thread.solver = solver.alone(given)
        own: CoreSolver = of_thread.solver
        with in_double():
            return own.judge.judged(own.run(point, given, Budget(most)), given, mesh_tolerance, own.tolerance)

    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(solved, range(len(points.us))))
