"""Many cases of one problem, each solved as alone.

What most runs are made of, steps and new scales until the conditions of an optimum hold and a look at what was found,
runs as rows of kernels, as many at a time as there are processors. A case that needs anything else goes on alone from
there; of these as many at a time as there are processors, too.
"""

from __future__ import annotations

import operator
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..precision import in_double
from .outcome import Outcome, outcome, seen
from .solver import Solver
from .stride import Orders, Reached
from .transcribed import Given, Point, jitted
from .watch import Status, Watch

#: The least and the most rows of a kernel, powers of two as all numbers of rows are: for each of them JAX compiles.
_FEW, _ROWS = 4, 256


def processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def solve_all(solver: Solver, points: Point, givens: Given, most: int) -> list[Outcome]:
    """The outcomes of all cases, arrays with a leading axis."""
    count, found = len(points.us), dict[int, Outcome | Reached]()
    if solver.steps.one_kernel:
        if Together not in solver.made:
            solver.made[Together] = Together(solver)
        for first in range(0, count - _FEW + 1, _ROWS):
            cases = np.arange(first, min(first + _ROWS, count))
            found |= solver.made[Together].solved(cases, *_rows((points, givens), cases), most)

    def alone(case: int) -> Outcome:
        reached = found.get(case)
        if isinstance(reached, Outcome):
            return reached
        with in_double():
            point, given = jax.device_put(jax.tree.map(operator.itemgetter(case), (points, givens)))
            return solver.run(point, given, most, reached=reached)

    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(alone, range(count)))


class Together:
    """Runs of many cases at once, as long as they need nothing but steps and new scales."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        steps = solver.steps
        self._opened, self._strode, self._raised = (
            jitted(jax.vmap(own)) for own in (steps.opening_of, steps.stride_of, steps.raised_of)
        )

    def solved(self, cases: Array, points: Point, givens: Given, most: int) -> dict[int, Outcome | Reached]:
        """By number what became of those cases that begin as most do; arrays may have more rows than cases."""
        steps, tolerance = self._solver.steps, self._solver.tolerance
        opening, rows = self._opened(points, givens), len(points.us)
        begun = opening.finite & (np.asarray(opening.decided) <= tolerance) & opening.bound
        usual = np.asarray(begun) & (np.arange(rows) < len(cases))
        state, memory, goes, watch = opening.state, opening.memory, usual, Watch(tolerance, most)
        slopes: Any = jax.tree.map(lambda a: np.broadcast_to(a, (rows, *a.shape)), steps.no_slopes)
        taken, count, worthless = None, np.zeros(rows, int), np.zeros(rows, bool)
        while goes.any():
            further = np.where(goes, watch.until(), 0)
            # All that still go have gone equally far.
            orders = Orders(goes & (taken is None), goes, goes, further, count, np.asarray(state.barrier))
            taken = self._strode(state, slopes, memory, givens, orders)
            slopes, state, memory, steps_taken = taken.slopes, taken.state, taken.memory, np.asarray(taken.count)
            count, watch.count = count + steps_taken, watch.count + int(steps_taken[goes].max())
            worthless = worthless | np.asarray(taken.worthless)
            goes = goes & np.asarray(taken.goes) & (count < most)
        if taken is None:
            return {}
        bends = np.asarray(self._raised(state, givens)) > steps.bent
        found, whole = dict[int, Outcome | Reached](), seen(taken._replace(worthless=worthless))
        for row in np.flatnonzero(usual):
            last, watch.count = jax.tree.map(lambda a, row=row: np.array(a[row]), whole), int(count[row])
            status = None if last.worthless or last.state.stuck else watch.ended(last.signs)
            if status is None or (status is Status.SOLVED and bends[row]):
                found[int(cases[row])] = Reached(last, watch.count)
            else:
                found[int(cases[row])] = outcome(self._solver.shooting, last.state, status, watch.count)
        return found


def _rows(tree: Any, cases: Array) -> Any:
    """Arrays of some cases, the last one again until their number is a power of two."""
    count = 1 << (len(cases) - 1).bit_length()
    return jax.tree.map(lambda a: a[np.minimum(cases[0] + np.arange(count), cases[-1])], tree)
