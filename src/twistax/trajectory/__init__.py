"""Trajectories: linearisation and discretisation in the tangent space, optimal control, replay."""

from .discretize import Discretization, Linearization, discretize, linearize
from .optimizer import Status
from .problem import Problem
from .result import TrajectoryResult
from .statement import Maximize as Maximize  # tx.Maximize and tx.Minimize are their home
from .statement import Minimize as Minimize
from .statement import Objective

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
