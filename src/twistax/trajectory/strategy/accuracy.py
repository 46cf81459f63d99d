"""The accuracy of a result: its error with respect to the differential equations, and rows whose gradient vanishes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

#: The default mesh tolerance of status SOLVED.
MESH = 1e-2


@dataclasses.dataclass(frozen=True)
class Exceeded:
    """A limit that is violated between nodes.

    Attributes:
        by: the violation, in the unit of the limit.
        share: the violation in its scale; at the nodes it is at most `tolerance`.
        place: the two nodes between which it occurs.
    """

    by: float
    share: float
    place: str


@dataclasses.dataclass(frozen=True)
class Accuracy:
    r"""The mesh error of a result, from an accurate integration of each interval.

    Interval k, integrated from its first node, ends at a tangent $g_k$ from the next node. With costates $y_k$ the
    objective of a mesh without error is $J + \sum_k y_k \cdot g_k + \Delta$ to first order, with $\Delta$ the error
    of the running cost. Source: Becker and Rannacher, Acta Numerica 10 (2001), pp. 1-102.

    Example: `problem.solve().accuracy.error`.

    Attributes:
        intervals: of each phase (intervals,), the largest entry of $g_k$ in scales of the states, dimensionless.
        change: the change of the objective on a mesh without error, to first order, in its unit.
        share: the size of that change over `size`.
        size: the larger of the objective and the largest product of a costate and its state.
        amplified: of each phase (intervals,), the factor by which a substep amplifies a mode of the equations that
            does not grow; 1 where the method is stable.
        exceeded: name -> a limit that is violated between nodes, with `by` the violation in its unit, `share` in its
            scale, and `place`; the largest one first.
        tolerance: the `mesh_tolerance` of the solve.
        middles: of each phase, states by name (intervals, ...) at the middle of each accurate integration.
        places: of each phase, its name in a message.
    """

    intervals: tuple[Array, ...]
    change: float
    share: float
    size: float
    amplified: tuple[Array, ...]
    exceeded: dict[str, Exceeded]
    tolerance: float
    middles: tuple[dict[str, Array], ...] = dataclasses.field(repr=False)
    places: tuple[str, ...] = dataclasses.field(repr=False)

    @property
    def error(self) -> float:
        """The largest error of all intervals."""
        return float(np.concatenate(self.intervals).max(initial=0.0))

    @property
    def place(self) -> str:
        """The interval with the largest error."""
        return self._largest(self.intervals)

    @property
    def factor(self) -> float:
        """The largest amplification factor of a substep; 1 if the method is stable."""
        return float(np.concatenate(self.amplified).max(initial=1.0))

    @property
    def unstable_place(self) -> str:
        """The interval with the largest amplification factor."""
        return self._largest(self.amplified)

    @property
    def coarse(self) -> bool:
        """Whether the error of the mesh is above the tolerance, or its method unstable."""
        follows = self.error <= self.tolerance and self.share <= self.tolerance
        return not (follows and (self.factor <= 1.0 or np.isinf(self.tolerance)))

    def _largest(self, numbers: Sequence[Array]) -> str:
        phase = int(np.argmax([of_phase.max(initial=0.0) for of_phase in numbers]))
        stage = int(numbers[phase].argmax())
        return f"between nodes {stage} and {stage + 1}{self.places[phase]}"


class FlatRow(NamedTuple):
    """A constraint row whose gradient vanishes, and its scaled multiplier."""

    name: str
    place: str
    multiplier: float
