"""Requirements of a controller on its problem."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TrajectoryError
from ..hessians.options import by_updates


def need_controllable(problem: Any) -> None:
    """Raise TrajectoryError if the initial state or the first control contains quantities that are not those of the
    system.
    """
    if len(problem.parts) != 1:
        raise TrajectoryError(
            "controller: the problem has several phases, which a controller does not support.\n"
            "  fix: make a controller for a problem of one phase"
        )
    (part,) = problem.parts
    measured = {state.name for state in part.phase.dynamics.states}
    if added := sorted({state.name for state in part.dynamics.states} - measured):
        raise TrajectoryError(
            f"controller: the problem has states that cannot be measured: {', '.join(added)}. They "
            "represent continuous controls, free node times, or integrals and extremes of the path.\n"
            "  fix: use piecewise constant controls, nodes at fixed fractions, and running= in place of Integral"
        )
    if by_updates(problem.parts):
        raise TrajectoryError(
            "controller: QuasiNewton() approximates second derivatives over many iterations, and a "
            "controller makes few.\n  fix: pass hessian=tx.trajectory.GaussNewton(), or exact second derivatives"
        )
    for name, fixed in part.ends.initial_fixed.items():
        if not np.all(fixed):
            raise TrajectoryError(
                f"controller: the initial value of {name!r} is free in the problem, but a controller "
                "starts from a measured state.\n  fix: state the problem with initial= for every state"
            )


def need_shiftable(problem: Any) -> None:
    """Raise TrajectoryError unless the problem is the same one interval later."""
    (part,) = problem.parts
    if not part.mesh.is_even:
        raise TrajectoryError(
            "shift: intervals have different lengths, so the plan cannot be shifted.\n"
            "  fix: use a mesh with nodes at equal distances"
        )
