"""Many cases of one problem, solved in parallel on the available processors."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from ...jax_inside import in_double
from ...solver.processors import processors
from .budget import Budget
from .core_solver import CoreSolver
from .outcome import Outcome
from .strategies import solved


def solve_all(solver: CoreSolver, cases: Sequence[Any], most: int, mesh_tolerance: float) -> list[Outcome]:
    """The outcomes of all cases, from the `point` at which each starts and its data `instance`."""
    of_thread = threading.local()

    def outcome(case: Any) -> Outcome:
        point, instance = jax.tree.map(np.asarray, (case.point, case.instance))
        if not hasattr(of_thread, "solver"):
            of_thread.solver = solver.alone(instance)
        core: CoreSolver = of_thread.solver
        with in_double():
            return core.judge.judged(
                solved(core, point, instance, Budget(most)), instance, mesh_tolerance, core.tolerance
            )

    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(outcome, cases))
