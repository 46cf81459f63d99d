"""Trajectories: linearisation and discretisation in the tangent space, optimal control, replay."""

from .discretize import Discretization, discretize
from .linearize import Linearization, linearize
from .objective import Maximize as Maximize  # tx.Maximize and tx.Minimize are their home
from .objective import Minimize as Minimize
from .objective import Objective
from .optimizer import Status
from .problem import Problem
from .result import TrajectoryResult

__all__ = [
    "Discretization",
    "Linearization",
    "Objective",
    "Problem",
    "Status",
    "TrajectoryResult",
    "discretize",
    "linearize",
]
