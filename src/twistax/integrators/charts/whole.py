"""How a whole state is stored between steps; its coordinates: those of its parts, side by side."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TypeAlias

from ...groups import Product
from ...lowering.dynamics import Arrays
from .chart import Chart
from .coordinates import Block, Coordinates

__all__ = ["Blocks", "StateCoordinates", "StoredState", "coordinates_of"]

#: Numbers by the name of the state: stored states, coordinates, rates. A pytree.
Blocks: TypeAlias = dict[str, Block]


class StoredState(ABC):
    """How the states of a system are stored between steps. Pure and traceable."""

    @abstractmethod
    def enter(self, x: Arrays) -> Blocks:
        """What is stored of a state."""

    @abstractmethod
    def value(self, y: Blocks) -> Arrays:
        """The state as expressions see it."""


class StateCoordinates(StoredState):
    """`Coordinates` of every part of a state, applied part by part. Pure and traceable."""

    def __init__(self, parts: Mapping[str, Coordinates]) -> None:
        self.parts = dict(parts)

    def enter(self, x: Arrays) -> Blocks:
        return {name: part.enter(x[name]) for name, part in self.parts.items()}

    def value(self, y: Blocks) -> Arrays:
        return {name: part.value(y[name]) for name, part in self.parts.items()}

    def rate(self, rates: Arrays) -> Blocks:
        """The rates of the dynamics, as numbers."""
        return {name: part.rate(rates[name]) for name, part in self.parts.items()}

    def move(self, y: Blocks, z: Blocks) -> Blocks:
        """The stored state with coordinates z around y."""
        return {name: part.move(y[name], z[name]) for name, part in self.parts.items()}

    def slope(self, z: Blocks, moved: Blocks, omega: Blocks) -> Blocks:
        """z' at z; `moved` is move(y, z)."""
        return {name: part.slope(z[name], moved[name], omega[name]) for name, part in self.parts.items()}

    def first_slope(self, y: Blocks, omega: Blocks) -> Blocks:
        """z' at z = 0."""
        return {name: part.first_slope(y[name], omega[name]) for name, part in self.parts.items()}

    def tangent(self, z: Blocks) -> Arrays:
        """The tangents of the move, by name. Raises ModelError where coordinates are of another kind."""
        return {name: part.tangent(z[name]) for name, part in self.parts.items()}

    def deviation(self, e: Blocks, after: Blocks) -> Blocks:
        """The tangents of a small difference of coordinates near the end of a step."""
        return {name: part.deviation(e[name], after[name]) for name, part in self.parts.items()}

    def sizes(self, before: Blocks, after: Blocks) -> Blocks:
        """What the entries of a deviation are compared with."""
        return {name: part.sizes(before[name], after[name]) for name, part in self.parts.items()}

    def settle(self, moved: Blocks) -> Blocks:
        """The end of a step, put back into the group to round-off."""
        return {name: part.settle(moved[name]) for name, part in self.parts.items()}


@functools.lru_cache(maxsize=256)
def coordinates_of(chart: Chart, group: Product) -> StateCoordinates:
    """The coordinates of a state in a chart; the same object for equal arguments."""
    return StateCoordinates({name: chart.coordinates(factor) for name, factor in group.factors.items()})
