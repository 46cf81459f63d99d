"""Charts: the coordinates that a step of a Runge-Kutta method uses around its start."""

from .ambient import Ambient
from .coordinates import Chart, Coordinates
from .exponential import Exponential, SplitExponential

__all__ = ["Ambient", "Chart", "Coordinates", "Exponential", "SplitExponential"]
