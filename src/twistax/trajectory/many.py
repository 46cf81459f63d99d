"""Many cases of one problem: each is solved as alone, as many at a time as there are processors."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp

from ..precision import in_double
from .solver import Outcome, Solver
from .transcribed import Given, Point


def processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def solve_all(solver: Solver, points: Point, givens: Given, most: int) -> list[Outcome]:
    """The outcomes of all cases, arrays with a leading axis.

    Steps are compiled loops, which other threads need not wait for.
    """

    def alone(case: int) -> Outcome:
        with in_double():
            point, given = jax.tree.map(lambda a: jnp.asarray(a[case]), (points, givens))
            return solver.run(point, given, most)

    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(alone, range(len(points.us))))
