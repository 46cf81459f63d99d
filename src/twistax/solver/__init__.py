"""An interior-point solver for problems in stages: its core in C, and the core from Python. It knows no bodies."""

from .core import Solution, StageFunctions, Stages, Status, Units, solve
from .options import SOURCES, Options
from .python_functions import PythonFunctions
