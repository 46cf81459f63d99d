"""Trajectories: linearisation and discretisation in the tangent space, optimal control, replay."""

from .discretize import Discretization, discretize
from .linearize import Linearization, linearize
from .objective import Maximize, Minimize, Objective
from .problem import Problem
from .result import Status, TrajectoryResult

__all__ = [
    "Discretization",
    "Linearization",
    "Maximize",
    "Minimize",
    "Objective",
    "Problem",
    "Status",
    "TrajectoryResult",
    "discretize",
    "linearize",
]
