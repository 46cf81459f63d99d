"""Trajectories: linearisation and discretisation in the tangent space, optimal control, replay."""

from ..progress import Progress
from .adapters.solvers import IPOPT, Fatrop
from .cases import PhasedResults, TrajectoryResults
from .controls import Held, Linear, Rate, Spline
from .discretize import Discretization, discretize
from .found import Optimality
from .functionals import Initial, Integral, Maximum, Minimum
from .hessians.options import GaussNewton, QuasiNewton
from .linearize import Linearization, linearize
from .modes import Mode as Mode  # tx.Mode, tx.Trim and tx.trim are their home
from .phase import Phase
from .phased_result import PhasedResult
from .problem import Problem
from .refine import Meshed
from .result import TrajectoryResult
from .sensitivity.solution import Solution, solution
from .statement import Maximize as Maximize  # tx.Maximize and tx.Minimize are their home
from .statement import Minimize as Minimize
from .statement import Objective
from .strategy.accuracy import Accuracy
from .strategy.status import Status
from .strategy.strategies import Strategy
from .strategy.warm import WarmStart
from .transcription.mesh import Mesh
from .transcription.methods import Collocation, MultipleShooting
from .trimming import Trim as Trim
from .trimming import trim as trim

__all__ = [
    "Accuracy",
    "IPOPT",
    "Collocation",
    "Discretization",
    "Fatrop",
    "GaussNewton",
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
    "QuasiNewton",
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
