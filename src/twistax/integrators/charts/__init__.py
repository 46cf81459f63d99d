"""Charts: the coordinates that a step of a Runge-Kutta method uses around its start."""

from .ambient import Ambient
from .chart import Chart, chart_of
from .coordinates import Coordinates
from .exponential import Exponential, SplitExponential

__all__ = ["Ambient", "Chart", "Coordinates", "Exponential", "SplitExponential", "chart_of"]
