"""Charts: how a state is stored between steps, and its coordinates around the start of a step."""

from .chart import (
    Ambient,
    Block,
    Chart,
    Coordinates,
    Exponential,
    FlatCoordinates,
    GroupCoordinates,
    SplitExponential,
    StateCoordinates,
    coordinates_of,
)
from .compensated import compensated

__all__ = ["Ambient", "Chart", "Coordinates", "Exponential", "SplitExponential"]
