"""What solvers are given: points, steps, values and derivatives of a discrete problem in stages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
from numpy import ndarray as Array

from ..jax_inside import quick_compile
from .border import Border

if TYPE_CHECKING:
    from .shooting import Shooting


def jitted(function: Callable[..., Any], level: int = 1) -> Any:
    return jax.jit(function, compiler_options=quick_compile(level), keep_unused=True)


class Point(NamedTuple):
    """Where an optimisation stands: states (nodes, ...), flat controls (nodes - 1, m), border (g,)."""

    xs: Any
    us: Any
    border: Any


class Given(NamedTuple):
    """What a compiled problem is solved for."""

    params: Any
    final: Any  # states at the end; entries that are free stand for nothing; of phases `PhaseEnds`
    limits: Any  # (g, 2) of the border
    margins: Any = 0.0  # (rows,) by which rows are tightened


class PhaseEnds(NamedTuple):
    """States at the ends of every phase; entries that are free stand for nothing."""

    initial: Any
    final: Any


class Step(NamedTuple):
    """A step in the tangent space, or anything with an entry for each unknown."""

    d: Any  # (nodes, n)
    u: Any  # (intervals, m)
    border: Any  # (g,)


class Values(NamedTuple):
    """A problem's values at a point."""

    cost: Any
    defects: Any  # (intervals, n)
    rows: Any  # (rows,) those of all intervals, then those of the end; <= 0 or = 0


class Derivatives(NamedTuple):
    """Derivatives at a point, by z_k = [d_k, du_k, db] of each interval and z_K = [d_K, db] of the end."""

    defects: Any  # (intervals, n, n + m + g)
    rows: Any  # (intervals, R, n + m + g)
    end_rows: Any  # (R_end, n + g)
    gradient: Any  # (intervals, n + m + g) of the cost
    end_gradient: Any  # (n + g,)
    hessian: Any  # (intervals, n + m + g, n + m + g) of cost + y.defects + w.rows
    end_hessian: Any  # (n + g, n + g)


class Closely(NamedTuple):
    """What a close integration of each interval of a phase, from its planned start, says."""

    gaps: Any  # (intervals, n) how far its end is from the planned one, a tangent
    rows: Any  # (intervals, path rows) the largest value along it; of equalities the largest size
    cost: Any  # of the phase, its end included
    middles: Any  # states halfway


class Segment(NamedTuple):
    """A transcribed phase, and where its nodes, intervals, and [d, u, b] sit among those of the whole problem."""

    number: int
    shooting: Shooting
    nodes: slice
    stages: slice
    columns: Any
    alone: bool = False

    def of(self, point: Point) -> Point:
        """The point of the phase."""
        if self.alone:
            return point
        return Point(point.xs[self.number], point.us[self.stages, : self.shooting.m], point.border)


class Transcribed(ABC):
    """What solvers are given: a discrete problem in stages.

    Attributes:
        n, m: tangents of a node and controls of an interval, of the largest phase.
        nodes, intervals, rows_per_interval: how many.
        border: the unknowns that all stages share.
        names, places: of every row.
        equality, exists: (rows,) which rows are equalities; which are asked at all.
        decided: (rows,) those that no unknown changes, for the ends decide them; they are only checked.
        pinned: (rows,) those of them that other rows decide.
        own: (rows,) those of single nodes.
        free: Step of bool, which unknowns may move.
        stirred: (nodes, n) tangents that random steps move: the free ones but what the end fixes, for rows that this
            decides are looked at where a search starts.
        segments, joins: the phases, and what is between them.
    """

    n: int
    m: int
    nodes: int
    intervals: int
    rows_per_interval: int
    border: Border
    names: Array
    places: Array
    equality: Array
    exists: Array
    decided: Array
    pinned: Array
    own: Array
    free: Step
    stirred: Array
    segments: Sequence[Segment]
    joins: Sequence[Any]

    @abstractmethod
    def drop(self, rows: Sequence[Array]) -> None:
        """Take rows out, those of each phase that others decide; they are only checked."""

    @abstractmethod
    def defect(self, stage: int, column: int) -> str:
        """What an entry of the defects is called, and where it is."""

    @property
    @abstractmethod
    def phase_places(self) -> list[str]:
        """What follows the place of an interval in messages, of each phase."""

    @abstractmethod
    def named(self, part: Segment, name: str) -> str:
        """The name of a row of a phase among those of all."""

    @abstractmethod
    def whole_rows(self, parts: Sequence[Array]) -> Array:
        """Numbers for the rows of each phase as numbers for all rows."""

    @abstractmethod
    def rows_of(self, part: Segment, rows: Any) -> Any:
        """The rows of a phase among all rows, or anything with an entry for each."""
