"""What a problem must be for a controller."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TrajectoryError
from ..hessians.options import by_updates


def need_controllable(problem: Any) -> None:
    """Raise TrajectoryError for a problem whose first state and control are not those of the system alone."""
    if len(problem.parts) != 1:
        raise TrajectoryError(
            "controller: the problem has several phases, and which of them comes next depends on time.\n"
            "  fix: a controller for a problem of one phase"
        )
    (part,) = problem.parts
    measured = {state.name for state in part.phase.dynamics.states}
    if added := sorted({state.name for state in part.dynamics.states} - measured):
        raise TrajectoryError(
            f"controller: the problem has states that cannot be measured: {', '.join(added)}. They are from continuous "
            "controls, free node times, or integrals and extremes of the path.\n"
            "  fix: held controls, nodes at fixed fractions, running= in place of Integral"
        )
    if by_updates(problem.parts):
        raise TrajectoryError(
            "controller: QuasiNewton() learns second derivatives over many steps, and a controller takes few.\n"
            "  fix: hessian=tx.trajectory.GaussNewton(), or exact second derivatives"
        )
    for name, fixed in part.ends.initial_fixed.items():
        if not np.all(fixed):
            raise TrajectoryError(
                f"controller: the problem leaves the initial value of {name!r} free, and a controller starts from a "
                "measured state.\n  fix: state the problem with initial= for every state"
            )


def need_shiftable(problem: Any) -> None:
    """Raise TrajectoryError where what comes an interval later is not the same problem."""
    (part,) = problem.parts
    if not part.mesh.is_even:
        raise TrajectoryError(
            "shift: intervals have different lengths, so the plan cannot be shifted.\n  fix: nodes at equal distances"
        )
