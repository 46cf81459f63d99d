"""Many cases of one problem, each solved as alone, as many at a time as there are processors."""

from __future__ import annotations

import operator
import threading
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from ...jax_inside import in_double
from ...solver.processors import processors
from ..transcription.points import Given, Point
from .budget import Budget
from .core_solver import CoreSolver
from .outcome import Outcome
from .strategies import solved


def solve_all(solver: CoreSolver, points: Point, givens: Given, most: int, mesh_tolerance: float) -> list[Outcome]:
    """The outcomes of all cases, arrays with a leading axis."""
    points, givens = jax.tree.map(np.asarray, (points, givens))
    of_thread = threading.local()

    def outcome(case: int) -> Outcome:
        point, instance = jax.tree.map(operator.itemgetter(case), (points, givens))
        if not hasattr(of_thread, "solver"):
            of_thread.solver = solver.alone(instance)
        core: CoreSolver = of_thread.solver
        with in_double():
            return core.judge.judged(
                solved(core, point, instance, Budget(most)), instance, mesh_tolerance, core.tolerance
            )

    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(outcome, range(len(points.us))))
