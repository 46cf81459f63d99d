"""Trajectories: linearisation and discretisation in the tangent space, optimal control, replay."""

from ..progress import Progress
from .accuracy import Accuracy
from .cases import PhasedResults, TrajectoryResults
from .controls import Held, Linear, Rate, Spline
from .discretize import Discretization, discretize
from .external import IPOPT, Fatrop
from .found import Optimality
from .functionals import Initial, Integral, Maximum, Minimum
from .linearize import Linearization, linearize
from .mesh import Mesh
from .modes import Mode as Mode  # tx.Mode, tx.Trim and tx.trim are their home
from .phase import Phase
from .phased_result import PhasedResult
from .problem import Problem
from .refine import Meshed
from .result import TrajectoryResult
from .sensitivity import Solution, solution
from .statement import Maximize as Maximize  # tx.Maximize and tx.Minimize are their home
from .statement import Minimize as Minimize
from .statement import Objective
from .strategies import Strategy
from .transcription import Collocation, MultipleShooting
from .trimming import Trim as Trim
from .trimming import trim as trim
from .warm import WarmStart
from .watch import Status

__all__ = [
    "Accuracy",
    "IPOPT",
    "Collocation",
    "Discretization",
    "Fatrop",
    "Initial",
    "Integral",
    "Linearization",
    "Maximum",
    "Minimum",
    "MultipleShooting",
    "Objective",
    "Held",
    "Linear",
    "Mesh",
    "Meshed",
    "Rate",
    "Optimality",
    "Phase",
    "PhasedResult",
    "PhasedResults",
    "Problem",
    "Progress",
    "Solution",
    "Spline",
    "Status",
    "Strategy",
    "TrajectoryResult",
    "TrajectoryResults",
    "WarmStart",
    "discretize",
    "linearize",
    "solution",
]
