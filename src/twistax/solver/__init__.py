"""An interior-point solver for problems in stages and a dense quadratic program, in C, and both from Python. They know
no bodies."""

from .core import CoreSolution, CoreStatus, StageFunctions, Units, solve
from .options import QP_SOURCES, SOURCES, Options, QPOptions
from .qp import QPSolution, QPStatus, solve_qp
from .stages import Stages
