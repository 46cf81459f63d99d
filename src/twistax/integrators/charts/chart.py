"""What every chart offers: coordinates for each part of a state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from ...errors import ModelError
from ...groups import Euclidean, Group, SpecialEuclidean, SpecialOrthogonal
from .coordinates import Coordinates, FlatCoordinates
from .generic import GroupCoordinates

__all__ = ["Chart", "chart_of"]


class Chart(ABC):
    """Which coordinates a step uses around its start. A value: equal charts mean the same.

    A new chart subclasses this and gives coordinates for rotations and poses; states without a group are added to, and
    states of other groups move in exponential coordinates.
    """

    def coordinates(self, group: Group) -> Coordinates:
        """The coordinates for one part of the state; exponential ones for groups that are neither SO(3) nor SE(3)."""
        if isinstance(group, Euclidean):
            return FlatCoordinates(group)
        if isinstance(group, SpecialOrthogonal):
            return self.for_rotation()
        if isinstance(group, SpecialEuclidean):
            return self.for_pose(group)
        return GroupCoordinates(group)

    @abstractmethod
    def for_rotation(self) -> Coordinates:
        """Coordinates around a rotation."""

    @abstractmethod
    def for_pose(self, group: SpecialEuclidean) -> Coordinates:
        """Coordinates around a pose whose twists have the order of `group`."""


def chart_of(owner: str, given: Any, default: Chart) -> Chart:
    """The chart that was given to a method, or the default one. Raises ModelError where it is none."""
    if given is None:
        return default
    if not isinstance(given, Chart):
        raise ModelError(f"{owner} expects a chart like tx.charts.Exponential(), got {given!r}")
    return given
