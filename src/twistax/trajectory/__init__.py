"""Trajectory optimisation: linearisation and discretisation in the tangent space, optimal control, replay."""

from ..linear import Discretization, Linearization, discretize, linearize
from ..progress import Progress
from .adapters.solvers import IPOPT, Fatrop
from .contact.contact import Contact, Friction
from .controllers.controller import Controller
from .controllers.log import ControllerLog, StepRecord
from .exciting import exciting_problem
from .hessians.options import GaussNewton, QuasiNewton
from .problem.controls import Held, Linear, Rate, Spline
from .problem.functionals import Initial, Integral, Maximum, Minimum
from .problem.phase import Phase
from .problem.problem import Problem
from .problem.statement import Maximize as Maximize  # the public names are tx.Maximize and tx.Minimize
from .problem.statement import Minimize as Minimize
from .problem.statement import Objective
from .result.many import PhasedResults, TrajectoryResults
from .result.quality import Optimality
from .result.refine import Meshed
from .result.result import PhasedResult, TrajectoryResult
from .sensitivity.solution import Solution, solution
from .strategy.accuracy import Accuracy
from .strategy.status import Status
from .strategy.strategies import Strategy
from .strategy.warm import WarmStart
from .transcription.mesh import Mesh
from .transcription.methods import Collocation, MultipleShooting

__all__ = [
    "Accuracy",
    "IPOPT",
    "Collocation",
    "Contact",
    "Controller",
    "ControllerLog",
    "Discretization",
    "Fatrop",
    "Friction",
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
    "StepRecord",
    "Status",
    "Strategy",
    "TrajectoryResult",
    "TrajectoryResults",
    "WarmStart",
    "discretize",
    "exciting_problem",
    "linearize",
    "solution",
]
