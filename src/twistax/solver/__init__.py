"""An interior-point solver for multi-stage problems and a solver for dense quadratic programs, in C, with Python
interfaces. They are independent of bodies and mechanisms."""

from .core import CoreSolution, CoreStatus, StageFunctions, Units, solve
from .options import QP_SOURCES, SOURCES, Options, QPOptions
from .qp import QPSolution, QPStatus, solve_qp
from .stages import Stages
