"""Requirements of a controller on its problem."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TrajectoryError
from ..hessians.options import by_updates


def need_controllable(problem: Any) -> None:
    """Raise TrajectoryError if the initial state of the first phase contains quantities that are neither states of the
    system nor its continuous controls.
    """
    first = problem.parts[0]
    known = {state.name for state in first.phase.dynamics.states} | first.continuous.hidden
    if added := sorted({state.name for state in first.dynamics.states} - known):
        raise TrajectoryError(
            f"controller: the problem has states that cannot be measured: {', '.join(added)}. They "
            "represent integrals and extremes of the path.\n"
            "  fix: use running= in place of Integral, and bounds in place of Maximum and Minimum"
        )
    if by_updates(problem.parts):
        raise TrajectoryError(
            "controller: QuasiNewton() approximates second derivatives over many iterations, and a "
            "controller makes few.\n  fix: pass hessian=tx.trajectory.GaussNewton(), or exact second derivatives"
        )
    fixed = first.ends.initial_fixed
    for state in first.phase.dynamics.states:
        if not np.all(fixed[state.name]):
            raise TrajectoryError(
                f"controller: the initial value of {state.name!r} is free in the problem, but a controller "
                "starts from a measured state.\n  fix: state the problem with initial= for every state"
            )
    for name in first.continuous.smooth:
        if np.any(fixed[name]):
            raise TrajectoryError(
                f"controller: the problem fixes the initial value of the control {name!r}, which a controller "
                f"chooses.\n  fix: leave it free; or make {name!r} a state, which is measured, with its rate as control"
            )


def why_not_shiftable(problem: Any) -> str | None:
    """The reason why the problem is not the same one interval later, or None."""
    if len(problem.parts) != 1:
        return (
            "the problem has several phases, and one interval later the first phase is shorter.\n"
            "  fix: call feedback without shift, which starts from the last plan; set the remaining "
            "durations with prepare(final_time=...), unless they are free"
        )
    if not problem.parts[0].mesh.is_even:
        return (
            "intervals have different lengths, so the plan cannot be shifted.\n"
            "  fix: use a mesh with nodes at equal distances"
        )
    return None
