"""Where runs of the solver end, and what is known of it there."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import jax
import numpy as np
from numpy import ndarray as Array

from .decisions import row_violations
from .iterate import Errors, Scales, State
from .stride import Reached
from .transcribed import Point, Transcribed, Values
from .watch import Status

if TYPE_CHECKING:
    from .accuracy import Accuracy, Flat
    from .start_units import StartUnits

#: Called with (iterations so far, objective, largest violation) before every step.
Callback = Callable[[int, float, float], None]

Tree = TypeVar("Tree")


class Outcome(NamedTuple):
    """Where a run of the solver ended."""

    point: Point
    values: Values
    errors: Errors
    dynamics: Array  # (intervals, n) multipliers in the problem's units
    rows: Array  # (rows,)
    scaled_rows: Array  # (rows,) multipliers, scaled
    slack: Array  # (rows,) in the problem's units
    violations: Array  # (intervals * n + rows,) scaled: of the dynamics, then of the rows
    scales: Scales
    status: Status
    iterations: int
    accuracy: Accuracy | None = None  # of the mesh; None before it is looked at, and of points that are not finite
    units: StartUnits | None = None  # of the solver
    flat: Flat | None = None  # a row without slope
    saddle: bool = False  # whether the objective falls to second order from there, and no search beside it found better

    @property
    def cost(self) -> float:
        return float(self.values.cost)

    @property
    def violation(self) -> float:
        return float(self.violations.max(initial=0.0))


class Searched(NamedTuple):
    """What a search came to."""

    outcome: Outcome
    state: State
    crept: Reached | None  # how far it came, where it creeps


#: What a search finds from a start, or from where it crept, within so many iterations.
Search = Callable[[Any, int, Callback | None], Searched]


def outcome(shooting: Transcribed, state: State, status: Status, count: int) -> Outcome:
    """What is known where a run ended, after so many iterations."""
    state = seen(state)
    scales, w = state.scales, state.rows
    defects = np.abs(np.asarray(state.values.defects) / scales.d[1:]).ravel()
    rows = np.where(shooting.exists | shooting.decided, row_violations(shooting, state), 0.0)
    return Outcome(
        point=state.point,
        values=state.values,
        errors=Errors(*(float(e) for e in state.errors)),
        dynamics=np.asarray(state.dynamics) * scales.cost / scales.d[1:],
        rows=np.where(shooting.exists, w * scales.cost / scales.rows, 0.0),
        scaled_rows=np.where(shooting.exists, w, 0.0),
        slack=np.asarray(state.slack) * scales.rows,
        violations=np.concatenate([defects, rows]),
        scales=scales,
        status=status,
        iterations=max(count, 1),
    )


def seen(tree: Tree) -> Tree:
    """The same by NumPy, without a copy: a number of an array of JAX's takes several times as long to read."""
    found: Tree = jax.tree.map(np.asarray, tree)
    return found
