"""Charts: how a state is stored between steps, and its coordinates around the start of a step."""

from .chart import Ambient, Chart, Exponential, SplitExponential, compensated, coordinates_of
from .coordinates import Block, Coordinates, FlatCoordinates, GroupCoordinates, StateCoordinates

__all__ = ["Ambient", "Chart", "Coordinates", "Exponential", "SplitExponential"]
