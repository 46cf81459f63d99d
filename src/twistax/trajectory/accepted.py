"""A warm start that solves what is asked now: it is the result, and no search begins."""

from __future__ import annotations

from .decisions import RENEW
from .outcome import Outcome, outcome, seen
from .solver import Solver
from .transcribed import Given, Point
from .warm import WarmStart
from .watch import Status, Watch


def accepted(solver: Solver, start: Point | WarmStart, given: Given) -> Outcome | None:
    """The outcome at a warm start, where it is a minimum of what is asked now, in scales that fit; else None.

    A search would begin with a barrier, which pushes slacks off zero, and may come to another optimum.
    """
    if not isinstance(start, WarmStart) or start.as_solved is None:
        return None
    scales, steps = start.scales, solver.steps
    weights = start.dynamics * scales.d[1:] / scales.cost, start.rows * scales.rows / scales.cost
    slopes, state = solver.weighed(start.as_solved, given, scales, *weights)
    opening, watch = steps.opening(state, scales), Watch(solver.tolerance, 1)
    if watch.at_once(opening) is not None:
        return None
    fresh, change, memory = steps.renewed(state, slopes, opening.memory)
    if float(change) > RENEW:
        state = solver.rescaled(state, fresh, given)
    if watch.ended(seen(steps.signs(state, memory))) is not Status.SOLVED:
        return None
    found = outcome(solver.shooting, state, Status.SOLVED, 0)._replace(iterations=0)
    return None if solver.falls(found, state, given) else found
