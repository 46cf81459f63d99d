"""Trajectories: linearisation and discretisation in the tangent space, optimal control, replay."""

from .discretize import Discretization, Linearization, discretize, linearize
from .problem import Problem
from .result import Optimality, TrajectoryResult
from .solver import Status
from .statement import Maximize as Maximize  # tx.Maximize and tx.Minimize are their home
from .statement import Minimize as Minimize
from .statement import Objective

__all__ = [
    "Discretization",
    "Linearization",
    "Objective",
    "Optimality",
    "Problem",
    "Status",
    "TrajectoryResult",
    "discretize",
    "linearize",
]
