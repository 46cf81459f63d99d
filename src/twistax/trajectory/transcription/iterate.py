"""Points, steps and values of a transcribed problem, and its data."""

from __future__ import annotations

from typing import Any, NamedTuple


class Iterate(NamedTuple):
    """An iterate: states, controls and shared unknowns."""

    xs: Any  # states by name (nodes, ...); for several phases a tuple of such dicts
    us: Any  # (intervals, m)
    border: Any  # (g,) durations and free parameters

    def with_border(self, border: Any) -> Iterate:
        """The same states and controls with another vector of durations and free parameters."""
        return self._replace(border=border)


class Instance(NamedTuple):
    """The data of a solve: parameters, initial and final states, and limits."""

    params: Any
    final: Any  # final states, whose free entries have no meaning; for several phases `PhaseEnds`
    limits: Any  # (g, 2) limits of the shared unknowns
    margins: Any = 0.0  # (rows,) the margins by which rows are tightened

    def with_params(self, params: Any) -> Instance:
        """A copy with other parameter values."""
        return self._replace(params=params)

    def with_margins(self, margins: Any) -> Instance:
        """A copy with other margins."""
        return self._replace(margins=margins)


class PhaseEnds(NamedTuple):
    """Initial and final states of every phase; free entries have no meaning."""

    initial: Any
    final: Any


class Step(NamedTuple):
    """A step in the tangent space, or other data with an entry for each unknown."""

    d: Any  # (nodes, n)
    u: Any  # (intervals, m)
    border: Any  # (g,)


class Values(NamedTuple):
    """The values of a problem's functions at a point."""

    cost: Any
    defects: Any  # (intervals, n)
    rows: Any  # (rows,) the rows of all intervals, then those of the end; <= 0 or = 0
